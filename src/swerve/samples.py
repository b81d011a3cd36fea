"""Sampled trajectories reduced to numbers and bits, and summed up in small tables.

Shapes: K tasks, N trajectories, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, T steps,
n states.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from swerve import estimators
from swerve.problem import ProblemRecord

METHODS = ("importance", "plain")
EXACT = "exact"  # what the method of evidence is called that a solver gave without sampling
NUM_KEPT = 100  # whole trajectories of a task that are kept for pictures


class Sampled(Protocol):
    """What has the numbers that a trajectory is weighed by, each [..., N]."""

    @property
    def total_reward(self) -> Any:
        """R(xi); -inf where a known constraint was entered."""
        ...

    @property
    def log_probability(self) -> Any:
        """Log-probability under the policy that drew them, nats."""
        ...

    @property
    def length(self) -> Any:
        """Steps taken."""
        ...


class Samples(NamedTuple):
    """Sampled trajectories reduced to what estimates need.

    Attributes:
      total_reward: [K, N] R(xi); -inf where a known constraint was entered.
      log_probability: [K, N] log pi(xi) under the policy that drew it, nats.
      length: [K, N] steps taken.
      violations: [K, N, B] packed bits, set where trajectory n enters hypothesis h.
      kept: [K, M, T+1, n] a few whole trajectories, drawn by weight, for pictures.
      soft_value: [K] log Z_0 by the solver's own soft value, nats; NaN where it has none.
    """

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    violations: np.ndarray
    kept: np.ndarray
    soft_value: np.ndarray


class Summary(NamedTuple):
    """Estimates for each task, the part of evidence that inference reads.

    Attributes:
      avoid_probability: [K, H] Z_c / Z_0.
      avoid_variance: [K, H] its sampling variance.
      log_ratio: [K, H] its log, nats, which exact answers know where the ratio is no number.
      log_partition: [K] log Z_0, nats.
      kl: [K] KL(pi || pi_0) by the estimated log Z_0, nats.
      effective_sample_size: [K] of the importance weights, whatever the method.
      soft_value: [K] log Z_0 by the solver's own soft value, nats; NaN where it has none.
      end: [K, n] the middle of the box of states where the trajectories kept end.
      end_reach: [K, n] half the sides of that box.
      shortest: [K] duration of the shortest trajectory [s].
      fastest: [K, n] the fastest change of each state [a second] in the trajectories kept.
    """

    avoid_probability: np.ndarray
    avoid_variance: np.ndarray
    log_ratio: np.ndarray
    log_partition: np.ndarray
    kl: np.ndarray
    effective_sample_size: np.ndarray
    soft_value: np.ndarray
    end: np.ndarray
    end_reach: np.ndarray
    shortest: np.ndarray
    fastest: np.ndarray


def summarise(problem: ProblemRecord, samples: Samples, method: str) -> Summary:
    """Estimate what inference needs from sampled trajectories of K tasks."""
    rows = []
    for k, log_weight in enumerate(log_weights(problem, samples)):
        used = equalise(log_weight) if method == "plain" else log_weight
        estimate = estimators.avoid_probability(
            used, samples.violations[k], len(problem.hypotheses)
        )
        log_partition = estimators.log_partition(log_weight)
        kept = samples.kept[k]
        speed = np.abs(problem.space.difference(kept[:, :-1], kept[:, 1:])) / problem.dt
        rows.append(
            (
                *estimate,
                _log(estimate.avoid_probability),
                log_partition,
                estimators.kl_divergence(log_weight, log_partition),
                estimators.effective_sample_size(log_weight),
                samples.soft_value[k],
                *_end_box(problem, kept[:, -1]),
                samples.length[k][np.isfinite(log_weight)].min() * problem.dt,
                speed.max(axis=(0, 1)),
            )
        )
    return Summary(*(np.array(column) for column in zip(*rows, strict=True)))


def _log(values: np.ndarray) -> np.ndarray:
    """Return logs, -inf of 0."""
    with np.errstate(divide="ignore"):
        return np.log(values)


def _end_box(problem: ProblemRecord, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle [n] and half the sides [n] of the box around states [M, n]."""
    away = problem.space.difference(ends[0], ends)
    low, high = away.min(axis=0), away.max(axis=0)
    return ends[0] + 0.5 * (low + high), 0.5 * (high - low)


def log_weights(problem: ProblemRecord, sampled: Sampled) -> np.ndarray:
    """Return l = beta R + log m - log pi of trajectories [..., N], nats."""
    return estimators.log_weights(
        np.asarray(sampled.total_reward),
        np.asarray(sampled.log_probability),
        np.asarray(sampled.length),
        beta=problem.beta,
        measure=problem.measure,
        num_actions=problem.num_actions,
    )


def equalise(log_weight: np.ndarray) -> np.ndarray:
    """Return 0 where a trajectory is allowed, -inf where it entered a known constraint."""
    return np.where(np.isfinite(log_weight), 0.0, -np.inf)
