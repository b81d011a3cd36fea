"""Estimate Z_0 and Z_c / Z_0 by self-normalised importance sampling, whatever the method.

With log-weights l(xi) = beta R(xi) + log m(xi) - log pi(xi) of N trajectories sampled from pi,

    log Z_0 ~ logsumexp(l) - log N,    Z_c / Z_0 ~ sum_k w_k 1[xi_k avoids c] / sum_k w_k,

w = exp(l). With equal weights the second formula is the paper's Theorem 1. All numbers are float64.

Shapes: N trajectories, H hypotheses.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from swerve.base.arguments import whole_number
from swerve.base.groups import sums_of_groups
from swerve.hypotheses.bits import entered_blocks, num_bits

BLOCK = 128  # bytes, of 8 hypotheses each, unpacked at a time: bounds the memory


class Estimate(NamedTuple):
    """Estimates of Z_c / Z_0 for H hypotheses.

    Attributes:
      avoid_probability: [H] Z_c / Z_0, the nominal probability of avoiding c.
      avoid_variance: [H] sampling variance of `avoid_probability` (delta method).
    """

    avoid_probability: np.ndarray
    avoid_variance: np.ndarray


class Parts(NamedTuple):
    """Each group's share of the total weight, and the part that avoids each hypothesis.

    Attributes:
      weight: [G] weights of the groups, which sum to 1.
      avoided: [G, H] weight of the trajectories of a group that avoid each hypothesis.
    """

    weight: np.ndarray
    avoided: np.ndarray

    def variance(self) -> np.ndarray:
        """Return the sampling variance [H] of Z_c / Z_0 where only groups are independent.

        var = G / (G - 1) sum_g (sum_{n in g} w_n (1[n avoids] - p))^2

        The variance is infinite where one group has all the weight: one group shows no spread.
        """
        num = len(self.weight)
        if np.count_nonzero(self.weight) < 2:
            return np.full(self.avoided.shape[1], np.inf)
        deviation = self.avoided - self.weight[:, None] * self.avoided.sum(axis=0)
        return num / (num - 1) * (deviation**2).sum(axis=0)

    def avoid_without(self) -> np.ndarray:
        """Return Z_c / Z_0 [G, H] without one group each; 0 if other groups have no weight."""
        left = 1.0 - self.weight[:, None]
        avoided = np.clip(self.avoided.sum(axis=0) - self.avoided, 0.0, None)
        return np.divide(avoided, left, out=np.zeros_like(avoided), where=left > 0.0)


def parts(
    log_weight: np.ndarray, violations: np.ndarray, num_hypotheses: int, group: np.ndarray
) -> Parts:
    """Return the weight of each group of trajectories, and the part that avoids each hypothesis.

    Args:
      log_weight: [N] nats.
      violations: [N, ceil(H / 8)] packed bits.
      num_hypotheses: H.
      group: [N] each trajectory's group, from 0 to G - 1.

    Raises:
      ValueError: if a log-weight is NaN, or all log-weights are -inf.
    """
    weight = normalise(log_weight)
    members = (group == np.arange(group.max() + 1)[:, None]) * weight
    weight = members.sum(axis=1)
    avoided = np.repeat(weight[:, None], num_bits(violations), axis=1)
    for hypotheses, bits in entered_blocks(violations, BLOCK):
        entered = members @ bits.astype(np.float64)
        avoided[:, hypotheses] -= entered
        rare = entered.sum(axis=0) > 0.5  # few avoid: the difference would be rounding error
        avoided[:, hypotheses[rare]] = members @ (1.0 - bits[:, rare])
    return Parts(weight, avoided[:, :num_hypotheses])


LOW_ESS_SHARE = 0.02  # share of N: an effective sample size below this share is not trusted
LOW_ESS = 100.0  # trajectories: an effective sample size below this number is never trusted
HOTTEST = 0.5  # share of the sampling beta: below, weights of a Gaussian have infinite variance


class NothingLeftError(ValueError):
    """Every sampled trajectory enters a known constraint."""


class LogRatio(NamedTuple):
    """Estimates of log Z_c / Z_0, nats.

    Attributes:
      value: [..., H] log Z_c / Z_0.
      standard_error: [..., H] standard error of `value`.
    """

    value: np.ndarray
    standard_error: np.ndarray


def log_weights(
    total_reward: np.ndarray,
    log_probability: np.ndarray,
    length: np.ndarray,
    *,
    beta: float,
    measure: str,
    num_actions: int,
) -> np.ndarray:
    """Return l = beta R + log m - log pi [...], in nats; -inf where a known constraint is entered.

    Args:
      total_reward: [...] R(xi).
      log_probability: [...] log pi(xi).
      length: [...] steps taken.
      beta: inverse temperature of the target.
      measure: "uniform", m = A^-length, or "counting", m = 1.
      num_actions: A.

    Raises:
      ValueError: if a weight is NaN or +inf.
    """
    total_reward = np.asarray(total_reward, np.float64)
    log_probability = np.asarray(log_probability, np.float64)
    forbidden = np.isneginf(total_reward)
    log_weight = beta * np.where(forbidden, 0.0, total_reward) - log_probability
    if measure == "uniform":
        log_weight = log_weight - length * math.log(num_actions)
    if not np.isfinite(log_weight).all():
        raise ValueError(
            f"{np.count_nonzero(~np.isfinite(log_weight))} of {log_weight.size} log-weights are "
            "not finite: the reward or the policy returned NaN or an infinite value"
        )
    return np.where(forbidden, -np.inf, log_weight)


def normalise(log_weight: np.ndarray) -> np.ndarray:
    """Return weights [N] that sum to 1.

    Raises:
      ValueError: if a log-weight is NaN, or all log-weights are -inf.
    """
    weight = np.exp(log_weight - _largest(log_weight))
    return weight / weight.sum()


def log_partition(log_weight: np.ndarray) -> float:
    """Return the estimate of log Z_0 [nats] from log-weights [N].

    Raises:
      ValueError: if a log-weight is NaN, or all log-weights are -inf.
    """
    largest = _largest(log_weight)
    return float(largest + np.log(np.mean(np.exp(log_weight - largest))))


def effective_sample_size(log_weight: np.ndarray, group: np.ndarray | None = None) -> float:
    """Return (sum w)^2 / sum w^2, between 1 and N.

    Args:
      log_weight: [N] nats.
      group: [N] each trajectory's group, from 0; the weights of a group are added first.

    Raises:
      ValueError: if a log-weight is NaN, or all log-weights are -inf.
    """
    weight = normalise(log_weight)
    if group is not None:
        weight = np.bincount(group, weight)
    return float(1.0 / np.sum(weight**2))


def kl_divergence(log_weight: np.ndarray, log_partition: float) -> float:
    """Return KL(pi || pi_0) = log Z_0 - E_pi[l] [nats].

    Where some trajectories enter a known constraint, pi is restricted to the other trajectories,
    since only these count in the estimates.

    Args:
      log_weight: [N] of trajectories sampled from pi, nats.
      log_partition: log Z_0; exact for a measurement, estimated for an alarm.

    Raises:
      ValueError: if a log-weight is NaN, or all log-weights are -inf.
    """
    _largest(log_weight)
    allowed = log_weight[np.isfinite(log_weight)]
    return float(log_partition - allowed.mean() - math.log(len(allowed) / len(log_weight)))


def avoid_probability(
    log_weight: np.ndarray, violations: np.ndarray, num_hypotheses: int
) -> Estimate:
    """Estimate Z_c / Z_0 for every hypothesis (the paper, Theorem 1 and eq. 7).

    Args:
      log_weight: [N] log target minus log proposal density, nats; equal for Theorem 1.
      violations: [N, ceil(H / 8)] packed bits, set where trajectory n enters hypothesis h.
      num_hypotheses: H.

    Returns:
      Estimate with [H] probabilities and variances.

    Raises:
      ValueError: if N differs, a log-weight is NaN, or all log-weights are -inf.
    """
    if len(log_weight) != len(violations):
        raise ValueError(
            f"expected one row of violations a log-weight, got {len(violations)} rows and "
            f"{len(log_weight)} weights"
        )
    weight = normalise(log_weight)
    rows = np.stack([weight, weight**2])
    entered = np.zeros((2, num_bits(violations)))
    avoided = np.tile([[1.0], [rows[1].sum()]], entered.shape[1])
    for hypotheses, bits in entered_blocks(violations, BLOCK):
        entered[:, hypotheses] = rows @ bits.astype(np.float64)
        avoided[:, hypotheses] -= entered[:, hypotheses]
        rare = entered[0, hypotheses] > 0.5  # few avoid: the difference would be rounding error
        avoided[:, hypotheses[rare]] = rows @ (1.0 - bits[:, rare])
    (entered, entered_square), (avoided, avoided_square) = (
        sums[:, :num_hypotheses] for sums in (entered, avoided)
    )
    # sum w^2 (1[avoids] - p)^2 over trajectories that avoid, then over trajectories that enter
    variance = np.maximum(avoided_square, 0.0) * entered**2 + entered_square * avoided**2
    return Estimate(avoided, variance)


def least_effective(num_trajectories: int) -> float:
    """Return the least effective sample size that is trusted, of N trajectories."""
    return max(LOW_ESS, LOW_ESS_SHARE * num_trajectories)


def log_ratio(estimate: Estimate, resolution: Any) -> LogRatio:
    """Return log Z_c / Z_0 and its standard error (delta method), nats.

    A probability below one trajectory's share cannot be told from 0. There the estimate is the log
    of the share, an upper bound, with an error of 1. Elsewhere the error is at least the share.

    Args:
      estimate: [..., H].
      resolution: [...] one trajectory's share, 1 / N or 1 / ESS.
    """
    least = np.asarray(resolution)[..., None]
    avoid = np.maximum(estimate.avoid_probability, least)
    relative = np.maximum(np.sqrt(estimate.avoid_variance) / avoid, least)
    is_floored = estimate.avoid_probability < least
    return LogRatio(np.log(avoid), np.where(is_floored, 1.0, relative))


def joint_error(error: np.ndarray, sample_of: np.ndarray) -> np.ndarray:
    """Return the standard error [...] of a sum over tasks from the error of each term [K, ...].

    Tasks of the same sample share all their trajectories: their errors are the same error, and add
    up. Errors of different samples are independent.

    Args:
      error: [K, ...] standard errors of the terms.
      sample_of: [K] number of each task's sample, from 0.
    """
    together = sums_of_groups(error, sample_of, int(sample_of.max(initial=0)) + 1)
    return np.linalg.norm(together, axis=0)


def hoeffding_error(num_trajectories: int, confidence: float = 0.95) -> float:
    """Return e with P(|error| > e) <= 1 - confidence for N equal weights (the paper, III-C.2).

    Raises:
      ValueError: if `confidence` is not between 0 and 1, or there is no trajectory.
    """
    whole_number(num_trajectories, "num_trajectories", 1)
    return math.sqrt(math.log(2.0 / _miss_probability(confidence)) / (2.0 * num_trajectories))


def hoeffding_sample_size(error: float, confidence: float = 0.95) -> int:
    """Return how many trajectories of equal weight bound the error (the paper, III-C.2).

    Raises:
      ValueError: if `error` or `confidence` is not between 0 and 1.
    """
    if not 0.0 < error < 1.0:
        raise ValueError(f"error: expected a number between 0 and 1, got {error}")
    return math.ceil(math.log(2.0 / _miss_probability(confidence)) / (2.0 * error**2))


def _largest(log_weight: np.ndarray) -> float:
    """Return the largest log-weight.

    Raises:
      NothingLeftError: if every weight is 0.
      ValueError: if a log-weight is NaN.
    """
    largest = float(log_weight.max())
    if math.isnan(largest):
        raise ValueError(f"{np.isnan(log_weight).sum()} of {log_weight.size} log-weights are NaN")
    if largest == -math.inf:
        raise NothingLeftError(
            f"all {log_weight.size} sampled trajectories enter a known constraint: nothing is left "
            "to weigh; check the known constraints and the starts, or use a better policy"
        )
    return largest


def _miss_probability(confidence: float) -> float:
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    return 1.0 - confidence
