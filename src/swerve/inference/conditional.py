"""Estimate log P(avoid c | avoid C) of every hypothesis c, as the constraints C in force grow.

With samples of weights w, this probability is estimated by the trajectories that avoid all of C,

    P(avoid c | avoid C) = 1 - sum_n w_n 1[n avoids C, enters c] / sum_n w_n 1[n avoids C].

A trajectory is taken out of the sums of all hypotheses once, when a constraint that the trajectory
enters comes into force. So all picks together unpack the bits at most once. Exact solvers solve
again with C in force.

Shapes: K tasks, N trajectories, H hypotheses, B = ceil(H / 8) bytes, M hypotheses asked for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from swerve.base.space import Task
from swerve.evidence import estimators
from swerve.evidence.estimators import LogRatio
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import estimated
from swerve.hypotheses.bits import blocks, bytes_of, num_bits, select_one
from swerve.inference.ranking import Ranking

if TYPE_CHECKING:
    from swerve.evidence.exact import ExactNominal

ROWS, COLUMNS = 256, 64  # trajectories, bytes: unpacked at a time, half a MB, to fit the cache
PART = 16  # bits in a part of a weight: sums of 256 parts have 24 bits, as float32 holds
NUM_PARTS = 3  # parts of a weight, which has 48 bits
DIGITS = 1e-2  # least share of a sum that may be left by subtraction: below, digits are lost


class Conditional(Protocol):
    """log P(avoid c | avoid C), nats; C holds, for each task, the constraints that count for it.

    Attributes:
      log_ratio: [K, H] the log-probabilities; to six digits where hardly any trajectory avoids c.
    """

    log_ratio: np.ndarray

    @property
    def effective_samples(self) -> float:
        """The least effective sample size of a task; infinite where answers are exact."""
        ...

    def add(self, index: int) -> None:
        """Put one more hypothesis in force."""
        ...

    def refined(self, indices: np.ndarray) -> LogRatio:
        """Return log ratios [K, M] of some hypotheses to all digits, with standard errors."""
        ...


def conditional(inference: Ranking, nominal: ExactNominal | None) -> Conditional:
    """Return the log ratios of an inference, with no constraint in force yet.

    Args:
      inference: inference from one demonstration or more.
      nominal: nominal distribution of an exact solver, if the evidence is exact.

    Raises:
      ValueError: if there is no demonstration; if the evidence is exact and the nominal
        distribution is missing, not exact, or of another problem; or if the evidence was sampled
        and a nominal distribution is given.
    """
    evidence = inference.evidence
    if not inference.demonstrations:
        raise ValueError("inference: expected one from at least one demonstration, got none")
    if not evidence.is_exact:
        if nominal is not None:
            raise ValueError(
                "nominal: this evidence was sampled, and its trajectories are reweighed: leave the "
                "nominal distribution out"
            )
        return SampledConditional(inference)
    if nominal is None:
        raise ValueError(
            "nominal: this evidence is exact and holds no samples to reweigh: give the nominal "
            "distribution that it came from"
        )
    if not hasattr(nominal, "answer"):
        raise ValueError(
            f"nominal: expected the nominal distribution of an exact solver, got {nominal!r}"
        )
    if nominal.problem.record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"nominal: expected that of {evidence.problem.summary}, got that of "
            f"{nominal.problem.record.summary}"
        )
    return ExactConditional(inference, nominal)


class SampledConditional:
    """Log ratios by sampled evidence.

    While no constraint is in force for a task, the task's log ratios are those of the evidence,
    including the ratios from `resolve`. After that, the trajectories alone give the log ratios.
    """

    def __init__(self, inference: Ranking) -> None:
        self._evidence = inference.evidence
        self._is_counted = inference.is_counted
        self._avoiding: dict[int, Avoiding] = {}
        self.log_ratio = inference.evidence.log_ratio.copy()

    @property
    def effective_samples(self) -> float:
        """Effective number of trajectories that avoid what is in force, the least of any task."""
        sizes = self._evidence.effective_sample_size.tolist()
        for k, avoiding in self._avoiding.items():
            sizes[k] = avoiding.effective_samples
        return float(min(sizes))

    def add(self, index: int) -> None:
        """Put one more hypothesis in force."""
        evidence = self._evidence
        for k in np.flatnonzero(self._is_counted[:, index]).tolist():
            if k not in self._avoiding:
                self._avoiding[k] = Avoiding(evidence, k)
            self._avoiding[k].put_in_force(index)
            self.log_ratio[k] = self._avoiding[k].log_ratio(self.log_ratio.shape[1])

    def refined(self, indices: np.ndarray) -> LogRatio:
        """Return log ratios [K, M] of some hypotheses to all digits, with standard errors."""
        evidence = self._evidence
        value, error = (x[:, indices] for x in (evidence.log_ratio, evidence.standard_error))
        columns, place = bytes_of(indices)
        for k, avoiding in self._avoiding.items():
            found = avoiding.refined(columns)
            for row, of_columns in zip((value[k], error[k]), found, strict=True):
                row[:] = of_columns[place]
        return LogRatio(value, error)


class Avoiding:
    """The trajectories of a task that avoid all constraints in force."""

    def __init__(self, evidence: Evidence, task: int) -> None:
        self._evidence, self._task = evidence, task
        self._log_weight = evidence.log_weight[task]
        self._violations = evidence.samples.violations[task]
        self._rows = np.flatnonzero(np.isfinite(self._log_weight))
        self._weigh()
        self._entered = np.zeros(num_bits(self._violations))
        avoid = evidence.avoid_probability_by_samples(task)
        self._entered[: len(avoid)] = 1.0 - avoid

    def _weigh(self) -> None:
        """Weigh the trajectories that are left, so that their weights sum to 1.

        Weights are rounded to whole numbers of 48 bits and split in parts that float32 adds up
        exactly: sums in float32 take about half as long as sums in float64.
        """
        self._weight = np.zeros(len(self._log_weight))
        self._weight[self._rows] = estimators.normalise(self._log_weight[self._rows])
        scale = self._weight.max() * 2.0 ** (-PART * NUM_PARTS)
        whole, shifts = np.rint(self._weight / scale), PART * np.arange(NUM_PARTS)
        parts = np.floor(whole / 2.0 ** shifts[:, None])
        parts[:-1] %= 2.0**PART
        self._parts, self._place = parts.astype(np.float32), scale * 2.0**shifts

    def put_in_force(self, index: int) -> None:
        """Leave out the trajectories that enter a hypothesis."""
        enters = select_one(self._violations, self._rows, index)
        entering, self._rows = self._rows[enters], self._rows[~enters]
        if not len(self._rows):
            return
        if len(entering) < len(self._rows) and self._weight[self._rows].sum() > DIGITS:
            self._entered -= self._sum(entering)
        else:  # fewer trajectories stay than leave, or the difference would lose digits
            self._weigh()
            self._entered = self._sum(self._rows)

    def _sum(self, rows: np.ndarray) -> np.ndarray:
        """Return the weight [8 B] of the trajectories `rows` that enter each hypothesis."""
        total = np.zeros_like(self._entered)
        for first in range(0, len(rows), ROWS):
            some = rows[first : first + ROWS]
            parts, packed = self._parts[:, some], self._violations[some]
            for hypotheses, bits in blocks(packed, COLUMNS):
                total[hypotheses] += self._place @ (parts @ bits.astype(np.float32))
        return total

    def log_ratio(self, num_hypotheses: int) -> np.ndarray:
        """Return the log ratios [H], nats; all 0 if no trajectory is left."""
        if not len(self._rows):
            return np.zeros(num_hypotheses)
        avoid = 1.0 - self._entered[:num_hypotheses] / self._weight[self._rows].sum()
        return np.log(np.maximum(avoid, self._resolution))

    @property
    def effective_samples(self) -> float:
        """The effective sample size of the trajectories that are left; 0 where none is."""
        ancestor = self._evidence.samples.ancestor[self._task, self._rows]
        log_weight = self._log_weight[self._rows]
        return estimators.effective_sample_size(log_weight, ancestor) if len(self._rows) else 0.0

    @property
    def _resolution(self) -> float:
        return self._evidence.resolution_among(self._task, self._rows)

    def refined(self, columns: np.ndarray) -> LogRatio:
        """Return log ratios and errors [8 M] of the hypotheses of M bytes, eight in each byte."""
        num_hypotheses = 8 * len(columns)
        if not len(self._rows):  # no trajectory is left to estimate the ratios
            return LogRatio(np.zeros(num_hypotheses), np.full(num_hypotheses, np.inf))
        left = np.full(len(self._log_weight), -np.inf)
        left[self._rows] = self._log_weight[self._rows]
        estimate = estimated(
            left,
            self._violations[:, columns],
            num_hypotheses,
            bool(self._evidence.are_independent[self._task]),
        )
        return estimators.log_ratio(estimate, self._resolution)


class ExactConditional:
    """Log ratios by an exact solver."""

    def __init__(self, inference: Ranking, nominal: ExactNominal) -> None:
        self._tasks = inference.evidence.tasks
        self._is_counted = inference.is_counted
        self._nominal = nominal
        self._in_force: list[int] = []
        self.log_ratio = inference.evidence.log_ratio.copy()

    @property
    def effective_samples(self) -> float:
        """Infinity: no samples are counted."""
        return math.inf

    def add(self, index: int) -> None:
        """Put one more hypothesis in force."""
        self._in_force.append(index)
        for k in np.flatnonzero(self._is_counted[:, index]).tolist():
            avoiding = [c for c in self._in_force if self._is_counted[k, c]]
            task = Task(*(values[k] for values in self._tasks))
            answer = self._nominal.answer(task, np.random.default_rng(0), avoiding=avoiding)
            self.log_ratio[k] = answer.log_ratio

    def refined(self, indices: np.ndarray) -> LogRatio:
        """Return log ratios [K, M] of some hypotheses, with standard errors of 0."""
        value = self.log_ratio[:, indices]
        return LogRatio(value, np.zeros_like(value))
