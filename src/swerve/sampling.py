"""Sampling the nominal distribution, reduced to evidence as it goes.

Trajectories of each task are rolled out in chunks on as many threads as there are cores, judged
against all hypotheses at once and dropped; what is kept is their reward, log-probability, length
and one bit a hypothesis, and a few whole ones for pictures.

Shapes: K tasks, N trajectories, T steps, H hypotheses, M kept trajectories, n states, g goal
dimensions.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve import estimators
from swerve.arguments import whole_number
from swerve.evidence import Evidence
from swerve.exact import exact_evidence
from swerve.nominal import ExactNominal, Nominal, PolicyNominal
from swerve.problem import Problem, ProblemRecord
from swerve.progress import progress_bar
from swerve.samples import EXACT, METHODS, NUM_KEPT, Samples, log_weights, summarise
from swerve.space import Actions, Task
from swerve.tasks import checked_tasks
from swerve.trajectory import Policy, SoftPolicy, Trajectory, rollout

CHUNK = 2048  # trajectories rolled out at once: their activations stay in cache


def sample(
    nominal: Nominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int = 10_000,
    *,
    method: str | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Evidence:
    """Sample trajectories of each task and judge them against every hypothesis.

    Args:
      nominal: from `learn`.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      num_trajectories: N for each task; of no matter where answers are exact.
      method: "importance" (the default) weighs each trajectory by target over proposal, so that
        the answer is right however imperfect the policy, as long as it covers all modes; "plain"
        weighs all alike, as the paper does. Solvers that give exact answers take neither.
      seed: of the sampling. A task's trajectories depend on the seed and the task alone, not on
        the other tasks of the call.
      progress: whether to show a progress bar.

    Returns:
      Evidence for these tasks, in their order.

    Raises:
      ValueError: if an argument is of the wrong kind or range, a task does not fit the problem, or
        the dynamics return NaN.
    """
    found = dict(
        sample_each(nominal, tasks, num_trajectories, method=method, seed=seed, progress=progress)
    )
    first, *others = (found[k] for k in sorted(found))
    return first.joined(*others)


def sample_each(
    nominal: Nominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int,
    *,
    method: str | None,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield the number of each task and its evidence as soon as it is there; see `sample`.

    Tasks with the same goal follow one another, whatever their order.
    """
    if isinstance(nominal, ExactNominal):
        yield from _answer_each(nominal, tasks, method, seed, progress)
    elif isinstance(nominal, PolicyNominal):
        yield from _sample_each(
            nominal, tasks, num_trajectories, method or METHODS[0], seed, progress
        )
    else:
        raise ValueError(f"nominal: expected what swerve.learn returns, got {nominal!r}")


def _answer_each(
    nominal: ExactNominal,
    tasks: Task | Sequence[Task],
    method: str | None,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield the exact evidence of each task in turn."""
    if method not in (None, EXACT):
        raise ValueError(
            f"method: the {nominal.solver.name} solver gives exact answers, so there is nothing to "
            f"sample by {method!r}: leave method out"
        )
    seed = whole_number(seed, "seed", 0)
    batch = checked_tasks(nominal.problem, tasks)
    record = nominal.problem.record
    with progress_bar("working out", len(batch.start), progress) as advance:
        for k in range(len(batch.start)):
            task = Task(batch.start[k], batch.goal[k])
            generator = np.random.default_rng([seed, zlib.crc32(np.concatenate(task).tobytes())])
            with _naming(k, task):
                answer = nominal.answer(task, generator, advance)
                evidence = exact_evidence(record, task, answer, repr(nominal.solver), seed)
            yield k, evidence


def _sample_each(
    nominal: PolicyNominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int,
    method: str,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield the evidence of each task, sampled."""
    batch = checked_tasks(nominal.problem, tasks)
    if method not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    num_trajectories = whole_number(num_trajectories, "num_trajectories", 2)
    seed = whole_number(seed, "seed", 0)
    _check_memory(len(batch.start), num_trajectories, len(nominal.problem.hypotheses))
    goals, goal_of_task = np.unique(batch.goal, axis=0, return_inverse=True)
    total = (len(batch.start) + len(goals)) * num_trajectories  # a goal costs about as much
    workers = ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0)))
    record = nominal.problem.record
    with workers, progress_bar("sampling", total, progress) as advance:
        policies = nominal.policies(goals, lambda share: advance(share * num_trajectories))
        for goal, policy in enumerate(policies):
            for k in np.flatnonzero(goal_of_task.reshape(-1) == goal).tolist():
                task = Task(batch.start[k], batch.goal[k])
                alone = Task(task.start[None], task.goal[None])
                job = _Job(nominal.problem, record, policy, task, num_trajectories, seed)
                with _naming(k, task):
                    samples = _sample_task(job, workers.map, advance)
                    summary = summarise(record, samples, method)
                yield (
                    k,
                    Evidence(
                        problem=record,
                        tasks=alone,
                        method=method,
                        num_trajectories=num_trajectories,
                        solver=repr(nominal.solver),
                        seed=seed,
                        summary=summary,
                        load_samples=lambda samples=samples: samples,
                    ),
                )


