from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.base import Predicate, violates
from swerve.constraints.boxes import Box
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses, grid
from swerve.hypotheses.stored import hypotheses_from_json

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
ARM = StateSpace(("a", "rate", "b"), ("a", "b"), np.array([[0.0, 7.0], [-2.0, 2.0], [0.0, 7.0]]))
seeds = st.integers(0, 2**32 - 1)
fewer = settings(max_examples=25)  # each holds many trajectories
both_settings = pytest.mark.parametrize("between_states", [True, False])
angle_ranges = pytest.mark.parametrize(
    "theta",
    [
        pytest.param((0.0, TWO_PI, 10), id="full circle"),
        pytest.param((7.0, 7.0 + TWO_PI, 9), id="full circle from beyond 2 pi"),
        pytest.param((-20.3, -20.3 + TWO_PI, 1), id="one cell for the circle"),
        pytest.param((-20.3, -20.3 + TWO_PI, 2), id="two cells for the circle"),
        pytest.param((1.0, 5.7, 5), id="most of the circle"),
        pytest.param((13.0, 17.5, 1), id="one cell for most of the circle"),
    ],
)


def as_list(cells: GridHypotheses) -> ConstraintHypotheses:
    return ConstraintHypotheses([cells.constraint(k) for k in range(len(cells))])


def entered(
    hypotheses: HypothesisSet, states: np.ndarray, space: StateSpace, between_states: bool
) -> np.ndarray:
    return unpack(hypotheses.violations(states, space, between_states), len(hypotheses))


def walks(generator: np.random.Generator, num: int = 25, length: int = 6) -> np.ndarray:
    """Random walks [N, L, 2] of short and long steps that leave the grid now and then."""
    steps = generator.normal(size=(num, length, 2)) * generator.choice([0.1, 1.0, 3.0], (num, 1, 1))
    return generator.uniform([-9.0, -5.0], [9.0, 5.0], (num, 1, 2)) + np.cumsum(steps, axis=1)


def refined(states: np.ndarray, generator: np.random.Generator, space: StateSpace) -> np.ndarray:
    """The same polylines with two points more on each segment, somewhere."""
    steps = space.difference(states[:, :-1], states[:, 1:])
    fractions = np.sort(generator.uniform(0.0, 1.0, (2, *steps.shape[:2], 1)), axis=0)
    parts = [states[:, :-1], *(states[:, :-1] + fraction * steps for fraction in fractions)]
    finer = np.stack(parts, axis=2).reshape(len(states), -1, states.shape[-1])
    return np.concatenate([finer, states[:, -1:]], axis=1)


