"""Several constraints, one after another: greedy selection (Scobee & Sastry, 2019, Algorithm 2).

With C the constraints picked so far, the next one is the hypothesis c that no demonstration enters
and that raises the likelihood of the demonstrations most: the one with the largest gain

    - mean_i log P(avoid c | avoid C),    in nats a demonstration,

which is what it takes off KL(demonstrations || pi_C), see `divergence`. It ends where the gain
falls below a threshold; the pick that gained less is left out.

Shapes: K tasks, H hypotheses, D demonstrations.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from swerve import estimators
from swerve.arguments import whole_number
from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence
from swerve.hypotheses import enters_set, pack_sets
from swerve.inference import Inference, infer
from swerve.nominal import ExactNominal
from swerve.problem import Problem
from swerve.rewards import taken_actions, total_reward
from swerve.sampling import sample
from swerve.space import Task

DIGITS = 9  # by which demonstrations are told apart
TIED = 1e-9  # relative: gains closer than this are one, and the lowest index is taken

Conditional = Callable[[list[int]], estimators.LogRatio]
"""Maps hypotheses picked, C, to log P(avoid c | avoid C) [K, H] and its standard error, nats."""


class Pick(NamedTuple):
    """One constraint that was picked.

    Attributes:
      hypothesis: its index.
      gain: nats a demonstration that it takes off the KL divergence; where next to no sample is
        left that avoids it, no more than the samples can tell.
      standard_error: of the gain, nats; 0 where answers are exact, infinite where no sample of a
        task is left that could tell.
      log_partition: [K] log Z_C with this one and all before it in force, nats.
    """

    hypothesis: int
    gain: float
    standard_error: float
    log_partition: np.ndarray


def greedy(
    source: Evidence | ExactNominal,
    demonstrations: Sequence[Demonstration],
    *,
    threshold: float = 0.1,
    most: int | None = None,
) -> list[Pick]:
    """Pick constraints one after another, as long as each explains enough.

    Args:
      source: sampled evidence, whose trajectories are reweighed for what is picked; or the nominal
        distribution of an exact solver, which is worked out anew with it in force. What `resolve`
        worked out counts for the first pick; those after it are told by trajectories alone.
      demonstrations: at least one.
      threshold: least gain [nats a demonstration].
      most: picks at most; any number if None.

    Returns:
      The picks, in order. What speaks against the samples they rest on is in the `warnings` of
      `infer`.

    Raises:
      ValueError: if there is no demonstration, the threshold is below zero or no number, exact
        evidence is given in place of its nominal, or a demonstration does not fit.
    """
    if not (math.isfinite(threshold) and threshold >= 0.0):
        raise ValueError(
            f"threshold: expected a number >= 0 (nats a demonstration), got {threshold}"
        )
    most = None if most is None else whole_number(most, "most", 1)
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    if isinstance(source, Evidence):
        start, conditional = infer(source, demonstrations), _of_samples(source)
    else:
        start, conditional = _exact(source, demonstrations)
    left = np.asarray(~start.entered.any(axis=0))
    share = start.task_counts / len(demonstrations)
    given = estimators.LogRatio(start.evidence.log_ratio, start.evidence.standard_error)
    log_partition = start.evidence.log_partition
    picks: list[Pick] = []
    while left.any() and (most is None or len(picks) < most):
        if picks:
            given = conditional([pick.hypothesis for pick in picks])
        index, gain = _best(share, given.value, left)
        if gain < max(threshold, TIED):
            break
        error = float(np.linalg.norm((share * given.standard_error[:, index])[share > 0]))
        log_partition = log_partition + given.value[:, index]
        picks.append(Pick(index, gain, error, log_partition))
        left[index] = False
    return picks


def _best(share: np.ndarray, log_ratio: np.ndarray, left: np.ndarray) -> tuple[int, float]:
    """Return the hypothesis of the largest gain among those left, and its gain."""
    gain = -share[share > 0] @ log_ratio[share > 0]
    gain = np.where(left & np.isfinite(gain), gain, -np.inf)  # one that nobody can avoid is none
    best = gain.max()
    index = int(np.flatnonzero(gain >= best - TIED * max(1.0, abs(best)))[0])
    return index, float(gain[index])


def _of_samples(evidence: Evidence) -> Conditional:
    """Return conditionals by leaving out the trajectories that enter what is picked."""
    if evidence.is_exact:
        raise ValueError(
            "source: this evidence is exact and holds no samples to reweigh: give the nominal "
            "distribution that it came from"
        )
    num_hypotheses = len(evidence.problem.hypotheses)
    bits = evidence.samples.violations

    def conditional(picked: list[int]) -> estimators.LogRatio:
        [members] = pack_sets([picked], num_hypotheses)
        rows = []
        for k, log_weight in enumerate(evidence.log_weight):
            clean = np.where(enters_set(bits[k], members), -np.inf, log_weight)
            rows.append(_log_ratio(clean, bits[k], num_hypotheses))
        return estimators.LogRatio(*map(np.array, zip(*rows, strict=True)))

    return conditional


def _log_ratio(
    log_weight: np.ndarray, bits: np.ndarray, num_hypotheses: int
) -> estimators.LogRatio:
    """Estimate log Z_c / Z_C [H] from trajectories whose weights are 0 where they enter C."""
    if np.isneginf(log_weight).all():  # nothing is left that could tell
        return estimators.LogRatio(np.zeros(num_hypotheses), np.full(num_hypotheses, np.inf))
    estimate = estimators.avoid_probability(log_weight, bits, num_hypotheses)
    return estimators.log_ratio(estimate, 1.0 / estimators.effective_sample_size(log_weight))


def _exact(
    nominal: ExactNominal, demonstrations: Sequence[Demonstration]
) -> tuple[Inference, Conditional]:
    """Return the inference to start from, and conditionals by solving anew."""
    tasks = Task.stack([demonstration.task for demonstration in demonstrations])
    rows = np.unique(np.hstack(tasks), axis=0)
    distinct = Task(*np.split(rows, [tasks.start.shape[1]], axis=1))

    def conditional(picked: list[int]) -> estimators.LogRatio:
        answers = [
            nominal.answer(Task(*task), np.random.default_rng(0), avoiding=picked)
            for task in zip(*distinct, strict=True)
        ]
        log_ratio = np.array([answer.log_ratio for answer in answers])
        return estimators.LogRatio(log_ratio, np.zeros_like(log_ratio))

    return infer(sample(nominal, distinct), demonstrations), conditional


def divergence(
    problem: Problem, demonstrations: Sequence[Demonstration], log_partition: np.ndarray
) -> float:
    """Return KL(demonstrations || pi_C) in nats a demonstration.

    It is sum p log p - mean [beta R + log m] + mean log Z_C, where p are the frequencies of the
    distinct demonstrations among those of their task.

    Args:
      problem: dynamics and reward.
      demonstrations: with actions; of a tabular MDP, states alone may do.
      log_partition: [D] log Z_C of the task of each demonstration, nats.

    Raises:
      ValueError: if there is not one log Z_C for each demonstration, or a demonstration lacks
        actions, or has a step that the MDP does not allow.
    """
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    log_partition = np.asarray(log_partition, float)
    if log_partition.shape != (len(demonstrations),):
        raise ValueError(
            f"log_partition: expected one number for each of {len(demonstrations)} demonstrations, "
            f"that of its task, got shape {log_partition.shape}"
        )
    log_measure = -math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
    tasks, paths, terms = [], [], []
    for demonstration, value in zip(demonstrations, log_partition, strict=True):
        actions = taken_actions(problem.mdp, demonstration)
        reward = total_reward(problem.mdp, demonstration, actions)
        terms.append(value - problem.beta * reward - log_measure * len(actions))
        tasks.append(_key(*demonstration.task))
        paths.append((tasks[-1], _key(demonstration.states, actions)))
    of_task, of_path = Counter(tasks), Counter(paths)
    log_share = [math.log(of_path[path] / of_task[path[0]]) for path in paths]
    return float(np.mean(log_share) + np.mean(terms))


def _key(*arrays: np.ndarray) -> bytes:
    """Return what is the same for arrays of the same shapes that are the same but for rounding."""
    return np.concatenate([np.round(a, DIGITS).ravel() + 0.0 for a in arrays]).tobytes()
