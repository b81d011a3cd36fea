"""Sets that are the same, whatever their names and however they are written."""

from __future__ import annotations

import math
from typing import Any

from support.synthetic import SPACE

from swerve import (
    ActionBox,
    Ball,
    Box,
    HalfSpace,
    Occupancy,
    Polygon,
    Predicate,
    StateAction,
    Union,
    grid,
)
from swerve.base.space import TWO_PI
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.same import same_as


def test_each_has_the_first_that_is_the_same() -> None:
    hypotheses = ConstraintHypotheses(
        [
            Box(theta=(0.5, 1.0), x=(1.0, 2.0)),
            Ball(0.5, x=1.0),
            Box(theta=(0.5 + TWO_PI, 1.0 + TWO_PI), x=(1.0, 2.0)),
            Box(theta=(0.5, 1.0), x=(1.0, 2.0 + 1e-6)),
            Union("left", [Box(x=(1.0, 2.0)), Box(x=(4.0, 5.0))]),
            Union("right", [Box(x=(4.0, 5.0)), Box(theta=(0.0, TWO_PI), x=(1.0, 2.0))]),
            Ball(0.5 * (1.0 + 1e-12), x=1.0),
        ]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 1, 0, 3, 4, 4, 1]


def test_numbers_may_be_scaled_and_corners_turned() -> None:
    corners = [(0.0, 0.0), (2.0, 0.0), (1.0, 1.5)]
    hypotheses = ConstraintHypotheses(
        [
            HalfSpace(1.0, x=1.0),
            HalfSpace(-3.0, x=-3.0),
            HalfSpace(2.0, x=2.0),
            Box(x=(1.0, math.inf)),
            HalfSpace(1.0, x=0.5, theta=-1.0),
            HalfSpace(3.0, theta=-3.0, x=1.5),
            HalfSpace(-1.0, x=-0.5, theta=1.0),
            Polygon(corners, ("x", "theta")),
            Polygon([corners[1], corners[2], corners[0]], ("x", "theta")),
            Polygon(corners[::-1], ("x", "theta")),
            Polygon([*corners[:2], (1.0, 1.0)], ("x", "theta")),
        ]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 1, 0, 0, 4, 4, 6, 7, 7, 7, 10]


def on_the_left(states: Any) -> Any:
    return states[..., 1] < 3.0


def on_the_right(states: Any) -> Any:
    return states[..., 1] > 7.0


class Circle(Ball):
    """A shape of the user's own, which a file holds in part."""

    needs_code = True


def test_sets_of_functions_that_differ_are_not_the_same() -> None:
    """Though their names are, and so all that a file holds of them."""
    push = ActionBox(u=(0.5, 2.0))
    left, right = Predicate("zone", on_the_left), Predicate("zone", on_the_right)
    corner = Box(x=(0.0, 1.0))
    hypotheses = ConstraintHypotheses(
        [
            StateAction(left, push),
            StateAction(right, push),
            StateAction(Predicate("left", on_the_left), push),
            StateAction(left, ActionBox(u=(0.5, 3.0))),
            StateAction(Union("two", [left, corner]), push),
            StateAction(Union("both", [corner, left]), push),
            StateAction(Union("two", [right, corner]), push),
            left,
            right,
            Circle(0.5, x=1.0),
            Circle(0.5, x=1.0),
        ]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 1, 0, 3, 4, 4, 6, 7, 8, 9, 10]


def test_states_of_an_action_are_the_same_however_written() -> None:
    push = ActionBox(u=(0.5, 2.0))
    hypotheses = ConstraintHypotheses(
        [StateAction(Box(theta=(low, low + 1.0)), push) for low in (0.5, 0.5 + TWO_PI)]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 0]


def test_maps_are_the_same_whatever_their_names() -> None:
    walls = [[True, False], [False, False]]
    other = [[False, True], [False, False]]
    hypotheses = ConstraintHypotheses(
        [
            Occupancy(name, blocked, (0.0, 0.0), 5.0, ("x", "y"))
            for name, blocked in (("walls", walls), ("room", walls), ("walls", other))
        ]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 0, 2]


def test_cells_of_a_grid_all_differ() -> None:
    assert same_as(grid(x=(0.0, 10.0, 3)), SPACE).tolist() == [0, 1, 2]
