"""Demonstrations drawn from pi_c, the model's own demonstrator of a known constraint.

    pi_c(xi) = m(xi) exp(beta R(xi)) 1[xi avoids c] / Z_c

The grid solver is run with c in force, so its policy never enters c and its trajectories already
follow pi_c nearly; one of many is then drawn by importance weight, which makes up for the rest.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from swerve import estimators
from swerve.constraints import Constraint
from swerve.demonstrations import Demonstration
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.sampling import checked_tasks
from swerve.solvers.grid import Grid
from swerve.space import Task
from swerve.trajectory import rollout

NUM_CANDIDATES = 512
LEAST_ESS = 50.0


def demonstrate(
    problem: Problem,
    constraint: Constraint,
    tasks: Task,
    *,
    solver: Grid | None = None,
    seed: int = 0,
    progress: bool = False,
) -> list[Demonstration]:
    """Draw one demonstration of each task from pi_c.

    Args:
      problem: the model; its hypotheses do not matter.
      constraint: c, which the demonstrations obey.
      tasks: starts [K, n] and goals [K, g].
      solver: the grid on which pi_c is worked out; the default resolution if None.
      seed: of the drawing.
      progress: whether to show a progress bar.

    Returns:
      K demonstrations, named demo_000 and so on.

    Raises:
      ValueError: if a start lies inside the constraint, or a task cannot be done without entering.
    """
    constrained = dataclasses.replace(problem, known=(*problem.known, constraint))
    batch = checked_tasks(constrained, tasks)
    nominal = (solver or Grid()).learn(constrained)
    goals, goal_of_task = np.unique(batch.goal, axis=0, return_inverse=True)
    found: dict[int, Demonstration] = {}
    with progress_bar("demonstrating", len(batch.start), progress) as advance:
        for goal, policy in enumerate(nominal.policies(goals)):
            for k in np.flatnonzero(goal_of_task.reshape(-1) == goal):
                task = Task(batch.start[k], batch.goal[k])
                key = jax.random.fold_in(jax.random.key(seed), int(k))
                found[int(k)] = _draw(constrained, policy, task, key, f"demo_{k:03d}")
                advance(1)
    return [found[k] for k in sorted(found)]


def draw_tasks(problem: Problem, constraint: Constraint, num_tasks: int, *, seed: int = 0) -> Task:
    """Draw tasks from the MDP whose start and goal, where it is a state, lie outside a constraint.

    Starts where the episode would be over already are left out too.

    Raises:
      ValueError: if almost every task drawn touches the constraint.
    """
    mdp = problem.mdp
    keys = jax.random.split(jax.random.key(seed), 20 * num_tasks + 100)
    drawn = jax.vmap(mdp.sample_task)(keys)
    start, goal = np.asarray(drawn.start, np.float64), np.asarray(drawn.goal, np.float64)
    outside = ~np.asarray(jax.vmap(mdp.terminated)(drawn.start, drawn.goal))
    for forbidden in (*problem.known, constraint):
        outside &= ~forbidden.contains(start, mdp.space)
        if mdp.goal_names == mdp.state_names:
            outside &= ~forbidden.contains(goal, mdp.space)
    chosen = np.flatnonzero(outside)[:num_tasks]
    if len(chosen) < num_tasks:
        raise ValueError(
            f"only {len(chosen)} of {len(start)} tasks drawn from {type(mdp).__name__} start and "
            f"end outside {constraint.name}, {num_tasks} were asked for: give tasks of your own"
        )
    return Task(start[chosen], goal[chosen])


def _draw(problem: Problem, policy, task: Task, key: jax.Array, name: str) -> Demonstration:
    """Draw one trajectory of pi_c by weight from many candidates."""
    key_rollout, key_choice = jax.random.split(key)
    start, goal = (jnp.asarray(values, jnp.float32) for values in task)
    candidates = rollout(problem, policy, start, goal, key_rollout, NUM_CANDIDATES)
    log_weight = estimators.log_weights(
        np.asarray(candidates.total_reward),
        np.asarray(candidates.log_probability),
        np.asarray(candidates.length),
        beta=problem.beta,
        measure=problem.measure,
        num_actions=problem.mdp.num_actions,
    )
    effective = 0.0
    if np.isfinite(log_weight).any():
        effective = estimators.effective_sample_size(log_weight)
    if effective < LEAST_ESS:
        raise ValueError(
            f"{name}: from start {task.start.tolist()} to goal {task.goal.tolist()} hardly any "
            f"trajectory avoids {', '.join(c.name for c in problem.known)} (effective sample size "
            f"{effective:.0f} of {NUM_CANDIDATES}): choose another task, or a finer grid"
        )
    chosen = int(jax.random.choice(key_choice, NUM_CANDIDATES, p=estimators.normalise(log_weight)))
    length = int(candidates.length[chosen])
    actions = np.asarray(problem.mdp.actions)[np.asarray(candidates.actions[:length, chosen])]
    return Demonstration(
        name,
        np.asarray(candidates.states[: length + 1, :, chosen], np.float64),
        task,
        times=np.arange(length + 1) * problem.mdp.dt,
        actions=actions,
    )
