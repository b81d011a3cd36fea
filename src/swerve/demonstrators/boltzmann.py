"""Demonstrations sampled from pi_c, the model's own demonstrator of a known constraint.

    pi_c(xi) = m(xi) exp(beta R(xi)) 1[xi avoids c] / Z_c

A solver learns a policy with c in force, from nothing or from a nominal learned without c; the
policy never enters c. A tabular policy is pi_c itself. Any other policy is close to pi_c: one of
many trajectories is chosen by importance weight, or, where too few are effective, one of
the particles of sequential Monte Carlo. The error of the policy then shrinks to the order of one
over the effective sample size.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import seed_number
from swerve.base.progress import progress_bar
from swerve.base.solver_kinds import kind_named, solver_names
from swerve.base.space import Task
from swerve.constraints.base import Constraint
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence import estimators
from swerve.evidence.samples import NUM_ISLANDS, log_weights
from swerve.problem.problem import Problem
from swerve.problem.tasks import named_tasks
from swerve.sampling.smc import smc_rollout
from swerve.simulation.policies import ValuedPolicy
from swerve.simulation.trajectory import Policy, Trajectory, rollout
from swerve.solvers.base import AdaptingSolver, Nominal, PolicyNominal, Solver
from swerve.solvers.exact.tabular import Table, TableNominal
from swerve.solvers.learn import learn, resolve_solver
from swerve.systems.tabular import TabularMDP

NUM_CANDIDATES = 512  # trajectories to choose one demonstration from by importance weight
ENOUGH = 0.5  # least effective share of the candidates; below it, particles are resampled instead
NUM_PARTICLES = 100  # particles of one island
LEAST_ESS = 50.0  # effective particles; below it, a choice by weight would not follow pi_c
Sampler = Callable[[Task, jax.Array, str], Demonstration | None]
STREAM = zlib.crc32(b"demonstrations")  # keeps random numbers apart from those of sampled tasks


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
    """Sample one demonstration of each task from pi_c.

    Args:
      problem: the model; its hypotheses do not matter.
      constraint: c, which the demonstrations obey.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      names: names of the demonstrations; demo_000 and so on if None.
      solver: solver that learns pi_c, as for `learn`: "tabular", which samples from pi_c exactly,
        "grid" or "soft-value", with settings as in "grid?num_points=81"; if None, "tabular" for a
        tabular MDP and "grid" for any other.
      nominal: nominal of the same MDP without the constraint, learned by "grid" or "soft-value",
        to start from instead of a solver.
      seed: seed of the sampling.
      progress: whether to show a progress bar.

    Returns:
      K demonstrations.

    Raises:
      ValueError: if a start lies inside the constraint, a task cannot be done without entering, or
        the solver or the nominal is of another kind.
    """
    seed = seed_number(seed)
    batch, labels = named_tasks(problem, constraint, tasks, names)
    constrained = dataclasses.replace(problem, known=(*problem.known, constraint))
    sources = _sources(constrained, solver, nominal, seed, progress)
    found: dict[int, Demonstration] = {}
    solver_name = ""
    with progress_bar("demonstrating", len(labels), progress) as advance:
        for source in sources:
            solver_name = source.solver.name
            for k, made in _sampled(source, batch, labels, found, seed):
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
    """Return nominals with the constraint in force, each better than the one before."""
    if nominal is not None:
        if solver is not None:
            raise ValueError("give a solver or a nominal, not both")
        return _adapted(constrained, nominal, seed)
    if solver is None:
        solver = "tabular" if isinstance(constrained.mdp, TabularMDP) else "grid"
    chosen = resolve_solver(solver) if isinstance(solver, str) else solver
    if not (isinstance(chosen, Solver) and chosen.kind.demonstrates):
        names = ", ".join(solver_names(lambda kind: kind.demonstrates))
        raise ValueError(
            f"solver: expected one of {names} to sample demonstrations with, got "
            f"{getattr(chosen, 'name', None) or solver!r}"
        )
    return [learn(constrained, chosen, seed=seed, progress=progress)]


def _adapted(constrained: Problem, nominal: Nominal, seed: int) -> Iterable[Nominal]:
    """Return nominals adapted from a nominal that was learned without the constraint.

    Raises:
      ValueError: if the solver of the nominal cannot adapt it, or MDP, beta or measure differ.
    """
    adapting = getattr(nominal, "solver", None)
    if not isinstance(adapting, AdaptingSolver):
        names = " or ".join(solver_names(lambda kind: kind.adapts))
        raise ValueError(
            f"nominal: expected one that {names} learned, got "
            f"{getattr(adapting, 'name', nominal)!r}"
        )
    asked, learned = constrained.record, nominal.problem.record
    settings = [(record.mdp_digest, record.beta, record.measure) for record in (asked, learned)]
    if settings[0] != settings[1]:
        raise ValueError(
            "nominal: expected one of the same MDP, beta and measure: "
            f"{asked.summary}; got one of {learned.summary}"
        )
    return adapting.adapted(nominal, constrained, seed)


def _sampled(
    source: Nominal, batch: Task, labels: list[str], found: dict[int, Demonstration], seed: int
) -> Iterator[tuple[int, Demonstration]]:
    """Yield index and demonstration of each task not yet found that the nominal can sample."""
    stream = jax.random.fold_in(jax.random.key(seed), STREAM)
    left = np.array([k for k in range(len(labels)) if k not in found])
    goals, goal_of_task = np.unique(batch.goal[left], axis=0, return_inverse=True)
    for goal, sample_one in enumerate(_samplers(source, goals)):
        for k in left[goal_of_task.reshape(-1) == goal].tolist():
            task = Task(batch.start[k], batch.goal[k])
            made = sample_one(task, jax.random.fold_in(stream, k), labels[k])
            if made is not None:
                yield k, made


def _samplers(source: Nominal, goals: np.ndarray) -> Iterator[Sampler]:
    """Yield a function for each goal that samples a demonstration of a task with this goal."""
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
    """Sample one trajectory from pi_c exactly; return None where none avoids c."""
    start = source.start(task)
    if not np.isfinite(table.values[0, start]):
        return None
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    states, actions, length = table.sample(start, 1, generator)
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
    """Choose one of many trajectories by weight; return None where too few are effective."""
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
    p = np.asarray(estimators.normalise(log_weight), np.float32)
    return _demonstration(
        problem, candidates, int(jax.random.choice(key_choice, len(p), p=p)), task, name
    )


def _demonstration(
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
    """Return the effective sample size; 0 where no trajectory avoids c."""
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
    kind = kind_named(solver)
    if kind.is_exact:
        raise ValueError(
            f"{where} no trajectory of {problem.mdp.num_steps} steps avoids {avoided}: choose "
            "another task or more steps"
        )
    better = "a finer grid" if kind.computes_value else f"more {kind.finer} of the solver"
    raise ValueError(
        f"{where} hardly any trajectory avoids {avoided} (effective sample size below "
        f"{LEAST_ESS:.0f} of {NUM_ISLANDS * NUM_PARTICLES}): choose another task, or {better}"
    )
