"""Sampled trajectories reduced to numbers and bits, and summed up in small tables.

Shapes: K tasks, N trajectories, H hypotheses, B = ceil(H / 8) bytes, M kept trajectories, T steps,
n states.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from swerve import estimators
from swerve.problem import ProblemRecord
from swerve.space import Task

METHODS = ("importance", "plain")


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
    """

    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray
    violations: np.ndarray
    kept: np.ndarray


class Summary(NamedTuple):
    """Estimates for each task, the part of evidence that inference reads.

    Attributes:
      avoid_probability: [K, H] Z_c / Z_0.
      avoid_variance: [K, H] its sampling variance.
      log_partition: [K] log Z_0, nats.
      kl: [K] KL(pi || pi_0) by the estimated log Z_0, nats.
      effective_sample_size: [K] of the importance weights, whatever the method.
      farthest_end: [K] how far from its goal, in units of the states' extent, a nominal trajectory
        ends at most, of those kept; inf where goals are no states.
      shortest: [K] duration of the shortest trajectory [s].
      fastest: [K, n] the fastest change of each state [a second] in the trajectories kept.
    """

    avoid_probability: np.ndarray
    avoid_variance: np.ndarray
    log_partition: np.ndarray
    kl: np.ndarray
    effective_sample_size: np.ndarray
    farthest_end: np.ndarray
    shortest: np.ndarray
    fastest: np.ndarray


def summarise(problem: ProblemRecord, tasks: Task, samples: Samples, method: str) -> Summary:
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
                log_partition,
                estimators.kl_divergence(log_weight, log_partition),
                estimators.effective_sample_size(log_weight),
                _farthest_end(problem, kept, tasks.goal[k]),
                samples.length[k][np.isfinite(log_weight)].min() * problem.dt,
                speed.max(axis=(0, 1)),
            )
        )
    return Summary(*(np.array(column) for column in zip(*rows, strict=True)))


def _farthest_end(problem: ProblemRecord, kept: np.ndarray, goal: np.ndarray) -> float:
    """Return how far trajectories [M, T+1, n] end from a goal at most, of the states' extent."""
    if problem.goal_names != problem.space.names:
        return np.inf
    return float(problem.space.relative_distance(kept[:, -1], goal).max())


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
