"""The rank of the true hypothesis against the number of demonstrations (the paper, figures 2, 3).

    rank = 1 + |{h: S_h > S_truth}| + |{h: S_h = S_truth, h not the truth}| / 2,

where S_h is the sum of the scores of h over the demonstrations of a random subset, and -inf where
one of them enters h. The paper takes the average in place of the sum, which gives the same ranks.

Shapes: D demonstrations, H hypotheses, L sizes of subsets, R subsets of a size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.answer import Inference

NUM_TRIALS = 200  # subsets of each size, as in the paper
NUM_BOOTSTRAPS = 100  # bootstrap samples of the demonstrations, with repetition
Z = 1.96  # standard errors to either side, for a 95 % interval
NOISE = 5  # trajectories: where fewer are expected to enter, chance decides whether any does


class Judged(NamedTuple):
    """Scores of each hypothesis by each demonstration.

    Attributes:
      score: [D, H] scores; a larger one supports the hypothesis more.
      entered: [D, H] whether the demonstration rules the hypothesis out.
    """

    score: np.ndarray
    entered: np.ndarray


class Curve(NamedTuple):
    """The rank of the truth against the number of demonstrations.

    Attributes:
      sizes: [L] numbers of demonstrations.
      rank: [L] average rank over subsets.
      error: [L] standard error of the average, by bootstrap over the demonstrations; too large
        where a subset holds more than a third of the demonstrations, since a bootstrap sample
        holds only a part of them.
      first: [L] share of the subsets in which the truth alone comes first.
    """

    sizes: list[int]
    rank: np.ndarray
    error: np.ndarray
    first: np.ndarray

    @property
    def interval(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends [L] of the 95 % interval of the average rank."""
        return np.maximum(self.rank - Z * self.error, 1.0), self.rank + Z * self.error


def noise_of(num_trajectories: int) -> float:
    """Return the violation probability below which probabilities count as 0."""
    return NOISE / num_trajectories


def judged(result: Inference, noise: float) -> Judged:
    """Return the scores that each demonstration of an inference adds.

    Args:
      result: inference by likelihood or by the paper's average.
      noise: violation probability below which probabilities count as 0.
    """
    evidence, task_of = result.evidence, result.task_of
    violation = evidence.violation_probability[task_of]
    impossible = evidence.is_exact & np.isneginf(evidence.log_ratio[task_of])
    if result.score_name == "average":
        score = violation
    else:
        score = -np.where(impossible, 0.0, evidence.log_ratio[task_of])
    return Judged(np.where(violation < noise, 0.0, score), result.entered | impossible)


def ranks(
    scores: Judged, truth: int, size: int, num_trials: int, generator: np.random.Generator
) -> np.ndarray:
    """Return the rank of the truth [R] by random subsets of the demonstrations, ties half.

    Args:
      scores: scores by each demonstration.
      truth: index of the true hypothesis.
      size: number of demonstrations of a subset, at most D.
      num_trials: R, the number of subsets.
      generator: random generator of the subsets.
    """
    num = len(scores.score)
    subsets = generator.permuted(np.tile(np.arange(num), (num_trials, 1)), axis=1)[:, :size]
    counts = np.zeros((num_trials, num))
    np.put_along_axis(counts, subsets, 1.0, axis=1)
    total = np.where(counts @ scores.entered > 0.0, -np.inf, (counts @ scores.score).round(9))
    true = total[:, truth, None]
    return 0.5 + (total > true).sum(axis=1) + 0.5 * (total == true).sum(axis=1)


def curve(
    scores: Judged, truth: int, sizes: list[int], *, num_trials: int = NUM_TRIALS, seed: int = 0
) -> Curve:
    """Return the average rank of the truth against the number of demonstrations.

    Args:
      scores: scores by each demonstration.
      truth: index of the true hypothesis.
      sizes: [L] numbers of demonstrations, each at most D.
      num_trials: R, the number of subsets of each size.
      seed: seed of subsets and bootstrap.

    Returns:
      The curve; a truth that is ruled out ranks behind all hypotheses that are not.
    """
    generator, num = np.random.default_rng(seed), len(scores.score)
    found = [ranks(scores, truth, size, num_trials, generator) for size in sizes]
    again = np.empty((NUM_BOOTSTRAPS, len(sizes)))
    for row in again:
        chosen = generator.integers(num, size=num)
        others = Judged(scores.score[chosen], scores.entered[chosen])
        row[:] = [ranks(others, truth, size, num_trials, generator).mean() for size in sizes]
    rank = np.array([one.mean() for one in found])
    first = np.array([(one == 1.0).mean() for one in found])
    return Curve(sizes, rank, again.std(axis=0, ddof=1), first)
