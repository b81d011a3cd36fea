"""Give the estimates of evidence: violation probabilities, and how far to trust them.

    log_ratio[task, c] = log(Z_c / Z_0) = log P_{xi ~ pi_0}(xi avoids c)    (the paper, Theorem 1)

Shapes: K tasks, N trajectories, H hypotheses, I islands, n states, g goal dimensions.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from swerve.base.pickling import PickledByFields
from swerve.base.space import Task
from swerve.evidence import estimators
from swerve.evidence.motion import Motion
from swerve.evidence.samples import EXACT, Samples, Summary, log_weights, weights_used
from swerve.hypotheses.bits import select
from swerve.problem.record import ProblemRecord

MISSED_ERRORS = 10.0  # least errors that samples state: they must not miss more of pi_0 than this


@dataclass(frozen=True, eq=False)
class Quantities(PickledByFields):
    """Violation probabilities of every hypothesis under pi_0, for each of K tasks.

    `swerve.Evidence` describes the fields.
    """

    problem: ProblemRecord
    tasks: Task
    method: str
    num_trajectories: int
    solver: str
    seed: int
    summary: Summary
    load_samples: Callable[[], Samples] = dataclasses.field(repr=False)
    sampling_beta: float = None  # pyright: ignore[reportAssignmentType]  # set below
    motion: Motion | None = None
    missed_share: np.ndarray = None  # pyright: ignore[reportAssignmentType]  # set below
    load_reward: Callable[[], np.ndarray] | None = dataclasses.field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.sampling_beta is None:
            object.__setattr__(self, "sampling_beta", self.problem.beta)
        if self.missed_share is None:
            object.__setattr__(self, "missed_share", np.full(self.num_tasks, np.nan))

    def __getstate__(self) -> dict[str, Any]:
        loaded = {"load_samples": partial(_given, self.samples), "load_reward": None}
        return super().__getstate__() | loaded

    @cached_property
    def samples(self) -> Samples:
        """The trajectories, reduced; read from the file on first use."""
        return self.load_samples()

    @cached_property
    def total_reward(self) -> np.ndarray:
        """[K, N] R(xi) of the trajectories; -inf where a known constraint was entered."""
        return self.samples.total_reward if self.load_reward is None else self.load_reward()

    @property
    def num_tasks(self) -> int:
        """K, the number of tasks."""
        return len(self.tasks.start)

    @property
    def is_exact(self) -> bool:
        """Whether the solver gave answers without sampling."""
        return self.method == EXACT

    @property
    def is_of_other_beta(self) -> bool:
        """Whether the trajectories were sampled for a beta other than the problem's."""
        return self.sampling_beta != self.problem.beta

    @property
    def violation_probability(self) -> np.ndarray:
        """[K, H] probability that a nominal trajectory enters each hypothesis, 1 - Z_c / Z_0."""
        return 1.0 - self.summary.avoid_probability

    @cached_property
    def sample_of(self) -> np.ndarray:
        """[K] number of each task's sample, from 0: equal tasks have the same trajectories."""
        return np.unique(np.hstack(self.tasks), axis=0, return_inverse=True)[1].reshape(-1)

    @cached_property
    def resolution(self) -> np.ndarray:
        """[K] the least probability that the samples can tell from 0: one trajectory's share.

        The share is 1 / ESS for importance weights. For equal weights the share is 1 / N, where N
        is the number of trajectories that enter no known constraint. The share is 0 if answers are
        exact.
        """
        if self.is_exact:
            return np.zeros(self.num_tasks)
        if self._has_equal_weights:
            return 1.0 / self._num_allowed
        return 1.0 / self.effective_sample_size

    def resolution_among(self, task: int, rows: np.ndarray) -> float:
        """Return the share of one trajectory among some trajectories of a task, as `resolution`.

        Args:
          task: number of the task.
          rows: [M] indices of the trajectories.
        """
        ancestor = None
        if not self.are_independent[task]:
            ancestor = self.samples.ancestor[task, rows]
        log_weights = [self.log_weight[task, rows]]
        if self.method == "plain" and self.is_of_other_beta:
            log_weights.append(self.importance_log_weight[task, rows])
        return 1.0 / min(estimators.effective_sample_size(x, ancestor) for x in log_weights)

    def avoid_probability_by_samples(self, task: int) -> np.ndarray:
        """Return Z_c / Z_0 [H] of a task by its trajectories alone, without those of `resolve`."""
        found = self.summary.avoid_probability[task].copy()
        resolved = np.flatnonzero(self.is_resolved[task])
        bits = select(self.samples.violations[task], resolved)
        found[resolved] = estimators.normalise(self.log_weight[task]) @ (1.0 - bits)
        return found

    @property
    def is_missing(self) -> np.ndarray:
        """[K] True where the samples miss more of pi_0 than their stated errors allow for."""
        return self.missed_share > MISSED_ERRORS * self.resolution

    @property
    def has_too_few(self) -> np.ndarray:
        """[K] True where the effective sample size is too low to trust any estimate."""
        return self.effective_sample_size < estimators.least_effective(self.num_trajectories)

    @property
    def is_floored(self) -> np.ndarray:
        """[K, H] True where the weight that avoids a hypothesis is below one trajectory's share.

        The samples then only show that the ratio is small: `log_ratio` is the log of the share, an
        upper bound.
        """
        return (self.summary.avoid_probability < self.resolution[:, None]) & ~self.is_resolved

    @property
    def log_ratio(self) -> np.ndarray:
        """[K, H] log(Z_c / Z_0) in nats, at least log(resolution); -inf where Z_c is exactly 0."""
        return self._estimate.value

    @property
    def standard_error(self) -> np.ndarray:
        """[K, H] standard error of `log_ratio` in nats (delta method).

        The error is at least `resolution`, the change that one more trajectory could make. The
        error is 1 where the ratio is floored, and 0 where answers are exact.
        """
        return self._estimate.standard_error

    @cached_property
    def _estimate(self) -> estimators.LogRatio:
        summary = self.summary
        if self.is_exact:
            return estimators.LogRatio(summary.log_ratio, summary.log_ratio_error)
        estimate = estimators.Estimate(summary.avoid_probability, summary.avoid_variance)
        sampled = estimators.log_ratio(estimate, self.resolution)
        known, error = self.is_resolved, summary.log_ratio_error
        return estimators.LogRatio(
            np.where(known, summary.log_ratio, sampled.value),
            np.where(known, error, sampled.standard_error),
        )

    @property
    def is_resolved(self) -> np.ndarray:
        """[K, H] True where the ratio was sampled with the constraint in force, or is exact."""
        return np.isfinite(self.summary.log_ratio_error)

    @property
    def log_partition(self) -> np.ndarray:
        """[K] log Z_0, nats."""
        return self.summary.log_partition

    @property
    def kl(self) -> np.ndarray:
        """[K] KL(pi || pi_0) by the estimated log Z_0, nats: an alarm, not a measurement.

        For "smc" and "tempered" the number is KL(pi_0 || pi), since their trajectories follow pi_0.
        After `at_beta`, pi is still the policy that sampled the trajectories, while pi_0 is that of
        the new beta. With "plain", pi_0 stays that of `sampling_beta`, since plain weights assume
        pi = pi_0.
        """
        return self.summary.kl

    @property
    def soft_value(self) -> np.ndarray:
        """[K] log Z_0 by the solver's soft value, nats; NaN without a soft value at this beta."""
        return self.summary.soft_value

    @property
    def effective_sample_size(self) -> np.ndarray:
        """[K] effective sample size of the importance weights, whatever the method.

        With method "plain" all N trajectories have equal weight, and this number says how far to
        trust them. At another beta, this number is the effective sample size of the weights used,
        if that is smaller.
        """
        return self.summary.effective_sample_size

    @property
    def distinct_share(self) -> np.ndarray:
        """[K] share of the initial trajectories that have descendants; 1 without resampling."""
        return self.summary.distinct_share

    @property
    def are_independent(self) -> np.ndarray:
        """[K] True where no two trajectories descend from the same one at the start."""
        return self.distinct_share == 1.0

    @property
    def island_log_partition(self) -> np.ndarray:
        """[K, I] log Z_0 by each of I independent parts (islands) of the samples, nats."""
        return self.summary.island_log_partition

    @cached_property
    def island_spread(self) -> np.ndarray:
        """[K] standard deviation of log Z_0 over islands, nats; infinite if an island weighs 0."""
        log_partition = self.island_log_partition
        is_lost = np.isneginf(log_partition)
        spread = np.where(is_lost, 0.0, log_partition).std(axis=1)
        return np.where(is_lost.any(axis=1), np.inf, spread)

    @property
    def log_partition_error(self) -> np.ndarray:
        """[K] standard error of `log_partition` by the spread over islands, nats."""
        return self.island_spread / math.sqrt(self.island_log_partition.shape[1] - 1)

    @cached_property
    def log_weight(self) -> np.ndarray:
        """[K, N] log-weights that `method` uses, nats; for "plain" (beta - sampling_beta) R."""
        return weights_used(self.problem, self.samples, self.method, self.sampling_beta)

    @cached_property
    def importance_log_weight(self) -> np.ndarray:
        """[K, N] l = beta R + log m - log pi, plus the correction for resampling, nats."""
        return log_weights(self.problem, self.samples) + self.samples.log_correction

    def hoeffding_error(self, confidence: float = 0.95) -> float:
        """Return the bound on each probability's error (the paper, III-C.2); equal weights only.

        The bound is on the sampling error alone, not on the distance of the policy from pi_0.

        Raises:
          ValueError: if the weights are not equal.
        """
        if not self._has_equal_weights:
            made = f"by {self.method!r}"
            if self.is_of_other_beta:
                made += f" at beta {self.sampling_beta:g}, not {self.problem.beta:g}"
            raise ValueError(
                f"Hoeffding's bound needs equal weights (method 'plain'), this evidence was made "
                f"{made}: use standard_error"
            )
        return estimators.hoeffding_error(int(self._num_allowed.min()), confidence)

    @property
    def _num_allowed(self) -> np.ndarray:
        """[K] number of trajectories that enter no known constraint: only these have a weight."""
        if not self.problem.known:
            return np.full(self.num_tasks, self.num_trajectories)
        return np.isfinite(self.total_reward).sum(axis=1)

    @property
    def _has_equal_weights(self) -> bool:
        return self.method == "plain" and not self.is_of_other_beta


def _given(samples: Samples) -> Samples:
    """Return the trajectories that evidence was pickled with."""
    return samples
