"""Compute the posterior probabilities of no constraint and of each hypothesis.

    P(c | demonstrations) ~ prior(c) L(c),    L(none) = 1,

with likelihood ratios L against no constraint. Before any demonstration P(none) is 1/2, unless a
prior is given. If "none" had the same prior as each hypothesis, "none" could never win, since each
hypothesis that is not ruled out has L(c) >= 1.

Shapes: H hypotheses; probabilities [..., H + 1] begin with P(no constraint).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swerve.base.arguments import number_or_nan
from swerve.evidence.estimators import joint_error
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.same import same_as
from swerve.inference import likelihood
from swerve.inference.scores import Scores

NONE = 0.5  # P(no constraint) unless a prior is given
ROUNDING = 1e-6  # probability by which the sum of a prior may differ from 1

Prior = float | Sequence[float] | np.ndarray | None


class Posterior(NamedTuple):
    """The probability of each answer, with standard errors from sampling.

    Attributes:
      none: probability of no constraint.
      none_error: standard error of `none`.
      hypotheses: [H] probability of each hypothesis.
      error: [H] standard errors of `hypotheses`.
    """

    none: float
    none_error: float
    hypotheses: np.ndarray
    error: np.ndarray


class CredibleSet(NamedTuple):
    """The fewest answers whose probabilities sum to at least a given probability.

    Attributes:
      has_none: whether "no constraint" is one of the answers.
      hypotheses: indices of the hypotheses among the answers, most probable first.
      probability: sum of the probabilities of the answers.
    """

    has_none: bool
    hypotheses: np.ndarray
    probability: float


def checked_prior(prior: Prior, num_hypotheses: int) -> np.ndarray:
    """Return the checked prior [H + 1], with P(no constraint) first.

    Args:
      prior: [H + 1] probabilities, P(no constraint) first; or P(no constraint) alone, and the
        hypotheses share the rest equally; P(no constraint) = 1/2 if None.
      num_hypotheses: H.

    Raises:
      ValueError: if a probability is negative or not finite, the probabilities do not sum to 1,
        there are not H + 1 probabilities, or a single P(no constraint) is not between 0 and 1.
    """
    if prior is None:
        prior = NONE
    given = np.asarray(prior)
    if given.dtype.kind not in "iuf":
        raise ValueError(
            f"prior: expected P(no constraint), or {num_hypotheses + 1} probabilities, that of no "
            f"constraint first, got {prior!r}"
        )
    given = given.astype(float)
    if given.ndim == 0:
        if not 0.0 <= given <= 1.0:
            raise ValueError(f"prior: expected P(no constraint) from 0 to 1, got {prior}")
        share = (1.0 - given) / num_hypotheses
        return np.concatenate([[given], np.full(num_hypotheses, share)])
    if given.shape != (num_hypotheses + 1,):
        raise ValueError(
            f"prior: expected {num_hypotheses + 1} probabilities, that of no constraint first and "
            f"then one for each hypothesis, got shape {given.shape}"
        )
    if not (np.isfinite(given).all() and (given >= 0.0).all()):
        worst = int(np.flatnonzero(~(np.isfinite(given) & (given >= 0.0)))[0])
        raise ValueError(f"prior: expected probabilities >= 0, got {given[worst]} at {worst}")
    if abs(given.sum() - 1.0) > ROUNDING:
        raise ValueError(
            f"prior: expected probabilities that sum to 1, got a sum of {given.sum():.6g}: divide "
            "each by the sum"
        )
    return given / given.sum()


def posterior(log_likelihood: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the probabilities [..., H + 1] of no constraint and of each hypothesis.

    Args:
      log_likelihood: [..., H] log-likelihood ratios against no constraint, nats; -inf where a
        hypothesis is ruled out.
      prior: [H + 1] as `checked_prior` returns it.

    Raises:
      ValueError: if every answer that the prior allows is ruled out.
    """
    with np.errstate(divide="ignore"):
        log_prior = np.log(prior)
    none = np.zeros((*log_likelihood.shape[:-1], 1))
    log_joint = np.concatenate([none, log_likelihood], axis=-1) + log_prior
    largest = log_joint.max(axis=-1, keepdims=True)
    if np.isneginf(largest).any():
        raise ValueError(
            "prior: the demonstrations rule out every hypothesis, and P(no constraint) is 0: give "
            "it some probability, or the demonstrations a tolerance"
        )
    joint = np.exp(log_joint - largest)
    return joint / joint.sum(axis=-1, keepdims=True)


