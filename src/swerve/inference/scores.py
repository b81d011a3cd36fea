"""Score each hypothesis by demonstrations: log-likelihood ratios and their standard errors.

Demonstrations that all avoid c have, against no constraint at all, the log-likelihood ratio

    log L(c) = - sum_i log(Z_c / Z_0)(task_i) >= 0 nats.

A demonstration that enters c rules c out, unless demonstrations may sometimes ignore the constraint
(see `likelihood`).

Shapes: D demonstrations, K tasks, H hypotheses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swerve.base.groups import sums_of_groups
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.estimators import joint_error
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import HypothesisSet
from swerve.inference import likelihood

FEW_AVOID = 0.5  # nats: a larger standard error shows that fewer than four trajectories avoid
SETTLED = 0.09  # nats: largest standard error of a ratio sampled with the constraint in force


@dataclass(frozen=True, eq=False)
class Scores:
    """Measures of how well each hypothesis explains the demonstrations.

    `swerve.Inference` describes the fields.
    """

    evidence: Evidence
    demonstrations: tuple[Demonstration, ...]
    task_of: np.ndarray
    entered: np.ndarray
    score_name: str
    is_counted: np.ndarray
    tolerance: float
    prior: np.ndarray
    judged: HypothesisSet

    @cached_property
    def task_counts(self) -> np.ndarray:
        """[K] number of demonstrations per task; all 1 without demonstrations (prior ranking)."""
        if not self.demonstrations:
            return np.ones(self.evidence.num_tasks, int)
        return np.bincount(self.task_of, minlength=self.evidence.num_tasks)

    @cached_property
    def counts(self) -> likelihood.Counts:
        """[K, H] numbers of demonstrations, where they count, that avoid and enter a hypothesis."""
        entering = sums_of_groups(self.entered, self.task_of, self.evidence.num_tasks)
        avoiding = self.task_counts[:, None] - entering
        return likelihood.Counts(avoiding * self.is_counted, entering * self.is_counted)

    @cached_property
    def is_used(self) -> np.ndarray:
        """[K, H] True where demonstrations of a task count for or against a hypothesis."""
        return (self.task_counts[:, None] > 0) & self.is_counted

    @cached_property
    def impossible(self) -> np.ndarray:
        """[H] True where, by exact evidence, no trajectory of some task avoids a hypothesis."""
        if not self.evidence.is_exact:
            return np.zeros(len(self.prior) - 1, bool)
        return np.asarray((np.isneginf(self.evidence.log_ratio) & self.is_used).any(axis=0))

    @cached_property
    def struck_out(self) -> np.ndarray:
        """[H] True where a demonstration enters a hypothesis, or no trajectory can avoid it.

        With a tolerance above 0 no demonstration rules a hypothesis out.
        """
        if self.tolerance > 0.0:
            return self.impossible
        return np.asarray((self.counts.entering > 0).any(axis=0)) | self.impossible

    @cached_property
    def log_likelihood(self) -> np.ndarray:
        """[H] log-likelihood ratio against no constraint [nats]; -inf if struck out."""
        value = likelihood.log_likelihood(self.finite_log_ratio, self.counts, self.tolerance)
        return np.where(self.struck_out, -np.inf, value)

    @cached_property
    def contributions(self) -> np.ndarray:
        """[D, H] amount that each demonstration adds to `log_likelihood` [nats]; -inf rules out."""
        avoiding = likelihood.avoiding_term(self.finite_log_ratio, self.tolerance)[self.task_of]
        entering = math.log(self.tolerance) if self.tolerance > 0.0 else -np.inf
        added = np.where(self.entered, entering, avoiding)
        return np.where(self.is_counted[self.task_of], added, 0.0)

    @cached_property
    def finite_log_ratio(self) -> np.ndarray:
        """[K, H] log Z_c / Z_0, nats; replaced by 0 where no demonstration uses the ratio."""
        return np.where(self.is_used & ~self.impossible, self.evidence.log_ratio, 0.0)

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """[K, H] minus the derivative of `log_likelihood` by log Z_c / Z_0 of each task."""
        slope = likelihood.sensitivity(self.finite_log_ratio, self.tolerance)
        return np.where(self.struck_out, 0.0, self.counts.avoiding * slope)

    @cached_property
    def standard_error(self) -> np.ndarray:
        """[H] standard error of `log_likelihood` [nats]; tasks that differ are independent."""
        return joint_error(self._likelihood_error, self.evidence.sample_of)

    @property
    def _likelihood_error(self) -> np.ndarray:
        """[K, H] amount that a task adds to `standard_error`; unused ratios may have no error."""
        error = np.where(self.sensitivity > 0.0, self.evidence.standard_error, 0.0)
        return self.sensitivity * error

    @cached_property
    def average_violation(self) -> np.ndarray:
        """[H] violation probability averaged over the demonstrations (the paper's score)."""
        num = self.task_counts[:, None] * self.is_counted
        return (num * self.evidence.violation_probability).sum(axis=0) / np.maximum(
            num.sum(axis=0), 1
        )

    @cached_property
    def is_lower_bound(self) -> np.ndarray:
        """[H] True where almost every nominal trajectory of a task enters, see `is_floored`.

        A task counts only if one of its demonstrations avoids the hypothesis.
        """
        floored = self.evidence.is_floored & (self.counts.avoiding > 0)
        return np.asarray(floored.any(axis=0))

    @cached_property
    def is_open(self) -> np.ndarray:
        """[K, H] True where `resolve` can help: a ratio in use is a bound, or few avoid.

        False where `resolve` was tried, where a task starts inside the hypothesis, and where log
        Z_0 is too uncertain: half of the allowed error may come from log Z_0.
        """
        evidence = self.evidence
        able = ~evidence.has_too_few
        able &= evidence.log_partition_error < SETTLED / math.sqrt(2.0)
        untried = np.isnan(evidence.summary.log_ratio_error)
        is_open = evidence.standard_error > FEW_AVOID
        is_open &= untried & able[:, None] & (self.counts.avoiding > 0) & ~self.struck_out
        for index in np.flatnonzero(is_open.any(axis=0)).tolist():
            constraint = evidence.problem.hypotheses.constraint(index)
            is_open[:, index] &= ~constraint.contains(evidence.tasks.start, evidence.problem.space)
        return is_open

    @property
    def score(self) -> np.ndarray:
        """[H] the number by which hypotheses are ranked; -inf where struck out."""
        if self.score_name == "likelihood":
            return self.log_likelihood
        return np.where(self.struck_out, -np.inf, self.average_violation)

    @cached_property
    def task_error(self) -> np.ndarray:
        """[K, H] amount that a task's demonstrations add to the standard error of `score`."""
        if self.score_name == "likelihood":
            return self._likelihood_error
        num = self.task_counts[:, None] * self.is_counted
        share = num / np.maximum(num.sum(axis=0), 1)
        error = np.sqrt(np.where(num > 0, self.evidence.summary.avoid_variance, 0.0))
        return np.asarray(share * error)

    @cached_property
    def score_error(self) -> np.ndarray:
        """[H] standard error of `score`; tasks that differ are independent."""
        return joint_error(self.task_error, self.evidence.sample_of)
