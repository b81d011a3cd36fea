"""Greedy selection on samples is exactly what weighing everything anew says."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.plain_greedy import Plain, made_up
from support.synthetic import (
    SPACE,
    TASKS,
    copied,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve import Box, Demonstration, Evidence, Inference, Task, greedy, grid, infer
from swerve.base.space import TWO_PI
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.inference.greedy import Pick


def assert_picks(picks: list[Pick], inference: Inference, threshold: float) -> None:
    """The picks are those of weighing everything anew, up to the first that gains too little."""
    plain, num = Plain(inference), len(inference.demonstrations)
    for pick in picks:
        gains = plain.gains()
        assert pick.total_gain == pytest.approx(gains.max(), rel=1e-9)
        assert pick.gain == pytest.approx(gains.max() / num, rel=1e-9)
        tied = np.flatnonzero(gains >= gains.max() - 1e-9 * num * max(1.0, gains.max() / num))
        assert pick.hypothesis == tied[0]
        prior = np.delete(inference.prior[1:], plain.picked)
        with np.errstate(over="ignore"):
            factor = prior @ np.exp(np.delete(gains, plain.picked)) / prior.sum()
        assert pick.log_odds == pytest.approx(math.log(factor), rel=1e-9, abs=1e-9)
        plain.add(pick.hypothesis)
        share = pick.log_partition - inference.evidence.log_partition
        np.testing.assert_allclose(share, plain.log_share, atol=1e-9)
    assert plain.gains().max() / num < max(threshold, 2e-9)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    tolerance=st.sampled_from([0.0, 0.01, 0.3]),
    counted=st.sampled_from([1.0, 0.7]),
    num_trajectories=st.sampled_from([25, 300]),
)
@example(
    seed=9663, tolerance=0.01, counted=0.7, num_trajectories=25
)  # nothing left tells of a task
def test_picks_are_those_of_weighing_everything_anew(
    seed: int, tolerance: float, counted: float, num_trajectories: int
) -> None:
    inference = made_up(seed, tolerance, counted, num_trajectories)
    assert_picks(greedy(inference, threshold=0.02), inference, 0.02)


def test_all_settings_come_to_more_than_one_pick() -> None:
    """What the property above rests on."""
    for tolerance in (0.0, 0.3):
        found = [greedy(made_up(seed, tolerance, 0.7, 300)) for seed in range(10)]
        assert sum(len(picks) >= 2 for picks in found) >= 5


def windows(counts: list[int]) -> Evidence:
    """Evidence of trajectories at as many places in a row, and windows of three places each."""
    places = 2.0 + 0.7 * np.repeat(np.arange(len(counts)), counts)
    states = np.stack([np.full(len(places), 0.1), places], axis=1)[:, None]
    boxes = [
        Box(x=(1.65 + 0.7 * first, 1.65 + 0.7 * (first + 3))) for first in range(len(counts) - 2)
    ]
    hypotheses = ConstraintHypotheses(boxes)
    bits = hypotheses.violations(states, SPACE, between_states=False)
    return evidence_of_columns(unpack(bits, len(boxes))[None], hypotheses)


def test_a_neighbour_gains_only_what_the_first_pick_leaves() -> None:
    """Windows 1 and 3 are next best alone, at 45 of 100, but window 2 explains 40 of these."""
    evidence = windows([5, 5, 10, 30, 10, 5, 4, 20, 6, 5])
    inference = infer(evidence, [make_demonstration()])
    assert inference.ranking[:3].tolist() == [2, 1, 3]
    np.testing.assert_allclose(inference.log_likelihood[[1, 2, 3]], np.log([1 / 0.55, 2, 1 / 0.55]))
    picks = greedy(inference, threshold=0.0)
    assert [pick.hypothesis for pick in picks[:3]] == [2, 7, 0]
    expected = [50 / 100, 19 / 50, 9 / 19]
    np.testing.assert_allclose([pick.gain for pick in picks[:3]], -np.log(expected))
    assert [pick.hypothesis for pick in greedy(inference, threshold=0.8)] == []
    assert len(greedy(inference, threshold=0.69)) == 4


def test_odds_of_one_more_by_hand() -> None:
    """Of 400, half enter 5, and a quarter of the others 7; a third of the rest enters 8."""
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :200, 5] = columns[0, 200:250, 7] = columns[0, 250:300, 8] = True
    inference = infer(evidence_of_columns(columns, grid(x=(0.0, 10.0, 10))), [make_demonstration()])
    assert inference.struck_out.tolist() == [False] + [True] + 8 * [False]
    picks = greedy(inference, threshold=0.1)
    factors = [
        (6 * 1 + 2 + 2 * 1 / 0.875) / 10,
        (6 * 1 + 2 / 0.75) / 9,
        (6 * 1 + 1 / (2 / 3)) / 8,
    ]
    assert [pick.hypothesis for pick in picks] == [5, 7, 8]
    assert picks.effective_samples == pytest.approx(100.0)
    np.testing.assert_allclose([pick.log_odds for pick in picks], np.log(factors))
    assert picks[0].log_odds == pytest.approx(inference.log_bayes_factor)
    for asked in (greedy(inference), greedy(inference, odds=1.0)):
        assert [pick.hypothesis for pick in asked] == [5]  # factors[1] < 1
        assert asked[0].log_odds == pytest.approx(math.log(factors[0]))
        assert asked.following is not None
        assert (asked.ended, asked.following.hypothesis) == ("odds", 7)
        assert asked.effective_samples == pytest.approx(200.0)
        assert asked.following.log_odds == pytest.approx(math.log(factors[1]))
    few = greedy(inference, odds=0.99 / factors[1])
    assert [pick.hypothesis for pick in few] == [5]
    more = greedy(inference, odds=1.01 / factors[1])
    assert [pick.hypothesis for pick in more] == [5, 7]
    assert more[1].log_odds == pytest.approx(math.log(1.01))


def test_the_prior_weighs_the_odds() -> None:
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :200, 5] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    sure = np.array([0.5, *(0.5 * (np.arange(10) == 5))])
    shown = [make_demonstration()] * 3
    picks = greedy(infer(evidence, shown, prior=sure))
    assert picks[0].log_odds == pytest.approx(3 * math.log(2))
    assert (len(picks), picks.ended) == (1, "exhausted")  # the prior of all others is 0
    never = infer(evidence, shown, prior=1.0)
    [pick] = greedy(never, threshold=0.1)
    assert pick.log_odds == -math.inf
    for picks in (greedy(never), greedy(never, odds=1.0)):
        assert (picks, picks.ended) == ([], "odds")
    other = infer(evidence, shown, prior=np.array([0.5, *(0.5 * (np.arange(10) == 3))]))
    assert greedy(other, threshold=0.1) == []


def test_digits_are_kept_where_nearly_everything_is_covered() -> None:
    """The first covers all but 1e-13 of the weight; a fifth of what is left enters the next."""
    columns = np.zeros((1, 500, 10), bool)
    columns[0, :100, 5] = columns[0, 100:180, 7] = True
    columns[0, 100:500:8, 8] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)), method="importance")
    heavy = np.where(np.arange(500) < 100, 30.0, 0.0)[None]
    samples = evidence.samples._replace(log_correction=heavy)
    evidence = make_evidence(evidence.problem, samples, evidence.tasks)
    picks = greedy(infer(evidence, [make_demonstration()]), threshold=0.1)
    assert [pick.hypothesis for pick in picks] == [5, 7, 8]
    np.testing.assert_allclose(
        [pick.gain for pick in picks[1:]], -np.log([0.8, 1 - 40 / 320]), rtol=1e-12
    )


def test_a_demonstration_that_ignores_a_pick_says_nothing_more() -> None:
    """By hand, eps = 0.1: of three, one enters 5, as 360 of 400 trajectories do."""
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :360, 5] = columns[0, 360:380, 7] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    shown = [make_demonstration(), make_demonstration(), make_demonstration(x=5.5)]
    picks = greedy(infer(evidence, shown, tolerance=0.1))
    assert [pick.hypothesis for pick in picks] == [5, 7]
    obeyed, both = math.log(0.1 + 0.9 / 0.1), math.log(0.1 + 0.9 / 0.05)
    assert picks[0].total_gain == pytest.approx(2 * obeyed + math.log(0.1))
    assert picks[1].total_gain == pytest.approx(2 * (both - obeyed))
    slope = 0.9 / 0.05 / (0.1 + 0.9 / 0.05)  # of what one says, by log P
    error = 2 * slope * math.sqrt(0.5 * 0.5 / 40) / 0.5
    assert picks[1].standard_error == pytest.approx(error / 3)


def test_a_task_that_says_nothing_of_a_pick_keeps_it_out_of_force() -> None:
    """The second does not count for 5: there 7 gains what it gains alone."""
    columns = np.zeros((2, 400, 10), bool)
    columns[:, :240, 5] = columns[:, 200:290, 7] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    shown = [make_demonstration(0), make_demonstration(0), make_demonstration(1)]
    start = infer(evidence, shown)
    is_counted = start.is_counted.copy()
    is_counted[1, 5] = False
    picks = greedy(dataclasses.replace(start, is_counted=is_counted, entered=start.entered & False))
    assert [pick.hypothesis for pick in picks] == [5, 7]
    assert picks[0].total_gain == pytest.approx(-2 * math.log(160 / 400))
    assert picks[1].total_gain == pytest.approx(-2 * math.log(110 / 160) - math.log(310 / 400))
    share = picks[1].log_partition - evidence.log_partition
    np.testing.assert_allclose(share, np.log([110 / 400, 310 / 400]))


def test_order_of_hypotheses_does_not_matter() -> None:
    """Reversed, the same are picked, at the same gains."""
    generator = np.random.default_rng(3)
    columns = generator.random((3, 500, 12)) < generator.uniform(0.05, 0.4, 12)
    shown = [make_demonstration(k) for k in range(3)]
    cells = grid(theta=(0.0, TWO_PI, 4), x=(0.0, 9.0, 3))
    found = []
    for order in (slice(None), slice(None, None, -1)):
        start = infer(evidence_of_columns(columns[:, :, order], cells), shown)
        start = dataclasses.replace(start, entered=np.zeros_like(start.entered))
        found.append(greedy(start, threshold=0.02))
    assert len(found[0]) >= 3
    assert [p.hypothesis for p in found[0]] == [11 - p.hypothesis for p in found[1]]
    np.testing.assert_allclose([p.gain for p in found[0]], [p.gain for p in found[1]], rtol=1e-9)


def test_what_resolving_worked_out_counts_for_the_first_pick() -> None:
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :, 5] = columns[0, :160, 6] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    log_ratio, error = (x.copy() for x in (evidence.log_ratio, evidence.standard_error))
    log_ratio[0, 5], error[:], error[0, 5] = -40.0, np.nan, 0.05
    summary = evidence.summary._replace(log_ratio=log_ratio, log_ratio_error=error)
    resolved = dataclasses.replace(evidence, summary=summary)
    [pick] = greedy(infer(resolved, [make_demonstration()]))
    assert (pick.hypothesis, pick.gain, pick.standard_error) == (5, 40.0, 0.05)


def test_nothing_that_gains_is_nothing_picked() -> None:
    evidence = evidence_of_columns(np.zeros((1, 40, 10)), grid(x=(0.0, 10.0, 10)))
    assert greedy(infer(evidence, [make_demonstration()]), threshold=0.0) == []
    every = make_evidence(make_record(), make_samples())
    stops = [Demonstration("all", np.array([[0.1, 1.0]] * 2), Task(*(x[0] for x in TASKS)))]
    inference = infer(every, stops)
    struck = dataclasses.replace(inference, entered=np.ones_like(inference.entered))
    assert greedy(struck) == []


@pytest.mark.parametrize("num_copies", [1, 10])
def test_errors_are_how_far_gains_differ_when_sampled_again(num_copies: int) -> None:
    """Errors that took copies for independent would be less than a third of the spread."""
    evidence = [copied(seed, num_copies, "plain") for seed in range(200)]
    found = [greedy(infer(x, [make_demonstration()]), threshold=0.1, most=2) for x in evidence]
    assert all([pick.hypothesis for pick in picks] == [5, 7] for picks in found)
    for place in range(2):
        spread = np.std([picks[place].gain for picks in found], ddof=1)
        error = np.mean([picks[place].standard_error for picks in found])
        assert 0.8 < error / spread < 1.25


def test_what_is_left_of_one_island_tells_no_error() -> None:
    columns = np.zeros((1, 400, 10), bool)
    columns[0, 10:, 5] = columns[0, :5, 7] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    samples = evidence.samples._replace(ancestor=np.arange(400)[None] // 2)
    evidence = make_evidence(evidence.problem, samples, evidence.tasks, "plain")
    picks = greedy(infer(evidence, [make_demonstration()]))
    assert [pick.hypothesis for pick in picks] == [5, 7]
    assert picks[1].gain == pytest.approx(math.log(2.0))
    assert picks[1].standard_error == math.inf
