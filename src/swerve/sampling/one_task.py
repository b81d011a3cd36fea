"""Drawing the trajectories of one task: in chunks, judged and reduced as they come.

Shapes: N trajectories, T steps, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, n states.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.space import Actions, Task
from swerve.evidence import estimators
from swerve.evidence.samples import NUM_ISLANDS, NUM_KEPT, RESAMPLED, TEMPERED, Samples, log_weights
from swerve.problem.problem import Problem, ProblemRecord
from swerve.sampling.smc import Particles, smc_rollout
from swerve.sampling.tempering import temper
from swerve.simulation.policies import ValuedPolicy
from swerve.simulation.trajectory import Policy, Trajectory, rollout

CHUNK = 1024  # trajectories rolled out at once: their activations stay in cache


class Job(NamedTuple):
    """One task to be sampled.

    Attributes:
      record: of the problem whose pi_0 is wanted; its beta may be another one than `problem` has.
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
        """Trajectories of an island, where they are resampled."""
        return whole_islands(self.num_trajectories)[1]


class _Numbers(NamedTuple):
    """What trajectories are weighed by, each [N]; see `Samples`."""

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    log_correction: np.ndarray
    ancestor: np.ndarray


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


def whole_islands(num_trajectories: int) -> tuple[int, int]:
    """Return how many islands hold at least so many trajectories, and how many are in each.

    None is larger than a chunk, and their number is a multiple of NUM_ISLANDS.
    """
    part = -(-num_trajectories // NUM_ISLANDS)
    split = -(-part // CHUNK)
    return NUM_ISLANDS * split, -(-part // split)


def draw_task(job: Job, run_all: Callable, advance: Callable[..., None]) -> Samples:
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
    # a point in the cumulative weight of all chunks names a chunk and a point in that chunk's
    chunk, within = _at(_points(), np.array([chunk.log_total for chunk in chunks]))
    place = np.minimum((within * NUM_KEPT).astype(int), NUM_KEPT - 1)
    kept = np.stack([chunks[c].kept[k] for c, k in zip(chunk, place, strict=True)])
    return Samples(*columns, kept=kept[None], soft_value=_soft_value(job)[None])


def _chunk_sizes(job: Job) -> list[int]:
    """Return how many trajectories to draw in each chunk; all but the last the same number.

    A chunk of trajectories that are resampled is made of whole islands.
    """
    if job.method in RESAMPLED:
        num_islands, island = whole_islands(job.num_trajectories)
        at_once = CHUNK // island
        while num_islands % at_once:
            at_once -= 1
        return [at_once * island] * (num_islands // at_once)
    num_chunks = -(-job.num_trajectories // CHUNK)
    size = -(-job.num_trajectories // num_chunks)
    return [min(size, job.num_trajectories - k * size) for k in range(num_chunks)]


def _soft_value(job: Job) -> np.ndarray:
    """Return log Z_0 of the task by the solver's own soft value, NaN where it has none."""
    if not isinstance(job.policy, ValuedPolicy) or job.method == TEMPERED:
        return np.array(np.nan)
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    return np.asarray(_value_at_start(job.policy, start, goal), np.float64)


@eqx.filter_jit
def _value_at_start(policy: ValuedPolicy, start: jax.Array, goal: jax.Array) -> jax.Array:
    return policy.soft_value(start, jnp.zeros((), jnp.int32), goal)


def _sample_chunk(job: Job, key: jax.Array, size: int, used: int) -> _Chunk:
    """Roll out one chunk of trajectories, and judge those that are used."""
    problem = job.problem
    start, goal = (jnp.asarray(values, jnp.float32) for values in job.task)
    particles = None
    if job.method in RESAMPLED:
        island = job.island
        if job.method == TEMPERED:
            particles = temper(
                problem,
                job.policy,
                job.task,
                job.record.beta,
                num_islands=size // island,
                num_particles=island,
                seed=int(jax.random.bits(key)),
            )
        else:
            assert isinstance(job.policy, ValuedPolicy)
            particles = smc_rollout(job.policy, start, goal, key, size // island, island)
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


def _numbers(job: Job, trajectory: Trajectory, particles: Particles | None, used: int) -> _Numbers:
    """Return what the trajectories of a chunk are weighed by, those that are used."""
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
    drawn_by = log_weights(job.record, numbers)
    allowed = np.isfinite(drawn_by)
    return numbers._replace(
        log_correction=np.where(allowed, log_weight - np.where(allowed, drawn_by, 0.0), 0.0),
        ancestor=np.asarray(particles.root, int) + job.island * (np.arange(used) // job.island),
    )


def _actions_taken(job: Job, trajectory: Trajectory, used: int) -> Actions | None:
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
