"""Demonstrations drawn from pi_c, the model's own demonstrator of a known constraint.

    pi_c(xi) = m(xi) exp(beta R(xi)) 1[xi avoids c] / Z_c

A solver that is run with c in force, or goes on from a nominal with c in force, gives a policy that
never enters c. On tables it is pi_c. Elsewhere its trajectories follow pi_c nearly, and one of many
is drawn by importance weight; where too few of these count, one of the particles of sequential
Monte Carlo. That takes what the policy is off down to the order of one over their effective sample
size.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import whole_number
from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.constraints.base import Constraint
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence import estimators
from swerve.evidence.samples import ADAPTING_SOLVERS, NUM_ISLANDS, log_weights
from swerve.problem.problem import Problem
from swerve.problem.tasks import named_tasks
from swerve.sampling.resolve import AdaptingSolver
from swerve.sampling.smc import smc_rollout
from swerve.simulation.policies import ValuedPolicy
from swerve.simulation.trajectory import Policy, Trajectory, rollout
from swerve.solvers.exact.tabular import Table, TableNominal
from swerve.solvers.learn import Nominal, PolicyNominal, Solver, learn, resolve_solver
from swerve.systems.tabular import TabularMDP

SOLVERS = ("grid", "tabular", "soft-value")
NUM_CANDIDATES = 512
ENOUGH = 0.5  # of the candidates: where fewer are effective, particles are resampled instead
NUM_PARTICLES = 100  # of an island
LEAST_ESS = 50.0
Draw = Callable[[Task, jax.Array, str], Demonstration | None]
STREAM = zlib.crc32(b"demonstrations")  # a seed that tasks were drawn with gives other numbers here


def demonstrate(
    problem: Problem,
    constraint: Constraint,
    tasks: Task | Sequence[Task],
    *,
    names: Sequence[str] | None = None,
    solver: str | Solver | None = None,
    nominal: Nominal | None = None,
    seed: int = 0,
    progress: bool = False,
) -> list[Demonstration]:
    """Draw one demonstration of each task from pi_c.

    Args:
      problem: the model; its hypotheses do not matter.
      constraint: c, which the demonstrations obey.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      names: what to call the demonstrations; demo_000 and so on if None.
      solver: how pi_c is worked out, as for `learn`: "tabular", whose demonstrations are drawn from
        pi_c exactly, "grid" or "soft-value", with settings as in "grid?num_points=81"; tables if
        the MDP is tabular, else a grid, if None.
      nominal: what "grid" or "soft-value" learned of the same MDP without the constraint, to go on
        from in place of a solver.
      seed: of the drawing.
      progress: whether to show a progress bar.

    Returns:
      K demonstrations.

    Raises:
      ValueError: if a start lies inside the constraint, a task cannot be done without entering, or
        the solver or the nominal is of another kind.
    """
    seed = whole_number(seed, "seed", 0)
    batch, labels = named_tasks(problem, constraint, tasks, names)
    constrained = dataclasses.replace(problem, known=(*problem.known, constraint))
    sources = _sources(constrained, solver, nominal, seed, progress)
    stream = jax.random.fold_in(jax.random.key(seed), STREAM)
    found: dict[int, Demonstration] = {}
    solver_name = ""
    with progress_bar("demonstrating", len(labels), progress) as advance:
        for source in sources:
            solver_name = source.solver.name
            for k, made in _drawn(source, batch, labels, found, stream):
                found[k] = made
                advance(1)
            if len(found) == len(labels):
                break
        else:
            _refuse(constrained, batch, labels, found, solver_name)
    return [found[k] for k in sorted(found)]


def _sources(
    constrained: Problem,
    solver: str | Solver | None,
    nominal: Nominal | None,
    seed: int,
    progress: bool,
) -> Iterable[Nominal]:
    """Return nominals with the constraint in force, ever better ones."""
    if nominal is not None:
        if solver is not None:
            raise ValueError("give a solver or a nominal, not both")
        adapting = getattr(nominal, "solver", None)
        if not isinstance(adapting, AdaptingSolver):
            raise ValueError(
                f"nominal: expected one that {' or '.join(ADAPTING_SOLVERS)} learned, got "
                f"{getattr(adapting, 'name', nominal)!r}"
            )
        asked, learned = constrained.record, nominal.problem.record
        told = [(one.mdp_digest, one.beta, one.measure) for one in (asked, learned)]
        if told[0] != told[1]:
            raise ValueError(
                "nominal: expected one of the same MDP, beta and measure: "
                f"{asked.summary}; got one of {learned.summary}"
            )
        return adapting.adapted(nominal, constrained, seed)
    if solver is None:
        solver = "tabular" if isinstance(constrained.mdp, TabularMDP) else "grid"
    chosen = resolve_solver(solver) if isinstance(solver, str) else solver
    name = getattr(chosen, "name", None)
    if name not in SOLVERS:
        raise ValueError(
            f"solver: expected one of {', '.join(SOLVERS)} to draw demonstrations with, got "
            f"{name or solver!r}"
        )
    return [learn(constrained, chosen, seed=seed, progress=progress)]


def _drawn(
    source: Nominal,
    batch: Task,
    labels: list[str],
    found: dict[int, Demonstration],
    stream: jax.Array,
) -> Iterator[tuple[int, Demonstration]]:
    """Yield demonstrations, as far as they can be drawn, of tasks that have none yet."""
    left = np.array([k for k in range(len(labels)) if k not in found])
    goals, goal_of_task = np.unique(batch.goal[left], axis=0, return_inverse=True)
    for goal, draw in enumerate(_draws(source, goals)):
        for k in left[goal_of_task.reshape(-1) == goal].tolist():
            task = Task(batch.start[k], batch.goal[k])
            made = draw(task, jax.random.fold_in(stream, k), labels[k])
            if made is not None:
                yield k, made


def _draws(source: Nominal, goals: np.ndarray) -> Iterator[Draw]:
    """Yield for each goal what draws a demonstration of a task that has it."""
    if isinstance(source, TableNominal):
        for goal in goals:
            yield partial(_from_table, source, source.goal_table(goal))
    else:
        assert isinstance(source, PolicyNominal)
        for policy in source.policies(goals):
            yield partial(_from_policy, source.problem, policy)


def _from_table(
    source: TableNominal, table: Table, task: Task, key: jax.Array, name: str
) -> Demonstration | None:
    """Draw one trajectory of pi_c itself; None where nothing avoids c."""
    start = source.start(task)
    if not np.isfinite(table.values[0, start]):
        return None
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    states, actions, length = table.draw(start, 1, generator)
    mdp, num = source.problem.mdp, int(length[0])
    return Demonstration(
        name,
        source.table.states[states[0, : num + 1]],
        task,
        times=np.arange(num + 1) * mdp.dt,
        actions=np.asarray(mdp.actions)[actions[0, :num]],
    )


def _from_policy(
    problem: Problem, policy: Policy, task: Task, key: jax.Array, name: str
) -> Demonstration | None:
    """Draw one trajectory of pi_c by weight from many; None where too few of them count."""
    key_rollout, key_choice = jax.random.split(key)
    start, goal = (jnp.asarray(values, jnp.float32) for values in task)
    candidates = rollout(problem, policy, start, goal, key_rollout, NUM_CANDIDATES)
    log_weight = log_weights(problem.record, candidates)
    if _effective(log_weight, np.arange(NUM_CANDIDATES)) < ENOUGH * NUM_CANDIDATES:
        assert isinstance(policy, ValuedPolicy)
        key_particles, key_choice = jax.random.split(key_choice)
        particles = smc_rollout(policy, start, goal, key_particles, NUM_ISLANDS, NUM_PARTICLES)
        candidates, log_weight = particles.trajectory, np.asarray(particles.log_weight, float)
        island = np.arange(len(log_weight)) // NUM_PARTICLES
        if _effective(log_weight, island * NUM_PARTICLES + np.asarray(particles.root)) < LEAST_ESS:
            return None
    p = estimators.normalise(log_weight)
    return _told(problem, candidates, int(jax.random.choice(key_choice, len(p), p=p)), task, name)


def _told(
    problem: Problem, candidates: Trajectory, chosen: int, task: Task, name: str
) -> Demonstration:
    """Return one of many trajectories as a demonstration."""
    length = int(candidates.length[chosen])
    actions = np.asarray(problem.mdp.actions)[np.asarray(candidates.actions[:length, chosen])]
    return Demonstration(
        name,
        np.asarray(candidates.states[: length + 1, :, chosen], np.float64),
        task,
        times=np.arange(length + 1) * problem.mdp.dt,
        actions=actions,
    )


def _effective(log_weight: np.ndarray, group: np.ndarray) -> float:
    """Return the effective sample size, 0 where nothing avoids c."""
    if not np.isfinite(log_weight).any():
        return 0.0
    return estimators.effective_sample_size(log_weight, group)


def _refuse(
    problem: Problem, batch: Task, labels: list[str], found: dict[int, Demonstration], solver: str
) -> None:
    """Raise ValueError naming the first task that has no demonstration."""
    k = next(k for k in range(len(labels)) if k not in found)
    avoided = ", ".join(constraint.name for constraint in problem.known)
    where = f"{labels[k]}: from start {batch.start[k].tolist()} to goal {batch.goal[k].tolist()}"
    if solver == "tabular":
        raise ValueError(
            f"{where} no trajectory of {problem.mdp.num_steps} steps avoids {avoided}: choose "
            "another task or more steps"
        )
    better = "a finer grid" if solver == "grid" else "more num_steps of the solver"
    raise ValueError(
        f"{where} hardly any trajectory avoids {avoided} (effective sample size below "
        f"{LEAST_ESS:.0f} of {NUM_ISLANDS * NUM_PARTICLES}): choose another task, or {better}"
    )
