"""Sample the nominal distribution, and reduce the trajectories to evidence on the way.

Trajectories of each task are rolled out in chunks on as many threads as there are cores, judged
against all hypotheses at once and dropped. Evidence keeps their reward, log-probability, length and
one bit per hypothesis, and a few whole trajectories for pictures.

Shapes: K tasks, N trajectories, T steps, H hypotheses, M kept trajectories, n states, g goal
dimensions.
"""

from __future__ import annotations

import dataclasses
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np

from swerve.base.arguments import positive_number, seed_number, whole_number
from swerve.base.progress import progress_bar
from swerve.base.solver_kinds import kind_named, solver_names
from swerve.base.space import Task
from swerve.evidence.estimators import NothingLeftError
from swerve.evidence.evidence import Evidence
from swerve.evidence.exact import ExactNominal, exact_evidence
from swerve.evidence.samples import EXACT, METHODS, RESAMPLED, TEMPERED, Samples, summarise
from swerve.hypotheses.bits import num_bytes
from swerve.problem.record import ProblemRecord
from swerve.problem.tasks import checked_tasks
from swerve.sampling.missed import share_missed
from swerve.sampling.motion import motion_of
from swerve.sampling.one_task import SamplingJob, sample_task, whole_islands
from swerve.simulation.policies import ValuedPolicy
from swerve.solvers.base import ManyBetasNominal, Nominal, PolicyNominal


def sample(
    nominal: Nominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int = 10_000,
    *,
    method: str | None = None,
    beta: float | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Evidence:
    """Sample trajectories of each task and judge them against every hypothesis.

    Args:
      nominal: result of `learn`.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      num_trajectories: N for each task; exact solvers ignore it.
      method: "importance" weighs each trajectory by target over proposal: right however imperfect
        the policy, as long as it reaches all modes. "smc" also resamples trajectories by weight on
        the way (sequential Monte Carlo; N is rounded up to a multiple of 20); it needs a soft value
        ("grid", "soft-value", "distilled") and is the default for these solvers. "plain" weighs
        all trajectories alike, as the paper does. Exact solvers take no method.
      beta: beta of the demonstrator, if it is not the beta learned for. A soft value that was
        learned for a span of beta is used directly; otherwise trajectories are tempered to this
        beta (the paper, Theorem 2; see `tempering`), whatever the policy, and `method` is left out.
        For a beta near the one learned for, `Evidence.at_beta` is quicker.
      seed: seed of the sampling. A task's trajectories depend on the seed and the task alone.
      progress: whether to show a progress bar.

    Returns:
      Evidence for these tasks, in their order.

    Raises:
      ValueError: if an argument is of the wrong kind or range, a task does not fit the problem, or
        the dynamics return NaN.
    """
    found = dict(
        sample_each(
            nominal,
            tasks,
            num_trajectories,
            method=method,
            beta=beta,
            seed=seed,
            progress=progress,
        )
    )
    first, *others = (found[k] for k in sorted(found))
    return first.joined(*others)


def sample_each(
    nominal: Nominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int,
    *,
    method: str | None,
    beta: float | None = None,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield each task's number and evidence as soon as the task is sampled; see `sample`.

    Tasks with the same goal follow one another, whatever the order of the tasks.
    """
    if beta is not None:
        beta = positive_number(beta, "beta")
        if isinstance(nominal, ManyBetasNominal) and nominal.covers(beta):
            nominal, beta = nominal.at_beta(beta), None
    if beta is not None:
        if method not in (None, TEMPERED):
            raise ValueError(
                f"method: {TEMPERED!r} is the only one for a beta that was not learned, so leave "
                f"{method!r} out"
            )
        method = TEMPERED
    if isinstance(nominal, ExactNominal):
        yield from _answer_each(nominal, tasks, method, seed, progress)
    elif isinstance(nominal, PolicyNominal):
        if method is None:
            has_value = kind_named(nominal.solver.name).has_soft_value
            method = "smc" if has_value else "importance"
        if method not in METHODS and beta is None:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
        record = nominal.problem.record
        if beta is not None:
            record = dataclasses.replace(record, beta=beta)
        yield from _sample_each(nominal, tasks, num_trajectories, method, record, seed, progress)
    else:
        raise ValueError(f"nominal: expected what swerve.learn returns, got {nominal!r}")


def _answer_each(
    nominal: ExactNominal,
    tasks: Task | Sequence[Task],
    method: str | None,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield the number and the exact evidence of each task."""
    if method == TEMPERED:
        raise ValueError(
            f"beta: the {nominal.solver.name} solver gives exact answers for the problem's beta: "
            "learn a problem with this beta"
        )
    if method not in (None, EXACT):
        raise ValueError(
            f"method: the {nominal.solver.name} solver gives exact answers, so there is nothing to "
            f"sample by {method!r}: leave method out"
        )
    seed = seed_number(seed)
    batch = checked_tasks(nominal.problem, tasks)
    record = nominal.problem.record
    with progress_bar("working out", len(batch.start), progress) as advance:
        for k in range(len(batch.start)):
            task = Task(batch.start[k], batch.goal[k])
            generator = np.random.default_rng([seed, zlib.crc32(np.concatenate(task).tobytes())])
            with _naming(k, task):
                answer = nominal.answer(task, generator, advance)
                evidence = exact_evidence(record, task, answer, repr(nominal.solver), seed)
            yield k, dataclasses.replace(evidence, motion=motion_of(nominal.problem))


def _sample_each(
    nominal: PolicyNominal,
    tasks: Task | Sequence[Task],
    num_trajectories: int,
    method: str,
    record: ProblemRecord,
    seed: int,
    progress: bool,
) -> Iterator[tuple[int, Evidence]]:
    """Yield the number and the evidence of each task, sampled for the beta of a record."""
    batch = checked_tasks(nominal.problem, tasks)
    num_trajectories = whole_number(num_trajectories, "num_trajectories", 2)
    if method in RESAMPLED:
        num_trajectories = math.prod(whole_islands(num_trajectories))
    seed = seed_number(seed)
    _check_memory(len(batch.start), num_trajectories, len(nominal.problem.hypotheses))
    goals, goal_of_task = np.unique(batch.goal, axis=0, return_inverse=True)
    total = (len(batch.start) + len(goals)) * num_trajectories  # a goal costs as much as a task
    workers = ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0)))
    with workers, progress_bar("sampling", total, progress) as advance:
        policies = nominal.policies(goals, lambda share: advance(share * num_trajectories))
        for goal, policy in enumerate(policies):
            for k in np.flatnonzero(goal_of_task.reshape(-1) == goal).tolist():
                task = Task(batch.start[k], batch.goal[k])
                job = SamplingJob(
                    nominal.problem, record, policy, task, num_trajectories, method, seed
                )
                if method == "smc" and not isinstance(policy, ValuedPolicy):
                    valued = ", ".join(solver_names(lambda kind: kind.has_soft_value))
                    raise ValueError(
                        f"method: 'smc' needs a solver with a soft value ({valued}), got "
                        f"{nominal.solver.name!r}: use 'importance'"
                    )
                with _naming(k, task):
                    evidence = _sampled(job, sample_task(job, workers.map, advance), nominal)
                yield k, evidence


