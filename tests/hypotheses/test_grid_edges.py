"""Edges of grids: lines, gaps, corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exact_boxes import meets_exactly

from swerve import grid
from swerve.base.space import TWO_PI, StateSpace
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)


def entered(cells, states, space, between_states=True):
    return unpack(cells.violations(states, space, between_states), len(cells))


def test_a_segment_from_gap_to_gap_enters_the_cells_between() -> None:
    cells = grid(theta=(0.3, 2.0, 5))
    states = np.array(
        [[[-0.2, 0.0], [2.3, 0.0]], [[2.3, 0.0], [6.1, 0.0]], [[3.0, 0.0], [4.0, 0.0]]]
    )
    np.testing.assert_array_equal(entered(cells, states, PENDULUM).sum(axis=1), [5, 5, 0])


@settings(max_examples=25)
@given(seed=seeds)
def test_grid_agrees_with_boxes_on_a_small_range_of_an_angle(seed) -> None:
    generator = np.random.default_rng(seed)
    cells = grid(theta=(6.0, 7.5, 4), omega=(-4.0, 4.5, 7))
    boxes = ConstraintHypotheses([cells.constraint(k) for k in range(len(cells))])
    states = generator.uniform([-9.0, -5.0], [9.0, 5.0], (25, 6, 2))
    np.testing.assert_array_equal(
        cells.violations(states, PENDULUM, True), boxes.violations(states, PENDULUM, True)
    )


@settings(max_examples=50)
@given(seed=seeds, backwards=st.booleans())
def test_a_segment_that_ends_on_a_line_enters_all_cells_up_to_it(seed, backwards) -> None:
    """Whatever the rounding of its length."""
    generator = np.random.default_rng(seed)
    cells = grid(omega=(-6.0, 6.0, 10))
    starts, index = generator.uniform(-6.0, 6.0, 500), generator.integers(0, 10, 500)
    ends = -6.0 + 1.2 * index
    omega = np.stack([ends, starts] if backwards else [starts, ends], axis=1)
    hits = entered(cells, np.stack([0 * omega, omega], axis=-1), PENDULUM)
    first = np.floor((starts + 6.0) / 1.2).astype(int)
    np.testing.assert_array_equal(hits.sum(axis=1), 1 + np.abs(index - first))


def test_a_segment_that_ends_on_a_line_example() -> None:
    """A speed that comes to -6 + 9 * 1.2: cell 8 was missing."""
    states = np.array([[[1.25, -3.6020715567945087], [1.25, -6.0 + 9 * 1.2]]])
    hits = entered(grid(omega=(-6.0, 6.0, 10)), states, PENDULUM)[0]
    np.testing.assert_array_equal(np.flatnonzero(hits), np.arange(1, 10))


@settings(max_examples=30)
@given(seed=seeds)
def test_grid_agrees_with_exact_arithmetic(seed) -> None:
    """On quarters, where segments run through corners: a corner that is touched is not entered."""
    cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
    states = np.random.default_rng(seed).integers(-16, 17, (20, 2, 2)) / 4
    boxes = [list(cells.constraint(k).intervals.values()) for k in range(48)]
    expected = [[meets_exactly(a, b, box) for box in boxes] for a, b in states]
    np.testing.assert_array_equal(entered(cells, states, PLANE), expected)


def test_both_diagonals_are_alike() -> None:
    cells = grid(x=(0.0, 2.0, 2), y=(0.0, 2.0, 2))
    down, up = np.array([[[0.5, 1.5], [1.5, 0.5]], [[0.5, 0.5], [1.5, 1.5]]])
    hits = entered(cells, np.stack([down, up]), PLANE)
    assert [set(np.flatnonzero(row)) for row in hits] == [{1, 2}, {0, 3}]


@pytest.mark.parametrize("cells", [math.nan, math.inf])
def test_a_number_of_cells_that_is_not_finite_is_refused(cells: float) -> None:
    with pytest.raises(ValueError, match="grid: expected a whole number of cells for 'x'"):
        GridHypotheses({"x": (0.0, 1.0, cells)})  # pyright: ignore[reportArgumentType]
