"""Sampled trajectories reduced to numbers and bits, and summed up in small tables.

Shapes: K tasks, N trajectories, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, T steps,
n states.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from swerve.evidence import estimators
from swerve.problem.record import ProblemRecord

METHODS = ("smc", "importance", "plain")
TEMPERED = "tempered"  # what the method is called where a beta is reached by those between
RESAMPLED = ("smc", TEMPERED)  # methods whose trajectories are those of pi_0, in islands
REWEIGHED = ("importance", "plain")  # methods that share trajectories
SMC_SOLVERS = ("grid", "soft-value", "distilled")  # whose policies have a soft value
ADAPTING_SOLVERS = ("grid", "soft-value")  # that can go on with more known constraints
NUM_ISLANDS = 20  # parts of the trajectories of a task that have nothing to do with one another
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
      log_correction: [K, N] what resampling adds to the log-weight, nats; 0 without.
      ancestor: [K, N] which of the N trajectories at the start each comes from.
      violations: [K, N, B] packed bits, set where trajectory n enters hypothesis h.
      kept: [K, M, T+1, n] a few whole trajectories, drawn by weight, for pictures.
      soft_value: [K] log Z_0 by the solver's own soft value at the beta that they were drawn for,
        nats; NaN where it has none.
    """

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    log_correction: np.ndarray
    ancestor: np.ndarray
    violations: np.ndarray
    kept: np.ndarray
    soft_value: np.ndarray


class Summary(NamedTuple):
    """Estimates for each task, the part of evidence that inference reads.

    Attributes:
      avoid_probability: [K, H] Z_c / Z_0.
      avoid_variance: [K, H] its sampling variance.
      log_ratio: [K, H] its log, nats, which exact answers know where the ratio is no number.
      log_ratio_error: [K, H] its standard error, nats, where it was worked out with the constraint
        in force (see `resolving`) or is exact; infinite where that did not settle it; NaN where it
        was not tried.
      log_partition: [K] log Z_0, nats.
      kl: [K] KL(pi || pi_0) by the estimated log Z_0, nats; for "smc" and "tempered"
        KL(pi_0 || pi). pi_0 is that of the problem's beta, but for "plain" that of the beta drawn
        for, which it takes pi for.
      effective_sample_size: [K] of the weights in full, and for "plain" of its own where that is
        less; first those of trajectories that come from the same one at the start are added.
      distinct_share: [K] share of the trajectories at the start that any comes from.
      island_log_partition: [K, I] log Z_0 by each island alone, nats.
      avoid_without_island: [K, I, H] Z_c / Z_0 by all islands but one, float32.
      soft_value: [K] log Z_0 by the solver's own soft value, nats; NaN where it has none, or only
        that of another beta.
      end: [K, n] the middle of the box of states where the trajectories kept end.
      end_reach: [K, n] half the sides of that box.
      shortest: [K] duration of the shortest trajectory [s].
      fastest: [K, n] the fastest change of each state [a second] in the trajectories kept.
    """

    avoid_probability: np.ndarray
    avoid_variance: np.ndarray
    log_ratio: np.ndarray
    log_ratio_error: np.ndarray
    log_partition: np.ndarray
    kl: np.ndarray
    effective_sample_size: np.ndarray
    distinct_share: np.ndarray
    island_log_partition: np.ndarray
    avoid_without_island: np.ndarray
    soft_value: np.ndarray
    end: np.ndarray
    end_reach: np.ndarray
    shortest: np.ndarray
    fastest: np.ndarray