def log_bayes_factor(log_likelihood: np.ndarray, prior: np.ndarray) -> float:
    """Return log P(demonstrations | some constraint) / P(demonstrations | none), nats.

    The value is -inf if every hypothesis is ruled out, or the prior allows no hypothesis.

    Args:
      log_likelihood: [H] log-likelihood ratios, nats.
      prior: [H + 1]; its last H numbers weigh the hypotheses.
    """
    if not prior[1:].any():
        return -np.inf
    with np.errstate(divide="ignore"):
        log_share = np.log(prior[1:]) - np.log(prior[1:].sum())
    log_joint = np.where(prior[1:] > 0.0, log_likelihood + log_share, -np.inf)
    return float(np.logaddexp.reduce(log_joint))


def jackknife_error(replicates: np.ndarray) -> np.ndarray:
    """Return the standard error [...] of an estimate from its values [I, ...], each without a part.

    se^2 = (I - 1) / I sum_i (p_i - mean p)^2
    """
    num = len(replicates)
    return np.sqrt((num - 1) * replicates.var(axis=0))


def credible_set(found: Posterior, least: float) -> CredibleSet:
    """Return the fewest answers whose probabilities sum to at least `least`.

    Args:
      found: probabilities of the answers.
      least: more than 0 and less than 1.

    Raises:
      ValueError: if `least` is not between 0 and 1.
    """
    if not 0.0 < number_or_nan(least) < 1.0:
        raise ValueError(f"credible_set: expected a probability between 0 and 1, got {least!r}")
    probabilities = np.concatenate([[found.none], found.hypotheses])
    order = np.argsort(-probabilities, kind="stable")
    together = np.cumsum(probabilities[order])
    num = min(int(np.searchsorted(together, least - ROUNDING)), len(order) - 1) + 1
    chosen = order[:num]
    has_none = bool((chosen == 0).any())
    return CredibleSet(has_none, chosen[chosen > 0] - 1, min(float(together[num - 1]), 1.0))


def of_scores(scores: Scores) -> Posterior:
    """Return the posterior that follows from scores.

    Without demonstrations the posterior is the prior. Standard errors come from leaving out one
    island of the samples after another, for all tasks at once. Ratios that were sampled with the
    constraint in force contribute the error of Z_c of their own, and share the error of Z_0, which
    the islands tell. Bounds contribute their own errors. Hypotheses that are the same set share one
    error.
    """
    evidence = scores.evidence
    if not scores.demonstrations:
        prior = scores.prior
        return Posterior(float(prior[0]), 0.0, prior[1:].copy(), np.zeros(len(prior) - 1))
    tasks = np.flatnonzero(scores.task_counts)
    value = posterior(scores.log_likelihood, scores.prior)
    if evidence.is_exact:
        return Posterior(float(value[0]), 0.0, value[1:], np.zeros(len(value) - 1))
    used = scores.is_used[tasks]
    is_resolved = evidence.is_resolved[tasks] & used
    has_own_error = is_resolved | evidence.is_floored[tasks] & used
    without = _without_islands(scores, tasks, is_resolved, has_own_error)
    island_error = jackknife_error(posterior(without, scores.prior))
    of_partition = np.where(is_resolved, evidence.log_partition_error[tasks][:, None], 0.0)
    variance = np.maximum(evidence.standard_error[tasks] ** 2 - of_partition**2, 0.0)
    own = scores.sensitivity[tasks] * np.sqrt(np.where(has_own_error, variance, 0.0))
    own = joint_error(own, evidence.sample_of[tasks])
    error = np.hypot(island_error, _propagated_error(value, own, _sharing(evidence)))
    return Posterior(float(value[0]), float(error[0]), value[1:], error[1:])


