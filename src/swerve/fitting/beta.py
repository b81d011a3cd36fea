"""How strictly demonstrators follow the reward: beta by maximum likelihood.

Of M demonstrations that nothing but the known constraints held back, with what each earned, R_i,

    log L(beta) = sum_i [beta R_i - log Z_0(task_i; beta)],
    d/dbeta log L = sum_i [R_i - E_beta R],

but for log m, which does not depend on beta. Log Z_0 and E_beta are estimated by the samples of
each task, weighed for beta (the paper, Theorem 2), so log L is concave for the estimate as well.

Shapes: M demonstrations, K tasks, N trajectories, I islands.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from swerve.base.arguments import instance
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.estimators import least_effective
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import islands
from swerve.fitting.rewards import total_rewards
from swerve.inference.ranking import Ranking
from swerve.problem.problem import Problem
from swerve.trust.verdicts import HOTTEST

ROUNDING = 1e-5  # relative, of total rewards in float32: closer ones are the same
MILD = 0.5  # nats: standard deviation of a change of log-weights that does no harm
NUM_DOWN = 20  # even steps downwards in the search for betas to be trusted
STEP_UP = 1.25  # factor, in the same search upwards
MOST_UP = 60  # steps upwards at most: a factor of 650,000
NUM_HALVINGS = 45  # of an interval of betas


@dataclass(frozen=True)
class BetaFit:
    """The beta that makes demonstrations most likely.

    Attributes:
      beta: nats per unit of reward. Infinite where the demonstrations earn no less than the best
        trajectories sampled, so that by these the likelihood grows with beta for ever (those of a
        higher beta may tell another story); 0 where they earn no more than acting at random does.
        Either is "at the boundary", and no estimate.
      interval: the betas (low, high) whose log L is less than chi2_1(confidence) / 2 below the
        maximum, or where beta is infinite below that at the highest beta to be trusted. An end that
        lies where no beta is to be trusted is 0 or infinite. Sampling error is not part of it.
      standard_error: of beta, from sampling alone; NaN at the boundary.
      trusted: the betas (low, high) between which enough samples count in every task.
      confidence: of the interval.
    """

    beta: float
    interval: tuple[float, float]
    standard_error: float
    trusted: tuple[float, float]
    confidence: float

    @property
    def at_boundary(self) -> bool:
        """Whether the likelihood, by these samples, has no maximum between 0 and infinity."""
        return self.beta == 0.0 or math.isinf(self.beta)

    def __str__(self) -> str:
        low, high = self.interval
        if math.isinf(self.beta):
            return (
                f"beta at the boundary: at least {low:.3g}, as the demonstrations earn no less "
                f"than the best trajectories sampled: sample at beta {self.trusted[1]:.3g} and fit "
                "again to tell more"
            )
        if self.beta == 0.0:
            return (
                f"beta at the boundary: {_range(low, high)}, as the demonstrations earn no more "
                "than acting at random does"
            )
        return (
            f"beta {self.beta:.3g}, {100 * self.confidence:g} % interval {_range(low, high)}, "
            f"standard error from sampling alone {self.standard_error:.2g}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fit as JSON data, with None for what is infinite or no number."""
        numbers = {
            "beta": self.beta,
            "low": self.interval[0],
            "high": self.interval[1],
            "standard_error": self.standard_error,
            "trusted_low": self.trusted[0],
            "trusted_high": self.trusted[1],
            "confidence": self.confidence,
        }
        finite = {name: x if math.isfinite(x) else None for name, x in numbers.items()}
        return finite | {"at_boundary": self.at_boundary}


