"""The rank of the true hypothesis against the number of demonstrations (the paper, figures 2, 3).

    rank = 1 + |{h: S_h > S_truth}| + |{h: S_h = S_truth, h not the truth}| / 2,

where S_h adds up what the demonstrations of a random subset say, and is -inf where one of them
enters h. The paper takes an average of the same in place of the sum, which ranks alike.

Shapes: D demonstrations, H hypotheses, L sizes of subsets, R subsets of a size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.inference.ranking import Inference

NUM_TRIALS = 200  # subsets of a size, as in the paper
NUM_BOOTSTRAPS = 100  # sets of demonstrations drawn anew, with repetition
Z = 1.96  # standard errors to either side, 95 %
NOISE = 5  # trajectories: where fewer enter, chance decides whether there are any


class Judged(NamedTuple):
    """What each demonstration says of each hypothesis.

    Attributes:
      score: [D, H] larger for hypotheses that it speaks for.
      entered: [D, H] whether it rules the hypothesis out.
    """

    score: np.ndarray
    entered: np.ndarray


class Curve(NamedTuple):
    """The rank of the truth against the number of demonstrations.

    Attributes:
      sizes: [L] numbers of demonstrations.
      rank: [L] average over subsets.
      error: [L] standard error of that, by bootstrap over the demonstrations; too large where
        subsets hold more than a third of these, which resamples hold but in part.
      first: [L] share of the subsets in which the truth comes first, alone.
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
    """Return the violation probability below which it counts as 0."""
    return NOISE / num_trajectories


def judged(result: Inference, noise: float) -> Judged:
    """Return what each demonstration of an inference adds to its score.

    Args:
      result: by likelihood or by the paper's average.
      noise: violation probabilities below count as 0.
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
    said: Judged, truth: int, size: int, num_trials: int, generator: np.random.Generator
) -> np.ndarray:
    """Return the rank of the truth [R] by random subsets of the demonstrations, ties half.

    Args:
      said: by each demonstration.
      truth: index of the true hypothesis.
      size: demonstrations of a subset, at most D.
      num_trials: R.
      generator: of the subsets.
    """
    num = len(said.score)
    subsets = generator.permuted(np.tile(np.arange(num), (num_trials, 1)), axis=1)[:, :size]
    counts = np.zeros((num_trials, num))
    np.put_along_axis(counts, subsets, 1.0, axis=1)
    total = np.where(counts @ said.entered > 0.0, -np.inf, (counts @ said.score).round(9))
    true = total[:, truth, None]
    return 0.5 + (total > true).sum(axis=1) + 0.5 * (total == true).sum(axis=1)


def curve(
    said: Judged, truth: int, sizes: list[int], *, num_trials: int = NUM_TRIALS, seed: int = 0
) -> Curve:
    """Return the average rank of the truth against the number of demonstrations.

    Args:
      said: by each demonstration.
      truth: index of the true hypothesis.
      sizes: [L] numbers of demonstrations, each at most D.
      num_trials: R, subsets of each size.
      seed: of subsets and bootstrap.

    Returns:
      The curve; a truth that is ruled out ranks behind all that is left.
    """
    generator, num = np.random.default_rng(seed), len(said.score)
    found = [ranks(said, truth, size, num_trials, generator) for size in sizes]
    again = np.empty((NUM_BOOTSTRAPS, len(sizes)))
    for row in again:
        drawn = generator.integers(num, size=num)
        others = Judged(said.score[drawn], said.entered[drawn])
        row[:] = [ranks(others, truth, size, num_trials, generator).mean() for size in sizes]
    rank = np.array([one.mean() for one in found])
    first = np.array([(one == 1.0).mean() for one in found])
    return Curve(sizes, rank, again.std(axis=0, ddof=1), first)