def _sampled(job: SamplingJob, samples: Samples, nominal: PolicyNominal) -> Evidence:
    """Return the evidence of one task from its samples."""
    task, summary = job.task, summarise(job.record, samples, job.method)
    missed = share_missed(job, float(summary.log_partition[0]))
    return Evidence(
        problem=job.record,
        tasks=Task(task.start[None], task.goal[None]),
        method=job.method,
        num_trajectories=job.num_trajectories,
        solver=repr(nominal.solver),
        seed=job.seed,
        summary=summary,
        load_samples=lambda: samples,
        missed_share=np.array([missed]),
        motion=motion_of(job.problem),
    )


@contextmanager
def _naming(k: int, task: Task) -> Iterator[None]:
    """Put the task into the message of a ValueError that is raised inside the block."""
    try:
        yield
    except ValueError as error:
        kind = NothingLeftError if isinstance(error, NothingLeftError) else ValueError
        raise kind(
            f"task {k}, from {task.start.tolist()} to {task.goal.tolist()}: {error}"
        ) from error


def _check_memory(num_tasks: int, num_trajectories: int, num_hypotheses: int) -> None:
    """Raise ValueError where one bit per (task, trajectory, hypothesis) does not fit memory."""
    needed = num_tasks * num_trajectories * num_bytes(num_hypotheses)
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise ValueError(
            f"{num_trajectories:,} trajectories of {num_tasks:,} tasks judged against "
            f"{num_hypotheses:,} hypotheses take {needed / 2**30:,.0f} GiB of memory, and this "
            f"machine has {there / 2**30:,.0f} GiB: take fewer trajectories, tasks or hypotheses"
        )