def fit_beta(
    problem: Problem,
    evidence: Evidence,
    demonstrations: Sequence[Demonstration],
    confidence: float = 0.95,
) -> BetaFit:
    """Estimate beta from demonstrations that no constraint but the known ones held back.

    Args:
      problem: the model that the evidence is of; its beta does not matter.
      evidence: samples for the task of each demonstration.
      demonstrations: at least one, with actions; of a tabular MDP, states alone may do.
      confidence: of the interval.

    Returns:
      The fit. What speaks against the samples and the demonstrations is in the `warnings` of
      `infer`.

    Raises:
      ValueError: if an argument is of the wrong kind or range, the evidence is exact or of another
        problem, a demonstration has no evidence for its task or lacks actions, or the maximum lies
        where too few samples count: the message says at which beta to sample.
    """
    instance(problem, Problem, "problem", "give the model, not its record")
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    judged = Ranking.of(_of_problem(evidence, problem), demonstrations)
    rewards = total_rewards(problem, demonstrations)
    likelihood = Likelihood.of(evidence, judged.task_of, rewards)
    trusted = _trusted(likelihood, evidence)
    drop = 0.5 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) ** 2
    beta = _best(likelihood, trusted)
    found = likelihood.at(min(beta, trusted[1]))
    error = math.nan
    if 0.0 < beta < math.inf:
        error = found.score_error / found.curvature
    interval = _interval(likelihood, beta, trusted, drop)
    return BetaFit(beta, interval, error, trusted, confidence)