def _without_islands(
    scores: Scores, tasks: np.ndarray, is_resolved: np.ndarray, has_own_error: np.ndarray
) -> np.ndarray:
    """Return the log-likelihood ratios [I, H] without one island each; -inf if struck out.

    Args:
      scores: scores by sampled evidence.
      tasks: [M] numbers of the tasks with demonstrations.
      is_resolved: [M, H] True where a ratio in use was sampled with the constraint in force.
      has_own_error: [M, H] True where a ratio in use is resolved, or a bound.
    """
    evidence = scores.evidence
    least = evidence.resolution[tasks][:, None]
    is_of_islands = scores.is_used[tasks] & ~has_own_error
    counts = likelihood.Counts(*(part[tasks] for part in scores.counts))
    own_ratio = np.where(has_own_error, scores.finite_log_ratio[tasks], 0.0)
    gained = _gained_without_islands(evidence)[:, tasks, None]
    found = np.empty((len(gained), own_ratio.shape[1]))
    for island, gain in enumerate(gained):  # all at once would take 20 times the memory
        # one island may hold all trajectories that avoid c: without this island the probability is
        # at least one trajectory's share
        without = evidence.summary.avoid_without_island[tasks, island]
        log_ratio = np.log(np.where(is_of_islands, np.maximum(without, least), 1.0))
        log_ratio += own_ratio + np.where(is_resolved, gain, 0.0)
        found[island] = likelihood.log_likelihood(log_ratio, counts, scores.tolerance)
    return np.where(scores.struck_out, -np.inf, found)


def _gained_without_islands(evidence: Evidence) -> np.ndarray:
    """Return log Z_0 minus log Z_0 without one island each [I, K], nats.

    Without one island Z_0 is at least one trajectory's share of Z_0.
    """
    log_partition = evidence.island_log_partition.T
    largest = np.maximum(log_partition.max(axis=0), np.finfo(float).min)
    weight = np.exp(log_partition - largest)
    mean, num = weight.mean(axis=0), len(weight)
    others = (weight.sum(axis=0) - weight) / (num - 1)
    return np.log(mean) - np.log(np.maximum(others, evidence.resolution * mean))


def _sharing(evidence: Evidence) -> np.ndarray:
    """Return for each hypothesis the first one [H] that has the same error of its own.

    Hypotheses that are the same set have the same ratio, and so the same error. Earlier versions
    resolved each by random numbers of its own: then the ratios differ.
    """
    first = same_as(evidence.problem.hypotheses, evidence.problem.space)
    differs = (evidence.log_ratio != evidence.log_ratio[:, first]).any(axis=0)
    return np.where(differs, np.arange(len(first)), first)


def _propagated_error(value: np.ndarray, error: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Return the standard errors [H + 1] of a posterior from log-likelihoods (delta method).

        d p_j / d log L_h = p_j (1[j = h] - p_h)

    Args:
      value: [H + 1] the posterior.
      error: [H] standard errors of the log-likelihoods.
      shared: [H] the first hypothesis whose error is the same; other errors are independent.
    """
    own, group = np.concatenate([[0.0], error]), np.concatenate([[0], shared + 1])
    together = np.bincount(group, value * own, minlength=len(value))  # sum_h p_h e_h of a group
    others = np.maximum(np.sum(together**2) - together[group] ** 2, 0.0)
    return value * np.sqrt(others + (own - together[group]) ** 2)


def least_tolerance(scores: Scores) -> float | None:
    """Return the least tolerance for which a hypothesis is more probable than no constraint.

    Return None if a hypothesis is more probable already, or if none would be up to the largest
    tolerance.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        log_odds = np.log(scores.prior[1:]) - np.log(scores.prior[0])
    log_odds = np.where(scores.impossible | (scores.prior[1:] == 0.0), -np.inf, log_odds)
    left = ~scores.struck_out
    if (scores.log_likelihood[left] + log_odds[left] > 0.0).any():
        return None
    return likelihood.least_tolerance(scores.finite_log_ratio, scores.counts, log_odds)
