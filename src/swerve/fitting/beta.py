"""Fit beta, how strictly demonstrators follow the reward, by maximum likelihood.

M demonstrations in which only the known constraints were in force, with total rewards R_i, have

    log L(beta) = sum_i [beta R_i - log Z_0(task_i; beta)],
    d/dbeta log L = sum_i [R_i - E_beta R],

up to log m, which does not depend on beta. Log Z_0 and E_beta are estimated by the samples of each
task, weighed for beta (the paper, Theorem 2); the estimate of log L is concave as well.

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

from swerve.base.arguments import instance, number_or_nan
from swerve.base.forked import check_process
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.estimators import HOTTEST, least_effective
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import islands
from swerve.fitting.rewards import total_rewards
from swerve.inference.ranking import Ranking
from swerve.problem.problem import Problem

ROUNDING = 1e-5  # relative difference up to which total rewards, sums in float32, are the same
MILD = 0.5  # nats: log-weights with a smaller standard deviation let no few samples dominate
NUM_DOWN = 20  # steps from the sampling beta down, in the search for betas to be trusted
STEP_UP = 1.25  # factor between betas, in the search from the sampling beta up
MOST_UP = 60  # steps up at most: a factor of 650,000 in beta
NUM_HALVINGS = 45  # bisections of an interval of betas: more than double precision can tell apart


@dataclass(frozen=True)
class BetaFit:
    """The beta that makes demonstrations most likely.

    Attributes:
      beta: nats per unit of reward. Infinite where the demonstrations earn no less than the best
        sampled trajectories: by these samples the likelihood grows with beta without end (samples
        at a higher beta may give a finite beta). 0 where the demonstrations earn no more than
        random actions do. Both are "at the boundary", and no estimate.
      interval: the betas (low, high) whose log L is less than chi2_1(confidence) / 2 below the
        maximum; where beta is infinite, below log L at the highest beta to be trusted. An end that
        lies outside the betas to be trusted is 0 or infinite. Sampling error is left out.
      standard_error: standard error of beta, from sampling alone; NaN at the boundary.
      trusted: the betas (low, high) between which enough samples count in every task.
      confidence: confidence of the interval.
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
        """Return the fit as JSON data, with None for infinite numbers and NaN."""
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


def check_confidence(value: Any) -> None:
    """Raise ValueError if a confidence is not a number between 0 and 1."""
    if not 0.0 < number_or_nan(value) < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {value!r}")