@contextmanager
def _naming(k: int, task: Task) -> Iterator[None]:
    """Name the task in whatever goes wrong with it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(
            f"task {k}, from {task.start.tolist()} to {task.goal.tolist()}: {error}"
        ) from error


def _check_memory(num_tasks: int, num_trajectories: int, num_hypotheses: int) -> None:
    """Refuse what would not fit memory: one bit for each (task, trajectory, hypothesis)."""
    needed = num_tasks * num_trajectories * ((num_hypotheses + 7) // 8)
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise ValueError(
            f"{num_trajectories:,} trajectories of {num_tasks:,} tasks judged against "
            f"{num_hypotheses:,} hypotheses take {needed / 2**30:,.0f} GiB of memory, and this "
            f"machine has {there / 2**30:,.0f} GiB: take fewer of one of them"
        )


class _Job(NamedTuple):
    """One task to be sampled."""

    problem: Problem
    record: ProblemRecord
    policy: Policy
    task: Task
    num_trajectories: int
    seed: int


class _Numbers(NamedTuple):
    """What trajectories are weighed by, each [N]."""

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray


class _Chunk(NamedTuple):
    """Some of the trajectories of a task.

    Attributes:
      numbers: what they are weighed by.
      violations: [N, B] packed bits.
      kept: [M, T+1, n] a few whole ones, drawn by weight.
      log_total: log of the sum of their weights, nats.
    """

    numbers: _Numbers
    violations: np.ndarray
    kept: np.ndarray
    log_total: float


def _sample_task(job: _Job, run_all: Callable, advance: Callable[..., None]) -> Samples:
    """Sample the trajectories of one task, chunk by chunk; every array has a leading axis of 1."""
    num_chunks = -(-job.num_trajectories // CHUNK)
    size = -(-job.num_trajectories // num_chunks)
    sizes = [min(size, job.num_trajectories - k * size) for k in range(num_chunks)]
    numbers = np.concatenate([job.task.start, job.task.goal])
    key = jax.random.fold_in(jax.random.key(job.seed), zlib.crc32(numbers.tobytes()))

    def run(chunk_key: jax.Array, used: int) -> _Chunk:
        chunk = _sample_chunk(job, chunk_key, size, used)
        advance(used)
        return chunk

    chunks = list(run_all(run, jax.random.split(key, num_chunks), sizes))
    rows = [(*chunk.numbers, chunk.violations) for chunk in chunks]
    columns = [np.concatenate(part)[None] for part in zip(*rows, strict=True)]
    # a point in the cumulative weight of all chunks names a chunk and a point in that chunk's
    chunk, within = _at(_points(), np.array([chunk.log_total for chunk in chunks]))
    place = np.minimum((within * NUM_KEPT).astype(int), NUM_KEPT - 1)
    kept = np.stack([chunks[c].kept[k] for c, k in zip(chunk, place, strict=True)])
    return Samples(*columns, kept=kept[None], soft_value=_soft_value(job)[None])


def _soft_value(job: _Job) -> np.ndarray:
    """Return log Z_0 of the task by the solver's own soft value, NaN where it has none."""
    if not isinstance(job.policy, SoftPolicy):
        return np.array(np.nan)
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    return np.asarray(_value_at_start(job.policy, start, goal), np.float64)


@eqx.filter_jit
def _value_at_start(policy: SoftPolicy, start: jax.Array, goal: jax.Array) -> jax.Array:
    return policy.soft_value(start, jnp.zeros((), jnp.int32), goal)


def _sample_chunk(job: _Job, key: jax.Array, size: int, used: int) -> _Chunk:
    """Roll out one chunk of trajectories, and judge those that are used."""
    problem, task = job.problem, job.task
    trajectory = rollout(
        problem,
        job.policy,
        jnp.asarray(task.start, jnp.float32),
        jnp.asarray(task.goal, jnp.float32),
        key,
        size,
    )
    states = np.moveaxis(np.asarray(trajectory.states), -1, 0)[:used]
    if not np.isfinite(states).all():
        n, t = np.argwhere(~np.isfinite(states).all(axis=-1))[0]
        raise ValueError(
            f"{type(problem.mdp).__name__}.dynamics returned {states[n, t].tolist()} at step {t} "
            f"from state {states[n, t - 1].tolist()}: expected finite numbers"
        )
    numbers = _Numbers(
        np.asarray(trajectory.total_reward)[:used],
        np.asarray(trajectory.log_probability)[:used],
        np.asarray(trajectory.length)[:used],
    )
    log_weight = log_weights(job.record, numbers)
    return _Chunk(
        numbers,
        job.record.hypotheses.violations(
            states, job.record.space, problem.between_states, _actions_taken(job, trajectory, used)
        ),
        states[_at(_points(), log_weight)[0]],
        float(np.logaddexp.reduce(log_weight)),
    )


def _actions_taken(job: _Job, trajectory: Trajectory, used: int) -> Actions | None:
    """Return the actions of trajectories where hypotheses are about them, NaN after their end."""
    if not job.record.hypotheses.about_actions:
        return None
    values = np.asarray(job.problem.mdp.actions, np.float64)[
        np.asarray(trajectory.actions).T[:used]
    ]
    ended = np.arange(values.shape[1]) >= np.asarray(trajectory.length)[:used, None]
    return Actions(job.record.action_names, np.where(ended[..., None], np.nan, values))


def _points() -> np.ndarray:
    """Return NUM_KEPT points spread evenly over [0, 1]."""
    return (np.arange(NUM_KEPT) + 0.5) / NUM_KEPT


def _at(points: np.ndarray, log_weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which item each share of the cumulative weight falls on, and how far into it."""
    if np.isneginf(log_weight).all():  # nothing is allowed; whoever weighs them will say so
        return np.zeros(len(points), int), np.zeros(len(points))
    cumulative = np.concatenate([[0.0], np.cumsum(estimators.normalise(log_weight))])
    cumulative /= cumulative[-1]
    item = np.searchsorted(cumulative, points, side="right") - 1
    within = (points - cumulative[item]) / np.diff(cumulative)[item]
    return item, within
