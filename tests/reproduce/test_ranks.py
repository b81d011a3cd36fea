"""Ranks of the truth equal averages over all subsets, and inference on the same subsets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from swerve import Task, infer, learn, sample
from swerve.problem.problem import Problem
from swerve.reproduce.gridworld.measure import sampled
from swerve.reproduce.ranks import Judged, curve, judged, ranks
from swerve.systems.gridworld import Gridworld

MDP = Gridworld(width=4, height=3, num_steps=8)
PROBLEM = Problem(MDP, MDP.hypotheses(), measure="counting", between_states=False)
TASK = Task(np.zeros(2), np.array([3.0, 0.0]))
EVIDENCE = sample(learn(PROBLEM, "tabular"), TASK)
TRUTH = 1  # cell (1, 0), on the shortest way


def rank(score: np.ndarray, truth: int) -> float:
    """Return the rank by sorting: the mean place of all hypotheses that tie with the truth."""
    ordered = -np.sort(-score)
    same = np.isneginf(ordered) if np.isneginf(score[truth]) else np.isclose(ordered, score[truth])
    return 1.0 + float(np.flatnonzero(same).mean())


def all_subsets(said: Judged, truth: int, size: int) -> float:
    found = []
    for chosen in itertools.combinations(range(len(said.score)), size):
        total = said.score[list(chosen)].sum(axis=0).round(9)
        total[said.entered[list(chosen)].any(axis=0)] = -np.inf
        found.append(rank(total, truth))
    return float(np.mean(found))


@pytest.mark.parametrize("size", [1, 2, 4, 6])
def test_averages_are_those_over_all_subsets(size: int) -> None:
    generator = np.random.default_rng(1)
    said = Judged(
        generator.integers(0, 4, (6, 9)) / 3.0,  # with ties
        generator.random((6, 9)) < 0.2,
    )
    said.entered[:, 3] = False
    found = ranks(said, 3, size, 4000, generator)
    spread = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - all_subsets(said, 3, size)) < 4.0 * spread + 1e-9
    assert spread > 0.0 or size == 6


def test_they_are_the_ranks_of_inference() -> None:
    made = sampled(PROBLEM, TASK, frozenset([TRUTH]), np.random.default_rng(0))[:6]
    for score in ("likelihood", "average"):
        said = judged(infer(EVIDENCE, made, score=score), noise=0.0)
        for size in (1, 3):
            expected = [
                rank(infer(EVIDENCE, list(chosen), score=score).score, TRUTH)
                for chosen in itertools.combinations(made, size)
            ]
            assert np.mean(expected) == pytest.approx(all_subsets(said, TRUTH, size))


def test_a_curve_falls_and_knows_its_error() -> None:
    made = sampled(PROBLEM, TASK, frozenset([TRUTH]), np.random.default_rng(0))[:40]
    said = judged(infer(EVIDENCE, made), 5e-4)
    found = curve(said, TRUTH, [1, 5, 20], num_trials=200)
    assert found.rank[0] > found.rank[1] >= found.rank[2] >= 1.0
    assert found.first[0] < found.first[2] <= 1.0
    low, high = found.interval
    assert (low <= found.rank).all()
    assert (found.rank <= high).all()
    assert low.min() >= 1.0
    others = [
        curve(judged(infer(EVIDENCE, one), 5e-4), TRUTH, [5]).rank[0]
        for one in (
            sampled(PROBLEM, TASK, frozenset([TRUTH]), np.random.default_rng(k))[:40]
            for k in range(1, 13)
        )
    ]
    assert 0.4 < np.std(others, ddof=1) / found.error[1] < 2.5  # over other sets of demonstrations


def test_what_no_trajectory_tells_apart_is_a_tie() -> None:
    """Violation probabilities below the noise count as 0."""
    made = sampled(PROBLEM, TASK, frozenset([TRUTH]), np.random.default_rng(0))[:2]
    violation = EVIDENCE.violation_probability[0]
    noise = float(np.median(violation))
    said = judged(infer(EVIDENCE, made), noise)
    assert (said.score[:, violation < noise] == 0.0).all()
    told = (said.score > 0.0) | said.entered  # or nobody can avoid it
    assert told[:, violation > noise].all()


def test_a_truth_that_is_ruled_out_comes_last() -> None:
    said = Judged(np.array([[2.0, 1.0, 0.0]]), np.array([[True, False, False]]))
    assert curve(said, 0, [1]).rank[0] == 3.0
