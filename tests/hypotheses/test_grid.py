"""Grids of cells: agreement with lists of boxes, cells of states, checks."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cells import (
    PENDULUM,
    PLANE,
    angle_ranges,
    as_list,
    both_settings,
    entered,
    fewer,
    walks,
)

from swerve.base.space import TWO_PI, StateSpace
from swerve.hypotheses.grid import grid

ARM = StateSpace(("a", "rate", "b"), ("a", "b"), np.array([[0.0, 7.0], [-2.0, 2.0], [0.0, 7.0]]))
seeds = st.integers(0, 2**32 - 1)


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