def summarise(
    problem: ProblemRecord, samples: Samples, method: str, sampling_beta: float | None = None
) -> Summary:
    """Estimate what inference needs from sampled trajectories of K tasks.

    Args:
      problem: whose pi_0 is asked for.
      samples: the trajectories.
      method: by which they are weighed.
      sampling_beta: the beta that they were drawn for; that of the problem if None.
    """
    rows = []
    sampling_beta = problem.beta if sampling_beta is None else sampling_beta
    drawn_by = log_weights(problem, samples)
    used_by = weights_used(problem, samples, method, sampling_beta)
    for k, log_weight in enumerate(drawn_by + samples.log_correction):
        used = used_by[k]
        log_partition = estimators.log_partition(log_weight)
        kept, ancestor = samples.kept[k], samples.ancestor[k]
        speed = np.abs(problem.space.difference(kept[:, :-1], kept[:, 1:])) / problem.dt
        of_islands = _of_islands(used, samples.violations[k], problem)
        estimate = estimators.avoid_probability(
            used, samples.violations[k], len(problem.hypotheses)
        )
        if len(np.unique(ancestor)) < len(ancestor):  # they depend on one another
            estimate = estimate._replace(avoid_variance=of_islands.variance())
        if method in RESAMPLED:
            kl = float(estimators.normalise(log_weight) @ _finite(drawn_by[k])) - log_partition
        else:
            assumed = _finite(used) if method == "plain" else 0.0
            kl = _kl_divergence(log_weight - assumed)
        rows.append(
            (
                *estimate,
                _log(estimate.avoid_probability),
                np.full(len(problem.hypotheses), np.nan),
                log_partition,
                kl,
                min(estimators.effective_sample_size(x, ancestor) for x in (log_weight, used)),
                len(np.unique(ancestor)) / len(ancestor),
                [_log_mean(log_weight[island]) for island in islands(len(log_weight))],
                of_islands.avoid_without().astype(np.float32),
                samples.soft_value[k] if sampling_beta == problem.beta else np.nan,
                *_end_box(problem, kept[:, -1]),
                samples.length[k][np.isfinite(log_weight)].min() * problem.dt,
                speed.max(axis=(0, 1)),
            )
        )
    return Summary(*(np.array(column) for column in zip(*rows, strict=True)))


def islands(num_trajectories: int) -> list[np.ndarray]:
    """Return the numbers of the trajectories of each island; a lone one is its own."""
    num_islands = min(NUM_ISLANDS, num_trajectories)
    return np.array_split(np.arange(num_trajectories), num_islands)


def _of_islands(
    log_weight: np.ndarray, violations: np.ndarray, problem: ProblemRecord
) -> estimators.Parts:
    """Return what each island of a task weighs, and what of that enters each hypothesis."""
    sizes = [len(part) for part in islands(len(log_weight))]
    group = np.repeat(np.arange(len(sizes)), sizes)
    return estimators.parts(log_weight, violations, len(problem.hypotheses), group)


def _log_mean(log_weight: np.ndarray) -> float:
    """Return the log of the mean of weights, -inf where all are 0."""
    return float(np.logaddexp.reduce(log_weight)) - float(np.log(len(log_weight)))


def _kl_divergence(log_weight: np.ndarray) -> float:
    """Return KL(pi || pi_0) by the log Z_0 that the same weights [N] estimate, nats."""
    return estimators.kl_divergence(log_weight, estimators.log_partition(log_weight))


def _finite(values: np.ndarray) -> np.ndarray:
    """Return values with 0 for those of no weight."""
    return np.where(np.isfinite(values), values, 0.0)


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


def weights_used(
    problem: ProblemRecord, samples: Samples, method: str, sampling_beta: float
) -> np.ndarray:
    """Return the log-weights [K, N] that a method uses, nats.

    Those in full, but for "plain": it takes the policy for pi_0 at the beta that the trajectories
    were drawn for, which leaves (beta - sampling_beta) R (the paper, Theorem 2).
    """
    if method != "plain":
        return log_weights(problem, samples) + samples.log_correction
    allowed = np.isfinite(samples.total_reward)
    shift = (problem.beta - sampling_beta) * np.where(allowed, samples.total_reward, 0.0)
    return np.where(allowed, shift, -np.inf)