class TestGridAgreesWithBoxes:
    @both_settings
    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_with_an_angle(self, theta, between_states, seed) -> None:
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, between_states),
            as_list(cells).violations(states, PENDULUM, between_states),
        )

    @fewer
    @given(seed=seeds)
    def test_with_a_small_range_of_an_angle_at_states_alone(self, seed) -> None:
        cells = grid(theta=(6.0, 7.5, 4), omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, False),
            as_list(cells).violations(states, PENDULUM, False),
        )

    @both_settings
    @fewer
    @given(seed=seeds)
    def test_in_the_plane(self, between_states, seed) -> None:
        cells = grid(y=(-3.0, 3.5, 5), x=(-2.0, 4.0, 9))
        states = walks(np.random.default_rng(seed))
        np.testing.assert_array_equal(
            cells.violations(states, PLANE, between_states),
            as_list(cells).violations(states, PLANE, between_states),
        )

    @both_settings
    @fewer
    @given(seed=seeds)
    def test_with_two_angles_and_three_axes(self, between_states, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(b=(-1.0, TWO_PI - 1.0, 4), rate=(-1.5, 1.5, 3), a=(0.5, 6.0, 5))
        states = np.cumsum(generator.normal(size=(20, 5, 3)), axis=1)
        np.testing.assert_array_equal(
            cells.violations(states, ARM, between_states),
            as_list(cells).violations(states, ARM, between_states),
        )

    @fewer
    @given(seed=seeds)
    def test_at_states_on_the_lines(self, seed) -> None:
        """On eighths all lines are exact."""
        generator = np.random.default_rng(seed)
        cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
        states = generator.integers(-32, 33, (20, 5, 2)) / 8
        np.testing.assert_array_equal(
            cells.violations(states, PLANE, False), as_list(cells).violations(states, PLANE, False)
        )

    @fewer
    @given(seed=seeds)
    def test_on_segments_along_the_lines(self, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
        steps = generator.integers(-16, 17, (20, 8, 2)) / 8
        steps[np.arange(8) % 2 == generator.integers(0, 2, (20, 1)), 0] = 0.0
        steps[steps[..., 0] != 0, 1] = 0.0
        states = np.cumsum(steps, axis=1)
        np.testing.assert_array_equal(
            cells.violations(states, PLANE, True), as_list(cells).violations(states, PLANE, True)
        )


class TestCells:
    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_the_cell_of_a_state_contains_it_and_no_other_does(self, theta, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=theta, omega=(-4.0, 4.5, 3))
        states = generator.uniform([-30.0, -5.0], [30.0, 5.5], (60, 2))
        found = cells.cells(states, PENDULUM)
        inside = np.stack([box.contains(states, PENDULUM) for box in as_list(cells).constraints], 1)
        np.testing.assert_array_equal(inside.sum(axis=1), found >= 0)
        np.testing.assert_array_equal(np.where(found >= 0, inside.argmax(axis=1), -1), found)

    @pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 12, 36, 100])
    def test_a_state_at_rest_on_a_line_enters_exactly_one_cell(self, count: int) -> None:
        """Whatever the rounding, and whichever multiple of 2 pi is added."""
        low = -1.3
        lines = low + TWO_PI / count * np.arange(count + 1)
        theta = np.concatenate([lines + TWO_PI * turn for turn in range(-3, 4)])
        theta = np.concatenate([theta, np.nextafter(theta, 100.0), np.nextafter(theta, -100.0)])
        states = np.stack([theta, np.full(len(theta), 0.5)], axis=-1)
        at_rest = np.repeat(states[:, None], 3, axis=1)
        cells = grid(theta=(low, low + TWO_PI, count), omega=(0.0, 1.0, 1))
        for between_states in (True, False):
            hits = entered(cells, at_rest, PENDULUM, between_states)
            np.testing.assert_array_equal(hits.sum(axis=1), 1)

    @pytest.mark.parametrize("tiny", [0.0, -0.0, -1e-300, -1e-17, 1e-17, -1e-16, 5e-324])
    def test_no_angle_falls_between_the_last_cell_and_the_first(self, tiny: float) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10))
        for turn in (-1, 0, 1):
            cell = cells.cells(np.array([[tiny + TWO_PI * turn, 0.0]]), PENDULUM)
            assert cell[0] in (0, 9)

    def test_lines_belong_to_the_cell_above(self) -> None:
        cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
        x, y = np.meshgrid(-2.0 + 0.5 * np.arange(9), -3.0 + np.arange(7), indexing="ij")
        found = cells.cells(np.stack([x, y], axis=-1), PLANE)
        expected = np.full((9, 7), -1)
        expected[:8, :6] = np.arange(48).reshape(8, 6)
        np.testing.assert_array_equal(found, expected)

    def test_the_last_axis_is_fastest(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-6.0, 6.0, 10))
        assert cells.cells(np.array([3.3, 0.6]), PENDULUM) == 55
        assert cells.constraint(55).intervals["theta"] == pytest.approx((math.pi, 1.2 * math.pi))
        assert cells.constraint(55).intervals["omega"] == pytest.approx((0.0, 1.2))
        assert cells.name(55) == "theta [3.14, 3.77), omega [0, 1.2)"
        swapped = grid(omega=(-6.0, 6.0, 10), theta=(0.0, TWO_PI, 10))
        assert swapped.cells(np.array([0.1, 0.6]), PENDULUM) == 50

    def test_outside_is_minus_one(self) -> None:
        cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
        states = np.array([[-2.1, 0.0], [2.0, 0.0], [0.0, 3.0], [0.0, -1e12], [1e300, 0.0]])
        np.testing.assert_array_equal(cells.cells(states, PLANE), -1)
        gap = grid(theta=(1.0, 2.0, 4))
        theta = np.array([0.9, 1.0, 1.99, 2.0, 2.1, 1.5 + TWO_PI, 2.5 - 2 * TWO_PI])
        found = gap.cells(np.stack([theta, np.zeros(7)], axis=-1), PENDULUM)
        np.testing.assert_array_equal(found, [-1, 0, 3, -1, -1, 2, -1])

    def test_axes_that_are_not_named_are_free(self) -> None:
        cells = grid(y=(0.0, 2.0, 2))
        states = np.array([[-1e6, 0.5], [1e6, 1.5]])
        np.testing.assert_array_equal(cells.cells(states, PLANE), [0, 1])


