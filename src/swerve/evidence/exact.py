"""Give exact answers the form of evidence.

An exact solver gives log Z_0, Z_c / Z_0 for each hypothesis, and a few trajectories sampled from
pi_0, for pictures. For each of these trajectories

    log pi_0(xi) = beta R(xi) + log m(xi) - log Z_0.

Shapes: M sampled trajectories, T steps, n states, H hypotheses, B = ceil(H / 8) bytes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import (
    EXACT,
    NUM_ISLANDS,
    Samples,
    kept_paths,
    log_weights,
    summarise,
)
from swerve.problem.record import ProblemRecord

if TYPE_CHECKING:
    from swerve.problem.problem import Problem


class KeptTrajectories(NamedTuple):
    """Trajectories sampled from pi_0 for pictures; shorter ones repeat their last state.

    Attributes:
      states: [M, T+1, n].
      total_reward: [M] R(xi).
      length: [M] steps taken.
      violations: [M, B] packed bits.
    """

    states: np.ndarray
    total_reward: np.ndarray
    length: np.ndarray
    violations: np.ndarray


class ExactAnswer(NamedTuple):
    """The exact answer for one task.

    Attributes:
      log_partition: log Z_0, nats.
      log_ratio: [H] log Z_c / Z_0, nats; -inf where no trajectory avoids a hypothesis.
      kept: trajectories sampled from pi_0.
      step: time between two states of the kept trajectories [s]; the MDP's dt if None.
    """

    log_partition: float
    log_ratio: np.ndarray
    kept: KeptTrajectories
    step: float | None = None

    @property
    def avoid_probability(self) -> np.ndarray:
        """[H] Z_c / Z_0; 0 where the ratio underflows."""
        return np.exp(self.log_ratio)


class NamedSolver(Protocol):
    """A solver that messages can name."""

    @property
    def name(self) -> str:
        """Name of the solver on the command line."""
        ...


@runtime_checkable
class ExactNominal(Protocol):
    """A nominal distribution that answers without sampling."""

    @property
    def problem(self) -> Problem:
        """Problem that the nominal distribution belongs to."""
        ...

    @property
    def solver(self) -> NamedSolver:
        """Solver that made the nominal distribution."""
        ...

    def answer(
        self,
        task: Task,
        generator: np.random.Generator,
        advance: Callable[[float], None] = lambda share: None,
        avoiding: Sequence[int] = (),
    ) -> ExactAnswer:
        """Return the exact answer for a task; log Z_0 is -inf where no trajectory is allowed.

        Args:
          task: start [n] and goal [g].
          generator: random numbers for the trajectories that are kept for pictures.
          advance: called with the share of the task done since the last call; the shares add to 1.
          avoiding: hypotheses C in force. The answer then holds log Z_C and log P(avoid c | avoid
            C).
        """
        ...


def exact_evidence(
    record: ProblemRecord, task: Task, answer: ExactAnswer, solver: str, seed: int
) -> Evidence:
    """Return evidence of one task, with estimates that have no error.

    Raises:
      ValueError: if log Z_0 is not finite.
    """
    log_partition, kept = answer.log_partition, answer.kept
    if not math.isfinite(log_partition):
        raise ValueError(
            f"no trajectory is allowed, log Z_0 = {log_partition}: the goal cannot be reached "
            f"within the horizon of {record.num_steps} steps, or known constraints are in the way"
        )
    numbers = Samples(
        total_reward=kept.total_reward[None],
        log_probability=np.zeros((1, len(kept.length))),
        length=kept.length[None],
        log_correction=np.zeros((1, len(kept.length))),
        ancestor=np.arange(len(kept.length))[None],
        violations=kept.violations[None],
        kept=kept_paths(kept.states)[None],
        soft_value=np.array([log_partition]),
    )
    samples = numbers._replace(log_probability=log_weights(record, numbers) - log_partition)
    timed = record if answer.step is None else dataclasses.replace(record, dt=answer.step)
    summary = summarise(timed, samples, EXACT)._replace(
        avoid_probability=answer.avoid_probability[None],
        avoid_variance=np.zeros((1, len(answer.log_ratio))),
        log_ratio=answer.log_ratio[None],
        log_ratio_error=np.zeros((1, len(answer.log_ratio))),
        log_partition=np.array([log_partition]),
        kl=np.zeros(1),
        island_log_partition=np.full((1, NUM_ISLANDS), log_partition),
        avoid_without_island=answer.avoid_probability[None, None].astype(np.float32),
        effective_sample_size=np.array([float(len(kept.length))]),
    )
    return Evidence(
        problem=record,
        tasks=Task(task.start[None], task.goal[None]),
        method=EXACT,
        num_trajectories=len(kept.length),
        solver=solver,
        seed=seed,
        summary=summary,
        load_samples=lambda: samples,
    )
