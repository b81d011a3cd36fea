"""Sample the trajectories of one task in chunks; judge and reduce each chunk at once.

Shapes: N trajectories, T steps, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, n states.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.space import Actions, Task
from swerve.evidence import estimators
from swerve.evidence.samples import (
    NUM_ISLANDS,
    NUM_KEPT,
    RESAMPLED,
    TEMPERED,
    Samples,
    kept_paths,
    log_weights,
)
from swerve.problem.problem import Problem
from swerve.problem.record import ProblemRecord
from swerve.sampling.smc import Particles, smc_rollout
from swerve.sampling.tempering import temper
from swerve.simulation.compiled import of_problem
from swerve.simulation.policies import ValuedPolicy
from swerve.simulation.trajectory import Policy, Trajectory, rollout

MAX_CHUNK = 1024  # trajectories rolled out at once: with more, activations do not fit the cache


class SamplingJob(NamedTuple):
    """One task to be sampled, and how.

    Attributes:
      problem: the problem that the policy was learned for.
      record: record of the problem whose pi_0 is wanted, perhaps with another beta than `problem`.
      policy: policy of the task's goal.
      task: start [n] and goal [g].
      num_trajectories: N.
      method: one of the names in `evidence.samples`.
      seed: seed of the sampling.
    """

    problem: Problem
    record: ProblemRecord
    policy: Policy
    task: Task
    num_trajectories: int
    method: str
    seed: int

    @property
    def island(self) -> int:
        """Number of trajectories in an island, where trajectories are resampled."""
        return whole_islands(self.num_trajectories)[1]


class _Numbers(NamedTuple):
    """Numbers that determine the weights of trajectories, each [N]; see `Samples`."""

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    log_correction: np.ndarray
    ancestor: np.ndarray


class _Chunk(NamedTuple):
    """Some of the trajectories of a task.

    Attributes:
      numbers: numbers that determine the weights of the trajectories.
      violations: [N, B] packed bits.
      kept: [M, T+1, n] a few whole trajectories, chosen by weight.
      log_total: log of the sum of the weights of all N trajectories, nats.
    """

    numbers: _Numbers
    violations: np.ndarray
    kept: np.ndarray
    log_total: float


def whole_islands(num_trajectories: int) -> tuple[int, int]:
    """Return the number of islands for at least `num_trajectories`, and the size of each island.

    No island is larger than a chunk, and the number of islands is a multiple of NUM_ISLANDS.
    """
    part = -(-num_trajectories // NUM_ISLANDS)
    split = -(-part // MAX_CHUNK)
    return NUM_ISLANDS * split, -(-part // split)


def sample_task(job: SamplingJob, run_all: Callable, advance: Callable[..., None]) -> Samples:
    """Sample the trajectories of one task, chunk by chunk; every array has a leading axis of 1."""
    sizes = _chunk_sizes(job)
    numbers = np.concatenate([job.task.start, job.task.goal])
    key = jax.random.fold_in(jax.random.key(job.seed), zlib.crc32(numbers.tobytes()))

    def run(chunk_key: jax.Array, used: int) -> _Chunk:
        chunk = _sample_chunk(job, chunk_key, sizes[0], used)
        advance(used)
        return chunk

    chunks: list[_Chunk] = list(run_all(run, jax.random.split(key, len(sizes)), sizes))
    for first, chunk in zip(np.cumsum([0, *sizes]), chunks, strict=False):
        chunk.numbers.ancestor[:] += first
    rows = [(*chunk.numbers, chunk.violations) for chunk in chunks]
    columns = [np.concatenate(part)[None] for part in zip(*rows, strict=True)]
    # a point of the cumulative weight of all chunks falls on one chunk, and there on a point of the
    # cumulative weight of this chunk
    chunk, within = _at(_points(), np.array([chunk.log_total for chunk in chunks]))
    place = np.minimum((within * NUM_KEPT).astype(int), NUM_KEPT - 1)
    kept = np.stack([chunks[c].kept[k] for c, k in zip(chunk, place, strict=True)])
    return Samples(*columns, kept=kept_paths(kept)[None], soft_value=_soft_value(job)[None])


def _chunk_sizes(job: SamplingJob) -> list[int]:
    """Return how many trajectories to sample in each chunk; the last chunk may be smaller.

    Where trajectories are resampled, a chunk consists of whole islands.
    """
    if job.method in RESAMPLED:
        num_islands, island = whole_islands(job.num_trajectories)
        at_once = MAX_CHUNK // island
        while num_islands % at_once:
            at_once -= 1
        return [at_once * island] * (num_islands // at_once)
    num_chunks = -(-job.num_trajectories // MAX_CHUNK)
    size = -(-job.num_trajectories // num_chunks)
    return [min(size, job.num_trajectories - k * size) for k in range(num_chunks)]


def _soft_value(job: SamplingJob) -> np.ndarray:
    """Return log Z_0 of the task by the solver's own soft value.

    NaN where the solver has none; -inf where by the solver known constraints close the start in.
    """
    if not isinstance(job.policy, ValuedPolicy) or job.method == TEMPERED:
        return np.array(np.nan)
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    value = np.asarray(_value_at_start(job.policy, start, goal), np.float64)
    is_closed = bool(job.problem.known) and value < job.policy.least_value
    return np.array(-np.inf) if is_closed else value


@of_problem
def _value_at_start(policy: ValuedPolicy, start: jax.Array, goal: jax.Array) -> jax.Array:
    return policy.soft_value(start, jnp.zeros((), jnp.int32), goal)


def _sample_chunk(job: SamplingJob, key: jax.Array, size: int, used: int) -> _Chunk:
    """Roll out one chunk of `size` trajectories, and judge the first `used` of them."""
    problem = job.problem
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    particles = None
    if job.method in RESAMPLED:
        particles = _sample_particles(job, key, size)
        trajectory = particles.trajectory
    else:
        trajectory = rollout(problem, job.policy, start, goal, key, size)
    states = np.moveaxis(np.asarray(trajectory.states), -1, 0)[:used]
    if not np.isfinite(states).all():
        n, t = np.argwhere(~np.isfinite(states).all(axis=-1))[0]
        raise ValueError(
            f"{type(problem.mdp).__name__}.dynamics returned {states[n, t].tolist()} at step {t} "
            f"from state {states[n, t - 1].tolist()}: expected finite numbers"
        )
    numbers = _numbers(job, trajectory, particles, used)
    log_weight = log_weights(job.record, numbers) + numbers.log_correction
    return _Chunk(
        numbers,
        job.record.hypotheses.violations(
            states, job.record.space, problem.between_states, _actions_taken(job, trajectory, used)
        ),
        states[_at(_points(), log_weight)[0]],
        float(np.logaddexp.reduce(log_weight)),
    )


def _sample_particles(job: SamplingJob, key: jax.Array, size: int) -> Particles:
    """Sample a chunk of whole islands, `size` particles in all."""
    num_islands = size // job.island
    if job.method == TEMPERED:
        return temper(
            job.problem,
            job.policy,
            job.task,
            job.record.beta,
            num_islands=num_islands,
            num_particles=job.island,
            seed=int(jax.random.bits(key, dtype=jnp.uint32)),
        )
    assert isinstance(job.policy, ValuedPolicy)
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    return smc_rollout(job.policy, start, goal, key, num_islands, job.island)


def _numbers(
    job: SamplingJob, trajectory: Trajectory, particles: Particles | None, used: int
) -> _Numbers:
    """Return the numbers that determine the weights of the first `used` trajectories of a chunk."""
    numbers = _Numbers(
        np.asarray(trajectory.total_reward)[:used],
        np.asarray(trajectory.log_probability)[:used],
        np.asarray(trajectory.length)[:used],
        log_correction=np.zeros(used),
        ancestor=np.arange(used),
    )
    if particles is None:
        return numbers
    log_weight = np.asarray(particles.log_weight, np.float64)
    uncorrected = log_weights(job.record, numbers)
    allowed = np.isfinite(uncorrected)
    return numbers._replace(
        log_correction=np.where(allowed, log_weight - np.where(allowed, uncorrected, 0.0), 0.0),
        ancestor=np.asarray(particles.root, int) + job.island * (np.arange(used) // job.island),
    )


def _actions_taken(job: SamplingJob, trajectory: Trajectory, used: int) -> Actions | None:
    """Return the actions of trajectories, NaN after the end; None if no hypothesis needs them."""
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
    """Return the item that each point of the cumulative weight falls on, and how far into it.

    Args:
      points: [P] from 0 to 1.
      log_weight: [N] of the items, nats.

    Returns:
      item: [P] from 0 to N - 1; all 0 where every weight is 0.
      within: [P] from 0 to 1, the share of the item's own weight that lies before the point.
    """
    if np.isneginf(log_weight).all():  # `summarise` raises NothingLeftError for the whole task
        return np.zeros(len(points), int), np.zeros(len(points))
    cumulative = np.concatenate([[0.0], np.cumsum(estimators.normalise(log_weight))])
    cumulative /= cumulative[-1]
    item = np.searchsorted(cumulative, points, side="right") - 1
    within = (points - cumulative[item]) / np.diff(cumulative)[item]
    return item, within
