"""Greedy selection step by step, exact and sampled."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.reference import CART_TASK, short_cart
from support.synthetic import evidence_of_columns, make_demonstration
from support.walks import PROBLEM, ROUND, TASK, WORLD

from swerve import (
    Box,
    Demonstration,
    Gridworld,
    Problem,
    Task,
    Union,
    best_pair,
    divergence,
    greedy,
    grid,
    infer,
    learn,
    sample,
)
from swerve.base.space import Actions
from swerve.solvers.exact.tabular import TableNominal
from swerve.systems.gridworld import cell_box


def test_picks_raise_the_likelihood_most_and_take_it_off_the_divergence(
    nominal: TableNominal,
) -> None:
    picks = greedy(infer(sample(nominal, TASK), [ROUND]), nominal, threshold=0.01)
    assert len(picks) >= 3
    before = nominal.log_partition(TASK, [()])[0]
    for k, pick in enumerate(picks):
        chosen = [earlier.hypothesis for earlier in picks[:k]]
        left = [h for h in range(len(PROBLEM.hypotheses)) if h not in chosen]
        after = nominal.log_partition(TASK, [(*chosen, h) for h in left])
        possible = [
            value
            for h, value in zip(left, after, strict=True)
            if np.isfinite(value) and not _enters(h)
        ]
        assert pick.log_partition[0] == pytest.approx(min(possible), abs=1e-12)
        assert pick.gain == pytest.approx(before - min(possible), abs=1e-9)
        before = min(possible)
    start, end = (
        divergence(PROBLEM, [ROUND], np.array([value]))
        for value in (nominal.log_partition(TASK, [()])[0], picks[-1].log_partition[0])
    )
    assert start - end == pytest.approx(sum(pick.gain for pick in picks), abs=1e-9)


def _enters(hypothesis: int) -> bool:
    constraint = PROBLEM.hypotheses.constraint(hypothesis)
    if constraint.about_actions:
        assert ROUND.actions is not None
        return bool(constraint.forbids(Actions(("dx", "dy"), ROUND.actions)).any())
    return bool(constraint.contains(ROUND.states, WORLD.space).any())


def test_the_threshold_ends_it_and_its_pick_is_left_out(nominal: TableNominal) -> None:
    shown = infer(sample(nominal, TASK), [ROUND])
    every = greedy(shown, nominal, threshold=0.0)
    gains = [pick.gain for pick in every]
    least = 0.5 * (gains[1] + gains[2])
    some = greedy(shown, nominal, threshold=least)
    assert [pick.hypothesis for pick in some] == [
        pick.hypothesis for pick in every if pick.gain >= least
    ]
    assert (some.ended, some.threshold) == ("threshold", least)
    assert some.following is not None
    assert some.following.hypothesis == every[len(some)].hypothesis
    assert every.ended == "exhausted"
    two = greedy(shown, nominal, threshold=0.0, most=2)
    assert (len(two), two.ended, two.following) == (2, "most", None)


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
def test_a_task_without_demonstrations_may_be_impossible(
    nominal: TableNominal, tolerance: float
) -> None:
    """The other task starts where the first is kept from going: nobody there avoids the cell."""
    alone = infer(sample(nominal, TASK), [ROUND], tolerance=tolerance)
    expected = greedy(alone, nominal, threshold=0.01)
    kept_out = [PROBLEM.hypotheses.constraint(pick.hypothesis) for pick in expected[:-1]]
    cell = next(constraint for constraint in kept_out if isinstance(constraint, Box))
    inside = np.array([np.mean(cell.intervals[name]) for name in ("x", "y")])
    evidence = sample(nominal, [TASK, Task(inside, TASK.goal)])
    both = infer(evidence, [ROUND], tolerance=tolerance)
    assert evidence.log_ratio[1, expected[kept_out.index(cell)].hypothesis] == -np.inf
    picks = greedy(both, nominal, threshold=0.01)
    assert len(picks) >= 2
    assert [p.hypothesis for p in picks] == [p.hypothesis for p in expected]
    np.testing.assert_allclose([p.gain for p in picks], [p.gain for p in expected], atol=1e-12)
    pair, same = best_pair(both, nominal), best_pair(alone, nominal)
    assert pair.log_likelihood == pytest.approx(same.log_likelihood, abs=1e-12)


def test_what_no_sample_avoids_is_picked_as_a_bound() -> None:
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :, 5] = columns[0, :160, 6] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    first = greedy(infer(evidence, [make_demonstration()]), most=1)
    assert first[0].hypothesis == 5
    assert first[0].gain == pytest.approx(math.log(400.0))
    assert first[0].standard_error == 1.0
    columns[0, :, 6] = np.arange(400) % 2 == 0
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    after = greedy(infer(evidence, [make_demonstration()]))
    assert [pick.hypothesis for pick in after] == [5]  # no trajectory is left to tell of 6


def test_gains_of_samples_come_with_their_errors() -> None:
    """Of 400, half enter 5, and a quarter of the others 7: delta method of a binomial."""
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :200, 5] = columns[0, 200:250, 7] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    picks = greedy(infer(evidence, [make_demonstration()]), threshold=0.1)
    expected = [math.sqrt(0.5 * 0.5 / 400) / 0.5, math.sqrt(0.25 * 0.75 / 200) / 0.75]
    np.testing.assert_allclose([pick.standard_error for pick in picks], expected, rtol=1e-6)


def test_near_certain_violations_are_no_impossible_ones() -> None:
    """A detour of six moves at 200 nats each: a ratio that no float holds."""
    world = Gridworld(width=5, height=8, num_steps=24, step_reward=-200.0)
    wall = Union("wall", [cell_box((2, y)) for y in range(7)])
    problem = Problem(world, [wall, cell_box((2, 0))], measure="counting", between_states=False)
    task = Task(np.zeros(2), np.array([4.0, 0.0]))
    nominal = learn(problem)
    assert isinstance(nominal, TableNominal)
    masses = nominal.log_partition(task, [(), (0,)])
    assert masses[0] - masses[1] > 1000.0
    result = infer(sample(nominal, task))
    assert result.log_likelihood[0] == pytest.approx(masses[0] - masses[1])
    assert result.ranking.tolist() == [0, 1]


def test_sampled_greedy_leaves_out_what_enters_the_picks() -> None:
    """Cell 5 is entered by half, cell 6 by the same half, cell 7 by a quarter of the others."""
    columns = np.zeros((1, 400, 10), bool)
    columns[0, :200, 5] = columns[0, :199, 6] = True
    columns[0, 200:250, 7] = True
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
    picks = greedy(infer(evidence, [make_demonstration()]), threshold=0.1)
    assert [pick.hypothesis for pick in picks] == [5, 7]
    np.testing.assert_allclose(
        [pick.gain for pick in picks], [math.log(2.0), -math.log(0.75)], rtol=1e-6
    )
    kept = [pick.log_partition[0] - picks[0].log_partition[0] for pick in picks]
    np.testing.assert_allclose(kept, [0.0, math.log(0.75)], atol=1e-6)


def test_bad_arguments(nominal: TableNominal) -> None:
    shown = infer(sample(nominal, TASK), [ROUND])
    for threshold in (-0.1, math.nan, math.inf):
        with pytest.raises(
            ValueError, match=f"threshold: expected a number >= 0 .* got {threshold}"
        ):
            greedy(shown, nominal, threshold=threshold)
    for odds in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=f"odds: expected a finite number > 0, got {odds}"):
            greedy(shown, nominal, odds=odds)
    with pytest.raises(ValueError, match="inference: expected one from at least one demonstration"):
        greedy(infer(sample(nominal, TASK)), nominal)
    with pytest.raises(
        ValueError, match=r"(?s)inference: expected a swerve.Inference.* swerve.infer"
    ):
        greedy(nominal, [ROUND])  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"this evidence is exact .* give the nominal"):
        greedy(shown)
    with pytest.raises(
        ValueError, match=r"nominal: expected the nominal .* of an exact solver, got \[\]"
    ):
        greedy(shown, [])  # pyright: ignore[reportArgumentType]
    other = learn(dataclasses.replace(PROBLEM, beta=2.0))
    assert isinstance(other, TableNominal)
    with pytest.raises(ValueError, match=r"nominal: expected that of .* got that of .*beta 2"):
        greedy(shown, other)
    evidence = sample(learn(short_cart(), "grid?num_points=41"), CART_TASK, 100)
    bare = Demonstration("bare", np.array([[0.6, 0.3], [0.5, -0.2]]), CART_TASK)
    greedy(infer(evidence, [bare]))
    with pytest.raises(ValueError, match=r"nominal: this evidence was sampled.* leave the nominal"):
        greedy(infer(evidence, [bare]), nominal)
    with pytest.raises(ValueError, match="bare: expected actions force, got none"):
        divergence(short_cart(), [bare], np.zeros(1))
