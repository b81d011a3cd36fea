"""Reduce sampled trajectories to numbers and bits, and sum these up in small tables.

Shapes: K tasks, N trajectories, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, L states
of the longest kept trajectory, n state dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from swerve.evidence import estimators
from swerve.problem.record import ProblemRecord

METHODS = ("smc", "importance", "plain")
TEMPERED = "tempered"  # method of evidence whose beta was reached in steps from another beta
RESAMPLED = ("smc", TEMPERED)  # methods whose trajectories follow pi_0, sampled in islands
REWEIGHED = ("importance", "plain")  # methods that weigh the same trajectories differently
NUM_ISLANDS = 20  # islands, the independent parts of the trajectories of a task
RESOLVED = ("avoid_probability", "avoid_variance", "log_ratio", "log_ratio_error")  # by `resolve`
EXACT = "exact"  # method of evidence that a solver computed without sampling
NUM_KEPT = 100  # whole trajectories of a task that are kept for pictures


class Sampled(Protocol):
    """Numbers that trajectories are weighed by, each [..., N]."""

    @property
    def total_reward(self) -> Any:
        """R(xi); -inf where a known constraint was entered."""
        ...

    @property
    def log_probability(self) -> Any:
        """Log-probability under the policy that sampled the trajectories, nats."""
        ...

    @property
    def length(self) -> Any:
        """Steps taken."""
        ...


class Samples(NamedTuple):
    """Sampled trajectories reduced to what estimates need.

    Attributes:
      total_reward: [K, N] R(xi); -inf where a known constraint was entered.
      log_probability: [K, N] log pi(xi) under the policy that sampled xi, nats.
      length: [K, N] steps taken.
      log_correction: [K, N] correction of the log-weight for resampling, nats; 0 without
        resampling.
      ancestor: [K, N] index of the trajectory at the start from which each trajectory descends.
      violations: [K, N, B] packed bits, set where trajectory n enters hypothesis h.
      kept: [K, M, L, n] a few whole trajectories, chosen by weight, for pictures; float32, and each
        rests in its last state.
      soft_value: [K] log Z_0 by the solver's own soft value at the beta of the sampling, nats; NaN
        where the solver has no soft value, -inf where by the solver known constraints close the
        start in.
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
    """Estimates for each task: the part of evidence that inference reads.

    Attributes:
      avoid_probability: [K, H] Z_c / Z_0.
      avoid_variance: [K, H] sampling variance of `avoid_probability`.
      log_ratio: [K, H] log Z_c / Z_0, nats; finite in exact answers even where the ratio
        underflows.
      log_ratio_error: [K, H] standard error of `log_ratio`, nats, where the ratio was sampled with
        the constraint in force (see `sampling.resolve`); 0 where the ratio is exact; infinite where
        sampling with the constraint in force did not settle the ratio; NaN where such sampling was
        not tried.
      log_partition: [K] log Z_0, nats.
      kl: [K] KL(pi || pi_0) by the estimated log Z_0, nats; for "smc" and "tempered" KL(pi_0 ||
        pi). pi_0 belongs to the problem's beta; for "plain" to the beta of the sampling, since
        equal weights assume pi = pi_0.
      effective_sample_size: [K] effective sample size of the importance weights; for "plain" of the
        plain weights where that is smaller. Weights of trajectories with the same ancestor are
        added first.
      distinct_share: [K] share of the trajectories at the start that have descendants.
      island_log_partition: [K, I] log Z_0 by each island alone, nats.
      avoid_without_island: [K, I, H] Z_c / Z_0 without one island each, float32.
      soft_value: [K] log Z_0 by the solver's own soft value, nats; NaN where the solver has no soft
        value at this beta.
      end: [K, n] the middle of the box around the last states of the kept trajectories.
      end_reach: [K, n] half the lengths of that box's sides.
      shortest: [K] duration of the shortest trajectory [s].
      fastest: [K, n] fastest change of each state in the kept trajectories [the state's unit / s].
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
      problem: pi_0 of this problem is estimated.
      samples: the trajectories.
      method: how to weigh the trajectories.
      sampling_beta: beta for which the trajectories were sampled; the problem's if None.
    """
    rows, num_hypotheses = [], len(problem.hypotheses)
    sampling_beta = problem.beta if sampling_beta is None else sampling_beta
    importance = log_weights(problem, samples)
    weights = weights_used(problem, samples, method, sampling_beta)
    for k, log_weight in enumerate(importance + samples.log_correction):
        used = weights[k]
        log_partition = estimators.log_partition(log_weight)
        kept, ancestor = samples.kept[k].astype(float), samples.ancestor[k]
        speed = np.abs(problem.space.difference(kept[:, :-1], kept[:, 1:])) / problem.dt
        distinct_share = len(np.unique(ancestor)) / len(ancestor)
        judged = used, samples.violations[k], num_hypotheses
        of_islands = _of_islands(*judged)
        estimate = estimated(*judged, distinct_share == 1.0, of_islands)
        if method in RESAMPLED:
            kl = float(estimators.normalise(log_weight) @ _finite(importance[k])) - log_partition
        else:
            assumed = _finite(used) if method == "plain" else 0.0
            kl = _kl_divergence(log_weight - assumed)
        rows.append(
            (
                *estimate,
                _log(estimate.avoid_probability),
                np.full(num_hypotheses, np.nan),
                log_partition,
                kl,
                min(estimators.effective_sample_size(x, ancestor) for x in (log_weight, used)),
                distinct_share,
                [_log_mean(log_weight[island]) for island in islands(len(log_weight))],
                of_islands.avoid_without().astype(np.float32),
                samples.soft_value[k] if sampling_beta == problem.beta else np.nan,
                *_end_box(problem, kept[:, -1]),
                samples.length[k][np.isfinite(log_weight)].min() * problem.dt,
                speed.max(axis=(0, 1)),
            )
        )
    return Summary(*(np.array(column) for column in zip(*rows, strict=True)))