class TestViolations:
    @angle_ranges
    @both_settings
    @fewer
    @given(seed=seeds, turns=st.integers(-4, 4))
    def test_whole_turns_change_nothing(self, theta, between_states, seed, turns) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(generator)
        turned = states.copy()
        turned[..., 0] += TWO_PI * generator.integers(-2, 3, states.shape[:2]) + TWO_PI * turns
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, between_states),
            cells.violations(turned, PENDULUM, between_states),
        )

    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_points_inserted_on_segments_change_nothing(self, theta, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(generator)
        finer = refined(states, generator, PENDULUM)
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, True), cells.violations(finer, PENDULUM, True)
        )

    @fewer
    @given(seed=seeds)
    def test_inserted_points_add_violations_where_states_alone_are_judged(self, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(generator)
        coarse = entered(cells, states, PENDULUM, False)
        finer = entered(cells, refined(states, generator, PENDULUM), PENDULUM, False)
        between = entered(cells, states, PENDULUM, True)
        assert not (coarse & ~finer).any()
        assert not (finer & ~between).any()

    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_segments_only_add_to_states(self, theta, seed) -> None:
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        alone, between = (entered(cells, states, PENDULUM, flag) for flag in (False, True))
        assert not (alone & ~between).any()
        found = cells.cells(states, PENDULUM)
        for row in range(len(states)):
            assert set(np.flatnonzero(alone[row])) == set(found[row][found[row] >= 0])

    @both_settings
    @fewer
    @given(seed=seeds)
    def test_direction_does_not_matter(self, between_states, seed) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, between_states),
            cells.violations(states[:, ::-1], PENDULUM, between_states),
        )

    @both_settings
    def test_each_trajectory_is_judged_alone(self, between_states: bool) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(3), num=40)
        together = cells.violations(states, PENDULUM, between_states)
        alone = [cells.violations(states[k : k + 1], PENDULUM, between_states) for k in range(40)]
        np.testing.assert_array_equal(together, np.concatenate(alone))

    @fewer
    @given(seed=seeds)
    def test_a_segment_enters_one_cell_more_than_it_crosses_lines(self, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(x=(-4.0, 4.0, 16), y=(-4.0, 4.0, 10))
        states = generator.uniform(-4.0, 4.0, (50, 2, 2))
        lines = np.abs(np.diff(np.floor((states + 4.0) / [0.5, 0.8]), axis=1)).sum(axis=(1, 2))
        np.testing.assert_array_equal(entered(cells, states, PLANE, True).sum(axis=1), 1 + lines)

    def test_cells_of_single_segments(self) -> None:
        cells = grid(x=(0.0, 4.0, 4), y=(0.0, 3.0, 3))
        paths = {
            ((0.5, 0.5), (3.5, 0.5)): {0, 3, 6, 9},
            ((0.5, 0.5), (0.5, 2.5)): {0, 1, 2},
            ((0.5, 0.2), (2.5, 2.1)): {0, 3, 4, 7, 8},
            ((-5.0, 1.5), (9.0, 1.5)): {1, 4, 7, 10},
            ((-5.0, 1.5), (-1.0, 9.0)): set(),
            ((2.5, -1.0), (2.5, 0.5)): {6},
        }
        for ends, expected in paths.items():
            hits = entered(cells, np.array([ends]), PLANE, True)[0]
            assert set(np.flatnonzero(hits)) == expected, ends

    def test_the_shorter_arc_is_taken(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 8))
        states = np.array([[[0.1, 0.0], [TWO_PI - 0.9, 0.0]], [[3.0, 0.0], [3.5 - TWO_PI, 0.0]]])
        hits = entered(cells, states, PENDULUM, True)
        assert [set(np.flatnonzero(row)) for row in hits] == [{0, 7, 6}, {3, 4}]

    def test_float32_states_are_judged_as_they_are(self) -> None:
        """In float32 0.7 lies below 0.7, but its seventh part of a tenth is rounded to 7."""
        cells = grid(x=(0.0, 1.0, 10))
        states = np.full((1, 2, 2), 0.7, np.float32)
        for hypotheses in (cells, as_list(cells)):
            hits = entered(hypotheses, states, PLANE, True)[0]
            assert set(np.flatnonzero(hits)) == {6}

    def test_a_million_cells(self) -> None:
        """Each trajectory enters few of them, and exactly those that its states or segments do."""
        cells = grid(x=(-4.0, 4.0, 1000), y=(-4.0, 4.0, 1000))
        assert len(cells) == 10**6
        generator = np.random.default_rng(0)
        states = generator.uniform(-4.0, 4.0, (4, 3, 2))
        index = np.floor((states + 4.0) / 0.008).astype(int)
        alone = cells.violations(states, PLANE, False)
        assert alone.shape == (4, 125_000)
        for row, found in zip(unpack(alone, 10**6), index, strict=True):
            expected = np.unique(np.ravel_multi_index(tuple(found.T), (1000, 1000)))
            np.testing.assert_array_equal(np.flatnonzero(row), expected)
        between = unpack(cells.violations(states[:, :2], PLANE, True), 10**6)
        lines = np.abs(np.diff(index[:, :2], axis=1)).sum(axis=(1, 2))
        np.testing.assert_array_equal(between.sum(axis=1), 1 + lines)
        dense = states[:, :1] + np.linspace(0, 1, 20_001)[:, None] * (
            states[:, 1:2] - states[:, :1]
        )
        for row, found in zip(between, cells.cells(dense, PLANE), strict=True):
            assert set(found) <= set(np.flatnonzero(row))
            assert len(set(found)) > 0.95 * row.sum()

    def test_a_long_way_through_a_million_cells(self) -> None:
        cells = grid(x=(-4.0, 4.0, 1000), y=(-4.0, 4.0, 1000))
        across = np.array([[[-9.0, 0.004], [9.0, 0.004]]])
        hits = np.flatnonzero(entered(cells, across, PLANE, True)[0])
        np.testing.assert_array_equal(hits, 500 + 1000 * np.arange(1000))