def fit_beta(
    problem: Problem,
    evidence: Evidence,
    demonstrations: Sequence[Demonstration],
    confidence: float = 0.95,
) -> BetaFit:
    """Estimate beta from demonstrations in which only the known constraints were in force.

    Args:
      problem: the problem of the evidence, with its model; the problem's beta does not matter.
      evidence: samples for the task of each demonstration.
      demonstrations: at least one, with actions; of a tabular MDP, states may be enough.
      confidence: confidence of the interval, between 0 and 1.

    Returns:
      The fit. Doubts about the samples and the demonstrations are in the `warnings` of `infer`.

    Raises:
      ValueError: if an argument is of the wrong kind or range, the evidence is exact or of another
        problem, a demonstration has no evidence for its task or lacks actions, or the maximum lies
        where too few samples count: the message says at which beta to sample.
    """
    check_process()
    instance(problem, Problem, "problem", "give the model, not its record")
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    check_confidence(confidence)
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
      value: log L up to a constant, nats.
      score: derivative of log L, sum_i [R_i - E_beta R].
      score_error: standard error of the score, from sampling.
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
      log_weight: [K, N] log-weights of the samples at beta = 0, nats.
      ancestor: [K, N] which of the N trajectories at the start each sample comes from.
    """

    earned: float
    counts: np.ndarray
    total_reward: np.ndarray
    log_weight: np.ndarray
    ancestor: np.ndarray

    @classmethod
    def of(cls, evidence: Evidence, task_of: np.ndarray, rewards: np.ndarray) -> Likelihood:
        """Return log L of M demonstrations with these tasks [M] and total rewards [M]."""
        tasks, counts = np.unique(task_of, return_counts=True)
        samples, log_weight = evidence.samples, evidence.log_weight[tasks]
        reward = np.asarray(samples.total_reward[tasks], np.float64)
        reward = np.where(np.isfinite(log_weight), reward, 0.0)
        at_zero = log_weight - evidence.problem.beta * reward
        return cls(float(rewards.sum()), counts, reward, at_zero, samples.ancestor[tasks])

    def at(self, beta: float) -> Point:
        """Return log L, its derivatives and the effective sample size at one beta."""
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
        """Return (sum w)^2 / sum w^2 [K] of weights [K, N], summed by ancestor first."""
        group = self.ancestor + weight.shape[1] * np.arange(len(weight))[:, None]
        together = np.bincount(group.ravel(), weight.ravel(), weight.size).reshape(weight.shape)
        return 1.0 / (together**2).sum(axis=1)

    @property
    def best_earned(self) -> np.ndarray:
        """[K] the highest total reward among the samples of each task."""
        allowed = np.isfinite(self.log_weight)
        return np.where(allowed, self.total_reward, -np.inf).max(axis=1)

    @property
    def earns_most(self) -> bool:
        """Whether the demonstrations earn no less than the best samples, up to rounding."""
        scale = np.maximum(np.abs(self.best_earned), self.total_reward.std(axis=1))
        return bool(self.earned >= self.counts @ (self.best_earned - ROUNDING * scale))


def _of_problem(evidence: Evidence, problem: Problem) -> Evidence:
    """Return the evidence with the problem's own record, whose hypotheses may be code.

    Raises:
      ValueError: if the evidence is exact, or of another problem.
    """
    if evidence.is_exact:
        raise ValueError(
            f"evidence: exact answers by {evidence.solver} hold for their beta alone and have no "
            "samples to weigh: use a solver that is sampled"
        )
    record = dataclasses.replace(problem.record, beta=evidence.problem.beta)
    if record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            "evidence: expected evidence of the problem, whose beta alone may differ, got that of "
            f"{evidence.problem.summary} for {record.summary}"
        )
    return dataclasses.replace(evidence, problem=record)


def _trusted(likelihood: Likelihood, evidence: Evidence) -> tuple[float, float]:
    """Return the betas around the sampling beta between which enough samples of each task count.

    The lower beta is at least half of the sampling beta (see `HOTTEST`), unless a still
    lower beta needs only mild weights.

    Raises:
      ValueError: if too few samples count at the sampling beta itself.
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
    """Return the beta at which the derivative of log L is 0; 0 or infinity at the boundary.

    Raises:
      ValueError: if this beta is not one of the betas to be trusted.
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
                "which the samples are not to be trusted: sample at that beta (learn with it, or "
                f"use swerve.sample(nominal, tasks, beta={edge:.3g})) and fit again"
            )
    return _halved(lambda beta: likelihood.at(beta).score > 0.0, low, high)


def _interval(
    likelihood: Likelihood, beta: float, trusted: tuple[float, float], drop: float
) -> tuple[float, float]:
    """Return the betas (low, high) between which log L is less than `drop` below its best value."""
    (least, most), best = trusted, min(beta, trusted[1])
    level = likelihood.at(best).value - drop
    low, high = 0.0, math.inf
    if likelihood.at(least).value < level:
        low = _halved(lambda beta: likelihood.at(beta).value < level, least, best)
    if math.isfinite(beta) and likelihood.at(most).value < level:
        high = _halved(lambda beta: likelihood.at(beta).value > level, best, most)
    return low, high


def _halved(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return, by bisection, the beta up to which a condition holds; it holds at `low`."""
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _range(low: float, high: float) -> str:
    return f"{low:.3g} or more" if math.isinf(high) else f"{low:.3g} to {high:.3g}"