def kept_paths(states: np.ndarray) -> np.ndarray:
    """Return trajectories [M, T+1, n] as float32, cut where all of them rest.

    Two states stay at least: the speed of a trajectory is that between its states.
    """
    moves = (states[:, 1:] != states[:, :-1]).any(axis=(0, 2))
    last = int(np.flatnonzero(moves).max(initial=0))
    return states[:, : last + 2].astype(np.float32)


def joined_samples(parts: Sequence[Samples]) -> Samples:
    """Return the samples of all tasks of several evidences."""
    longest = max(part.kept.shape[2] for part in parts)
    rested = [
        part._replace(
            kept=np.pad(
                part.kept, [(0, 0), (0, 0), (0, longest - part.kept.shape[2]), (0, 0)], "edge"
            )
        )
        for part in parts
    ]
    return Samples(*map(np.concatenate, zip(*rested, strict=True)))


def islands(num_trajectories: int) -> list[np.ndarray]:
    """Return the indices of the trajectories of each island; one trajectory is one island."""
    num_islands = min(NUM_ISLANDS, num_trajectories)
    return np.array_split(np.arange(num_trajectories), num_islands)


def estimated(
    log_weight: np.ndarray,
    violations: np.ndarray,
    num_hypotheses: int,
    are_independent: bool,
    of_islands: estimators.Parts | None = None,
) -> estimators.Estimate:
    """Estimate Z_c / Z_0, with a variance by islands where trajectories depend on one another.

    Args:
      log_weight: [N] nats; -inf for trajectories to be left out.
      violations: [N, ceil(H / 8)] packed bits.
      num_hypotheses: H.
      are_independent: whether no two trajectories descend from the same one at the start; otherwise
        only islands are independent, and their spread is the error.
      of_islands: the islands' parts, where known; computed where needed if None.
    """
    estimate = estimators.avoid_probability(log_weight, violations, num_hypotheses)
    if are_independent:
        return estimate
    if of_islands is None:
        of_islands = _of_islands(log_weight, violations, num_hypotheses)
    return estimate._replace(avoid_variance=of_islands.variance())


def _of_islands(
    log_weight: np.ndarray, violations: np.ndarray, num_hypotheses: int
) -> estimators.Parts:
    """Return the weight of each island of a task, and the part that avoids each hypothesis."""
    sizes = [len(part) for part in islands(len(log_weight))]
    group = np.repeat(np.arange(len(sizes)), sizes)
    return estimators.parts(log_weight, violations, num_hypotheses, group)


def _log_mean(log_weight: np.ndarray) -> float:
    """Return the log of the mean of weights; -inf where all weights are 0."""
    return float(np.logaddexp.reduce(log_weight)) - float(np.log(len(log_weight)))


def _kl_divergence(log_weight: np.ndarray) -> float:
    """Return KL(pi || pi_0), nats, with log Z_0 estimated by the same weights [N]."""
    return estimators.kl_divergence(log_weight, estimators.log_partition(log_weight))


def _finite(values: np.ndarray) -> np.ndarray:
    """Return values with 0 in place of infinite ones."""
    return np.where(np.isfinite(values), values, 0.0)


def _log(values: np.ndarray) -> np.ndarray:
    """Return the logs of values; -inf for 0."""
    with np.errstate(divide="ignore"):
        return np.log(values)


def _end_box(problem: ProblemRecord, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle [n] and half the side lengths [n] of the box around states [M, n]."""
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

    These are the importance weights, except for "plain". Plain weights assume that the policy is
    pi_0 at `sampling_beta`; then only (beta - sampling_beta) R remains (the paper, Theorem 2).
    """
    if method != "plain":
        return log_weights(problem, samples) + samples.log_correction
    allowed = np.isfinite(samples.total_reward)
    shift = (problem.beta - sampling_beta) * np.where(allowed, samples.total_reward, 0.0)
    return np.where(allowed, shift, -np.inf)