class TestLists:
    @both_settings
    def test_each_column_is_one_constraint(self, between_states: bool) -> None:
        constraints = [
            Box(theta=(0.0, 1.0)),
            Predicate("fast", lambda states: abs(states[..., 1]) > 2.0),
            Box(theta=(-1.0, 1.0), omega=(0.0, math.inf)),
            *(Box(omega=(k / 2, k / 2 + 1.0)) for k in range(-4, 4)),
        ]
        hypotheses = ConstraintHypotheses(constraints)
        states = walks(np.random.default_rng(1))
        columns = [violates(c, states, PENDULUM, between_states) for c in constraints]
        bits = hypotheses.violations(states, PENDULUM, between_states)
        assert bits.shape == (25, 2)
        np.testing.assert_array_equal(unpack(bits, len(hypotheses)), np.stack(columns, axis=-1))
        assert [hypotheses.constraint(k) for k in range(len(hypotheses))] == constraints

    @fewer
    @given(seed=seeds)
    def test_order_does_not_matter(self, seed) -> None:
        generator = np.random.default_rng(seed)
        boxes = as_list(grid(theta=(0.0, TWO_PI, 5), omega=(-4.0, 4.0, 4))).constraints
        order = generator.permutation(len(boxes))
        states = walks(generator)
        shuffled = ConstraintHypotheses(boxes[k] for k in order)
        np.testing.assert_array_equal(
            entered(shuffled, states, PENDULUM, True),
            entered(ConstraintHypotheses(boxes), states, PENDULUM, True)[:, order],
        )

    def test_state_names_and_code(self) -> None:
        boxes = ConstraintHypotheses([Box(omega=(0, 1)), Box(theta=(0, 1), omega=(0, 1))])
        assert boxes.state_names == ("omega", "theta")
        assert not boxes.needs_code
        assert ConstraintHypotheses([Predicate("p", lambda s: s[..., 0] > 0)]).needs_code
        assert not grid(theta=(0.0, 1.0, 2)).needs_code
        assert grid(omega=(0.0, 1.0, 2), theta=(0.0, 1.0, 2)).state_names == ("omega", "theta")

    def test_an_empty_list_is_refused(self) -> None:
        with pytest.raises(ValueError, match="hypotheses: expected at least one constraint, got"):
            ConstraintHypotheses([])

    def test_check_names_the_hypothesis(self) -> None:
        wrong: Any = [Box(theta=(0, 1)), "wall"]
        with pytest.raises(ValueError, match=r"hypotheses\[1\]: expected a Constraint, got 'wall'"):
            ConstraintHypotheses(wrong).check(PENDULUM, ())
        with pytest.raises(ValueError, match="no state named 'x'; the states are theta, omega"):
            ConstraintHypotheses([Box(x=(0, 1))]).check(PENDULUM, ())


