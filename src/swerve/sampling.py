"""Sampling the nominal distribution, reduced to evidence as it goes.

Trajectories of each task are rolled out in chunks on as many threads as there are cores, judged
against all hypotheses at once and dropped; what is kept is their reward, log-probability, length
and one bit a hypothesis.

Shapes: K tasks, N trajectories, T steps, H hypotheses, n states, g goal dimensions.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve import estimators
from swerve.constraints import Constraint
from swerve.evidence import METHODS, Evidence, Samples, summarise
from swerve.nominal import Nominal
from swerve.problem import Problem, ProblemRecord
from swerve.progress import progress_bar
from swerve.space import Task
from swerve.trajectory import Policy, rollout

CHUNK = 2048  # trajectories rolled out at once: their activations stay in cache
NUM_KEPT = 100


def sample(
    nominal: Nominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int = 10_000,
    *,
    method: str = "importance",
    seed: int = 0,
    progress: bool = False,
) -> Evidence:
    """Sample trajectories of each task and judge them against every hypothesis.

    Args:
      nominal: from `learn`.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      num_trajectories: N for each task.
      method: "importance" weighs each trajectory by target over proposal, so that the answer is
        right however imperfect the policy, as long as it covers all modes; "plain" weighs all
        alike, as the paper does.
      seed: of the sampling. A task's trajectories depend on the seed and the task alone, not on
        the other tasks of the call.
      progress: whether to show a progress bar.

    Returns:
      Evidence for these tasks.

    Raises:
      ValueError: if a task does not fit the problem, or the dynamics return NaN.
    """
    problem = nominal.problem
    batch = checked_tasks(problem, tasks)
    if method not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    if num_trajectories < 2:
        raise ValueError(f"num_trajectories: expected at least 2, got {num_trajectories}")
    record = problem.record
    goals, goal_of_task = np.unique(batch.goal, axis=0, return_inverse=True)
    samples: dict[int, Samples] = {}
    total = len(batch.start) * num_trajectories
    workers = ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0)))
    with workers, progress_bar("sampling", total, progress) as advance:
        for goal, policy in enumerate(nominal.policies(goals)):
            for k in np.flatnonzero(goal_of_task.reshape(-1) == goal):
                task = Task(batch.start[k], batch.goal[k])
                job = _Job(problem, record, policy, task, num_trajectories, seed)
                samples[int(k)] = _sample_task(job, workers.map, advance)
    stacked = Samples(
        *(np.stack(column) for column in zip(*(samples[k] for k in sorted(samples)), strict=True))
    )
    return Evidence(
        problem=record,
        tasks=batch,
        method=method,
        num_trajectories=num_trajectories,
        solver=repr(nominal.solver),
        seed=seed,
        summary=summarise(record, stacked, method),
        load_samples=lambda: stacked,
    )


def checked_tasks(problem: Problem, tasks: Task | Iterable[Task]) -> Task:
    """Return tasks as one batch, starts [K, n] and goals [K, g], float64.

    Raises:
      ValueError: if shapes are wrong, numbers not finite, or a start lies where no trajectory can
        begin.
    """
    mdp = problem.mdp
    batch = tasks if isinstance(tasks, Task) else Task.stack(list(tasks))
    start = np.atleast_2d(np.asarray(batch.start, np.float64))
    goal = np.asarray(batch.goal, np.float64).reshape(len(start), -1)
    for label, values, names in (
        ("start", start, mdp.state_names),
        ("goal", goal, mdp.goal_names),
    ):
        if values.shape[1] != len(names):
            raise ValueError(
                f"tasks: expected a {label} of {len(names)} numbers ({', '.join(names)}), "
                f"got {values.shape[1]}"
            )
        if not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise ValueError(f"tasks: {label} of task {bad} is not finite: {values[bad].tolist()}")
    ended = jax.vmap(mdp.terminated)(jnp.asarray(start), jnp.asarray(goal))
    for k in range(len(start)):
        inside: list[Constraint] = [c for c in problem.known if c.contains(start[k], mdp.space)]
        if inside:
            raise ValueError(
                f"tasks: task {k} starts at {start[k].tolist()}, inside the known constraint "
                f"{inside[0].name}"
            )
        if ended[k]:
            raise ValueError(
                f"tasks: task {k} starts at {start[k].tolist()}, where the episode is already over"
            )
    return Task(start, goal)


class _Job(NamedTuple):
    """One task to be sampled."""

    problem: Problem
    record: ProblemRecord
    policy: Policy
    task: Task
    num_trajectories: int
    seed: int


class _Chunk(NamedTuple):
    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    violations: np.ndarray
    states: np.ndarray


def _sample_task(job: _Job, run_all: Callable, advance: Callable[..., None]) -> Samples:
    """Sample the trajectories of one task, chunk by chunk."""
    num_chunks = -(-job.num_trajectories // CHUNK)
    size = -(-job.num_trajectories // num_chunks)
    numbers = np.concatenate([job.task.start, job.task.goal])
    key = jax.random.fold_in(jax.random.key(job.seed), zlib.crc32(numbers.tobytes()))

    def run(chunk_key: jax.Array) -> _Chunk:
        chunk = _sample_chunk(job, chunk_key, size)
        advance(job.num_trajectories / num_chunks)
        return chunk

    chunks = list(run_all(run, jax.random.split(key, num_chunks)))
    joined = _Chunk(
        *(np.concatenate(part)[: job.num_trajectories] for part in zip(*chunks, strict=True))
    )
    return Samples(*joined[:4], kept=_keep(job, joined))


def _sample_chunk(job: _Job, key: jax.Array, size: int) -> _Chunk:
    """Roll out and judge one chunk of trajectories."""
    problem, task = job.problem, job.task
    trajectory = rollout(
        problem,
        job.policy,
        jnp.asarray(task.start, jnp.float32),
        jnp.asarray(task.goal, jnp.float32),
        key,
        size,
    )
    states = np.moveaxis(np.asarray(trajectory.states), -1, 0)
    if not np.isfinite(states).all():
        n, t = np.argwhere(~np.isfinite(states).all(axis=-1))[0]
        raise ValueError(
            f"{type(problem.mdp).__name__}.dynamics returned {states[n, t].tolist()} at step {t} "
            f"from state {states[n, t - 1].tolist()}: expected finite numbers"
        )
    space = job.record.space
    return _Chunk(
        np.asarray(trajectory.total_reward),
        np.asarray(trajectory.log_probability),
        np.asarray(trajectory.length),
        job.record.hypotheses.violations(states, space, problem.between_states),
        states,
    )


def _keep(job: _Job, chunk: _Chunk) -> np.ndarray:
    """Draw a few whole trajectories by weight, evenly spaced through the cumulative weights."""
    log_weight = estimators.log_weights(
        chunk.total_reward,
        chunk.log_probability,
        chunk.length,
        beta=job.record.beta,
        measure=job.record.measure,
        num_actions=job.record.num_actions,
    )
    cumulative = np.cumsum(estimators.normalise(log_weight))
    points = (np.arange(NUM_KEPT) + 0.5) / NUM_KEPT * cumulative[-1]
    return chunk.states[np.searchsorted(cumulative, points)]