class Point(NamedTuple):
    """Log L at one beta.

    Attributes:
      value: log L but for a constant, nats.
      score: its derivative, sum_i [R_i - E_beta R].
      score_error: standard error of that, from sampling.
      curvature: minus the second derivative, sum_i Var_beta R.
      effective_sample_size: [K] of the samples weighed for beta.
    """

    value: float
    score: float
    score_error: float
    curvature: float
    effective_sample_size: np.ndarray


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Log L of demonstrations as a function of beta.

    Attributes:
      earned: sum_i R_i.
      counts: [K] demonstrations of each task, at least one.
      total_reward: [K, N] R of the samples; 0 where a known constraint was entered.
      log_weight: [K, N] their log-weights at beta = 0, nats.
      ancestor: [K, N] which of the N trajectories at the start each comes from.
    """

    earned: float
    counts: np.ndarray
    total_reward: np.ndarray
    log_weight: np.ndarray
    ancestor: np.ndarray

    @classmethod
    def of(cls, evidence: Evidence, task_of: np.ndarray, rewards: np.ndarray) -> Likelihood:
        """Return that of M demonstrations of these tasks [M] that earned this [M]."""
        tasks, counts = np.unique(task_of, return_counts=True)
        samples, log_weight = evidence.samples, evidence.log_weight[tasks]
        reward = np.asarray(samples.total_reward[tasks], np.float64)
        reward = np.where(np.isfinite(log_weight), reward, 0.0)
        at_zero = log_weight - evidence.problem.beta * reward
        return cls(float(rewards.sum()), counts, reward, at_zero, samples.ancestor[tasks])

    def at(self, beta: float) -> Point:
        """Return log L at one beta, and what goes with it."""
        reward, counts = self.total_reward, self.counts
        log_weight = self.log_weight + beta * reward
        largest = log_weight.max(axis=1, keepdims=True)
        weight = np.exp(log_weight - largest)
        total = weight.sum(axis=1, keepdims=True)
        log_partition = (largest + np.log(total / weight.shape[1]))[:, 0]
        weight /= total
        mean = (weight * reward).sum(axis=1, keepdims=True)
        deviation = weight * (reward - mean)
        parts = islands(weight.shape[1])
        by_island = np.add.reduceat(deviation, [part[0] for part in parts], axis=1)
        error = len(parts) / (len(parts) - 1) * (by_island**2).sum(axis=1)
        return Point(
            float(beta * self.earned - counts @ log_partition),
            float(self.earned - counts @ mean[:, 0]),
            float(np.sqrt(counts**2 @ error)),
            float(counts @ (deviation * (reward - mean)).sum(axis=1)),
            self._effective(weight),
        )

    def _effective(self, weight: np.ndarray) -> np.ndarray:
        """Return (sum w)^2 / sum w^2 [K], weights [K, N] of the same ancestor being added first."""
        group = self.ancestor + weight.shape[1] * np.arange(len(weight))[:, None]
        together = np.bincount(group.ravel(), weight.ravel(), weight.size).reshape(weight.shape)
        return 1.0 / (together**2).sum(axis=1)

    @property
    def best_earned(self) -> np.ndarray:
        """[K] what the best sample of each task earns."""
        allowed = np.isfinite(self.log_weight)
        return np.where(allowed, self.total_reward, -np.inf).max(axis=1)

    @property
    def earns_most(self) -> bool:
        """Whether the demonstrations earn no less than the best samples, but for rounding."""
        scale = np.maximum(np.abs(self.best_earned), self.total_reward.std(axis=1))
        return bool(self.earned >= self.counts @ (self.best_earned - ROUNDING * scale))


def _of_problem(evidence: Evidence, problem: Problem) -> Evidence:
    """Return evidence with the problem's own record, whose hypotheses may be code.

    Raises:
      ValueError: if it is exact, of another problem, or no search can start from its beta.
    """
    if evidence.is_exact:
        raise ValueError(
            f"evidence: exact answers by {evidence.solver} hold for their beta alone and have no "
            "samples to weigh: use a solver that is sampled"
        )
    record = dataclasses.replace(problem.record, beta=evidence.problem.beta)
    if record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            "evidence: expected that of the problem, whose beta alone may differ, got evidence of "
            f"{evidence.problem.summary} for {record.summary}"
        )
    return dataclasses.replace(evidence, problem=record)


def _trusted(likelihood: Likelihood, evidence: Evidence) -> tuple[float, float]:
    """Return the betas around the sampling beta between which enough samples of each task count.

    The lower one is half of the sampling beta at least (see `trust.is_too_hot`), unless it takes no
    more than mild weights to get below.

    Raises:
      ValueError: if too few do at the sampling beta itself.
    """
    beta, least = evidence.sampling_beta, least_effective(evidence.num_trajectories)

    def holds(beta: float) -> bool:
        return bool((likelihood.at(beta).effective_sample_size >= least).all())

    here = likelihood.at(beta)
    if not holds(beta):
        left = here.effective_sample_size.min()
        raise ValueError(
            f"evidence: expected an effective sample size of at least {least:.0f} in every task at "
            f"beta {beta:g}, at which it was sampled, got {left:.0f}: sample more trajectories, or "
            "train the policy longer"
        )
    spread = math.sqrt(here.curvature / likelihood.counts.sum())  # of R
    lowest = min(HOTTEST * beta, beta - MILD / spread) if spread > 0.0 else 0.0
    down = list(itertools.takewhile(holds, np.linspace(beta, max(0.0, lowest), NUM_DOWN + 1)))
    up = list(itertools.takewhile(holds, beta * STEP_UP ** np.arange(MOST_UP + 1)))
    return float(down[-1]), float(up[-1])


def _best(likelihood: Likelihood, trusted: tuple[float, float]) -> float:
    """Return the beta at which the derivative of log L is 0, or 0 or infinity if none is.

    Raises:
      ValueError: if it is none of the betas to be trusted.
    """
    low, high = trusted
    if likelihood.earns_most:
        return math.inf
    if low == 0.0 and likelihood.at(0.0).score <= 0.0:
        return 0.0
    for edge, sign, where in ((low, -1.0, "below"), (high, 1.0, "above")):
        if sign * likelihood.at(edge).score > 0.0:
            raise ValueError(
                f"the likelihood of the demonstrations is greatest {where} beta {edge:.3g}, for "
                "which the samples are not to be trusted: sample at that beta (a problem of it, or "
                f"swerve.sample(nominal, tasks, beta={edge:.3g})) and fit again"
            )
    return _halved(lambda beta: likelihood.at(beta).score > 0.0, low, high)


def _interval(
    likelihood: Likelihood, beta: float, trusted: tuple[float, float], drop: float
) -> tuple[float, float]:
    """Return the betas (low, high) whose log L is less than `drop` below that of the best one."""
    (least, most), best = trusted, min(beta, trusted[1])
    level = likelihood.at(best).value - drop
    low, high = 0.0, math.inf
    if likelihood.at(least).value < level:
        low = _halved(lambda beta: likelihood.at(beta).value < level, least, best)
    if math.isfinite(beta) and likelihood.at(most).value < level:
        high = _halved(lambda beta: likelihood.at(beta).value > level, best, most)
    return low, high


def _halved(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return where, between two betas, that ends which holds at the lower one."""
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _range(low: float, high: float) -> str:
    return f"{low:.3g} or more" if math.isinf(high) else f"{low:.3g} to {high:.3g}"