class TestPacking:
    @fewer
    @given(seed=seeds, num=st.integers(1, 40), shape=st.sampled_from([(), (3,), (2, 0), (2, 3)]))
    def test_round_trip(self, seed, num, shape) -> None:
        booleans = np.random.default_rng(seed).random((*shape, num)) < 0.5
        bits = np.packbits(booleans, axis=-1, bitorder="little")
        assert bits.shape[-1] == -(-num // 8)
        np.testing.assert_array_equal(unpack(bits, num), booleans, strict=True)

    @pytest.mark.parametrize("num", [1, 7, 8, 9, 20])
    @pytest.mark.parametrize("as_boxes", [True, False])
    def test_bit_h_and_7_of_byte_h_over_8(self, num: int, as_boxes: bool) -> None:
        cells = grid(x=(0.0, float(num), num))
        hypotheses = as_list(cells) if as_boxes else cells
        for h in range(num):
            states = np.array([[[h + 0.5, 0.0]] * 2])
            bits = hypotheses.violations(states, PLANE, True)
            expected = np.zeros((1, -(-num // 8)), np.uint8)
            expected[0, h >> 3] = 1 << (h & 7)
            np.testing.assert_array_equal(bits, expected, strict=True)


class TestGrid:
    def test_length_and_boxes(self) -> None:
        cells = grid(x=(0.0, 1.0, 3), y=(-1.0, 1.0, 4))
        assert len(cells) == 12
        assert cells.shape == (3, 4)
        for k, (i, j) in enumerate(itertools.product(range(3), range(4))):
            box = cells.constraint(k)
            assert box.intervals["x"] == pytest.approx((i / 3, (i + 1) / 3))
            assert box.intervals["y"] == pytest.approx((-1 + j / 2, -0.5 + j / 2))

    @pytest.mark.parametrize("index", [-1, 12, 1000])
    def test_an_index_out_of_range_is_refused(self, index: int) -> None:
        cells = grid(x=(0.0, 1.0, 3), y=(-1.0, 1.0, 4))
        for hypotheses in (cells, as_list(cells)):
            message = f"hypothesis {index}: expected an index from 0 to 11"
            with pytest.raises(ValueError, match=message):
                hypotheses.constraint(index)

    def test_no_axis_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"at least one axis, as in grid\(x=\(0.0, 1.0, 10\)"):
            grid()

    @pytest.mark.parametrize(
        ("axis", "message"),
        [
            ((0.0, 1.0), r"expected x=\(low, high, number of cells\), got \(0.0, 1.0\)"),
            ((1.0, 1.0, 3), r"expected finite low < high for 'x', got \(1.0, 1.0\)"),
            ((0.0, math.inf, 3), r"expected finite low < high for 'x', got \(0.0, inf\)"),
            ((math.nan, 1.0, 3), r"expected finite low < high for 'x', got \(nan, 1.0\)"),
            ((0.0, 1.0, 0), "expected a whole number of cells for 'x', got 0"),
            ((0.0, 1.0, -2), "expected a whole number of cells for 'x', got -2"),
            ((0.0, 1.0, 2.5), "expected a whole number of cells for 'x', got 2.5"),
        ],
    )
    def test_axes_that_are_no_range_are_refused(self, axis: Any, message: str) -> None:
        with pytest.raises(ValueError, match=f"grid: {message}"):
            grid(x=axis)

    def test_check(self) -> None:
        grid(theta=(1.0, 1.0 + TWO_PI, 4), omega=(0.0, 99.0, 2)).check(PENDULUM, ())
        with pytest.raises(ValueError, match="no state named 'x'; the states are theta, omega"):
            grid(x=(0.0, 1.0, 2)).check(PENDULUM, ())
        with pytest.raises(ValueError, match=r"'theta' is an angle, .* a width of 7 rad"):
            grid(theta=(0.0, 7.0, 4)).check(PENDULUM, ())


class TestJson:
    @pytest.mark.parametrize(
        "hypotheses",
        [
            grid(theta=(-0.3, TWO_PI - 0.3, 10), omega=(-6.0, 6.0, 7)),
            ConstraintHypotheses([Box(theta=(6.0, 7.1)), Box(omega=(0.1, 0.3), theta=(1, 2))]),
        ],
    )
    def test_round_trip(self, hypotheses: HypothesisSet) -> None:
        text = json.dumps(hypotheses.to_json(), allow_nan=False)
        back = hypotheses_from_json(json.loads(text))
        assert type(back) is type(hypotheses)
        assert json.dumps(back.to_json()) == text
        assert [back.name(k) for k in range(len(back))] == [
            hypotheses.name(k) for k in range(len(hypotheses))
        ]
        states = walks(np.random.default_rng(0), num=50)
        np.testing.assert_array_equal(
            back.violations(states, PENDULUM, True), hypotheses.violations(states, PENDULUM, True)
        )

    def test_a_predicate_comes_back_without_its_code(self) -> None:
        hypotheses = ConstraintHypotheses([Predicate("fast", lambda s: s[..., 0] > 1)])
        back = hypotheses_from_json(json.loads(json.dumps(hypotheses.to_json())))
        assert back.needs_code
        assert back.name(0) == "fast"
        with pytest.raises(ValueError, match="load the problem that defines it"):
            back.violations(np.zeros((1, 2, 2)), PLANE, True)
