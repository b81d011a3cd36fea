"""Demonstrations drawn from pi_c, the model's own demonstrator of a known constraint.

    pi_c(xi) = m(xi) exp(beta R(xi)) 1[xi avoids c] / Z_c

The grid solver is run with c in force, so its policy never enters c and its trajectories already
follow pi_c nearly. One of 512 is then drawn by importance weight, which takes what the policy is
off down to the order of one over their effective sample size.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from swerve import estimators
from swerve.arguments import instance, whole_number
from swerve.constraints import Constraint
from swerve.demonstrations import Demonstration
from swerve.nominal import PolicyNominal, learn, resolve_solver
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.samples import log_weights
from swerve.solvers.grid import Grid
from swerve.space import Task
from swerve.tasks import checked_tasks
from swerve.trajectory import rollout

NUM_CANDIDATES = 512
LEAST_ESS = 50.0
STREAM = zlib.crc32(b"demonstrations")  # a seed that tasks were drawn with gives other numbers here


def demonstrate(
    problem: Problem,
    constraint: Constraint,
    tasks: Task | Sequence[Task],
    *,
    names: Sequence[str] | None = None,
    solver: str | Grid = "grid",
    seed: int = 0,
    progress: bool = False,
) -> list[Demonstration]:
    """Draw one demonstration of each task from pi_c.

    Args:
      problem: the model; its hypotheses do not matter.
      constraint: c, which the demonstrations obey.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      names: what to call the demonstrations; demo_000 and so on if None.
      solver: the grid on which pi_c is worked out, or a text such as "grid?num_points=81".
      seed: of the drawing.
      progress: whether to show a progress bar.

    Returns:
      K demonstrations.

    Raises:
      ValueError: if a start lies inside the constraint, a task cannot be done without entering, or
        the solver is no Grid.
    """
    instance(constraint, Constraint, "constraint", "take one of problem.hypotheses.constraint(k)")
    chosen = resolve_solver(solver) if isinstance(solver, str) else solver
    instance(chosen, Grid, "solver", "pi_c is worked out on a grid")
    seed = whole_number(seed, "seed", 0)
    batch = checked_tasks(problem, tasks)
    for k in np.flatnonzero(constraint.contains(batch.start, problem.mdp.space)):
        raise ValueError(
            f"tasks: task {k} starts at {batch.start[k].tolist()}, inside {constraint.name}, which "
            "its demonstration is to keep out of: choose another start"
        )
    constrained = dataclasses.replace(problem, known=(*problem.known, constraint))
    labels = [f"demo_{k:03d}" for k in range(len(batch.start))] if names is None else list(names)
    if len(labels) != len(batch.start):
        raise ValueError(f"names: expected {len(batch.start)}, one a task, got {len(labels)}")
    nominal = learn(constrained, chosen)
    assert isinstance(nominal, PolicyNominal)
    stream = jax.random.fold_in(jax.random.key(seed), STREAM)
    goals, goal_of_task = np.unique(batch.goal, axis=0, return_inverse=True)
    found: dict[int, Demonstration] = {}
    with progress_bar("demonstrating", len(batch.start), progress) as advance:
        for goal, policy in enumerate(nominal.policies(goals)):
            for k in np.flatnonzero(goal_of_task.reshape(-1) == goal):
                task = Task(batch.start[k], batch.goal[k])
                key = jax.random.fold_in(stream, int(k))
                found[int(k)] = _draw(constrained, policy, task, key, labels[k])
                advance(1)
    return [found[k] for k in sorted(found)]


def _draw(problem: Problem, policy, task: Task, key: jax.Array, name: str) -> Demonstration:
    """Draw one trajectory of pi_c by weight from many candidates."""
    key_rollout, key_choice = jax.random.split(key)
    start, goal = (jnp.asarray(values, jnp.float32) for values in task)
    candidates = rollout(problem, policy, start, goal, key_rollout, NUM_CANDIDATES)
    log_weight = log_weights(problem.record, candidates)
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
