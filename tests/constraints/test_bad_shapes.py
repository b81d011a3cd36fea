"""What is given in the wrong type or shape is refused by name, with what was expected instead."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from support.synthetic import SPACE

import swerve
from swerve import ActionBox, Ball, Box, HalfSpace, Polygon, StateAction, Union
from swerve.constraints.base import check_constraints
from swerve.constraints.occupancy import Occupancy
from swerve.hypotheses.base import ConstraintHypotheses

SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
FREE = np.zeros((2, 3), bool)
loose: Any = swerve
any_occupancy: Any = Occupancy


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: loose.Ball(None, x=0.0), "Ball: expected a finite radius > 0, got None: give it"),
        (lambda: loose.Ball("1", x=0.0), "Ball: expected a finite radius > 0, got '1'"),
        (
            lambda: loose.Ball([1.0, 2.0], x=0.0),
            "Ball: expected a finite radius > 0, got [1.0, 2.0]",
        ),
        (lambda: loose.Ball(-1.0, x=0.0), "Ball: expected a finite radius > 0, got -1.0"),
        (lambda: loose.Ball(math.nan, x=0.0), "Ball: expected a finite radius > 0, got nan"),
        (lambda: loose.Ball(1.0, x="0"), "Ball: expected a finite number for 'x', got '0'"),
        (lambda: loose.Ball(1.0, x=None), "Ball: expected a finite number for 'x', got None"),
        (lambda: loose.Ball(1.0, x=[1, 2]), "Ball: expected a finite number for 'x', got [1, 2]"),
        (
            lambda: loose.HalfSpace("1", x=1.0),
            "HalfSpace: expected a finite offset, got '1': give it",
        ),
        (lambda: loose.HalfSpace(None, x=1.0), "HalfSpace: expected a finite offset, got None"),
        (
            lambda: loose.HalfSpace(1.0, x="a"),
            "HalfSpace: expected a finite number for 'x', got 'a'",
        ),
        (
            lambda: loose.HalfSpace(1.0, x=0.0),
            "not zero, got {'x': 0.0}, which restricts no state",
        ),
        (lambda: loose.Polygon(None), "Polygon: expected at least 3 vertices, each a pair of num"),
        (
            lambda: loose.Polygon("abc"),
            "each a pair of numbers, but vertex 0 is 'a': give them as in",
        ),
        (
            lambda: loose.Polygon([(0, 0), (1, 0), (1, 1, 1)]),
            "but vertex 2 is (1, 1, 1): give them",
        ),
        (lambda: loose.Polygon([(0, 0), (1, 0), 3]), "but vertex 2 is 3: give them"),
        (lambda: loose.Polygon([(0, 0), ("1", 0), (1, 1)]), "but vertex 1 is ('1', 0): give them"),
        (
            lambda: loose.Polygon([(0, 0), (1, None), (1, 1)]),
            "but vertex 1 is (1, None): give them",
        ),
        (lambda: loose.Polygon({1, 2}), "but got {1, 2}: give them"),
        (
            lambda: loose.Polygon([]),
            "at least 3 vertices, each a pair of numbers, got an array of shape",
        ),
        (
            lambda: loose.Polygon(SQUARE, depth="1"),
            "Polygon: expected a finite depth >= 0, got '1'",
        ),
        (
            lambda: loose.Polygon(SQUARE, names=5),
            "Polygon: names: expected the names of two states",
        ),
        (lambda: loose.Polygon(SQUARE, names=("x", 1)), "names of two states, got ('x', 1): give"),
        (
            lambda: loose.Polygon(SQUARE, names=(["x"], "y")),
            "expected the names of two states, got",
        ),
        (lambda: loose.Box(x="ab"), "Box: expected x=(low, high), got 'ab'"),
        (lambda: loose.Box(x=5), "Box: expected x=(low, high), got 5"),
        (lambda: loose.Box(x=("a", 1.0)), "Box: expected low < high for 'x', got ('a', 1.0)"),
        (lambda: loose.Box(x=((0, 1), 2)), "Box: expected low < high for 'x', got ((0, 1), 2)"),
        (
            lambda: loose.ActionBox(f=(None, 1.0)),
            "ActionBox: expected low < high for 'f', got (None, 1.",
        ),
        (lambda: loose.windows(x=5), "windows: expected x=(low, high, width), got 5"),
        (lambda: loose.windows(x="abc"), "windows: expected x=(low, high, width), got 'abc'"),
        (lambda: loose.windows(x=("a", 1.0, 0.5)), "expected finite low < high for 'x', got ('a'"),
        (lambda: loose.windows(x=(0.0, 1.0, "a")), "at most 1, the range of 'x', got 'a'"),
        (lambda: loose.windows(x=(0.0, 1.0, math.nan)), "at most 1, the range of 'x', got nan"),
        (lambda: loose.windows(x=(0.0, 1.0, -0.5)), "at most 1, the range of 'x', got -0.5"),
        (lambda: loose.grid(x=None), "grid: expected x=(low, high, number of cells), got None"),
        (
            lambda: loose.grid(x=(0.0, 1.0, "a")),
            "expected a whole number of cells for 'x', got 'a'",
        ),
        (lambda: loose.Union("a", None), "Union 'a': expected constraints, got None: give a list"),
        (lambda: loose.Union("a", Box(x=(0, 1))), "Union 'a': expected constraints, got Box(x="),
        (lambda: loose.Union([Box(x=(0, 1))], "a"), "Union: expected a name first, got [Box(x="),
        (lambda: loose.Predicate(3, abs), "Predicate: expected a name first, got 3"),
        (lambda: loose.Predicate("p", 3), "Predicate 'p': expected a function of states, got 3"),
        (lambda: loose.Predicate("p", abs, 2.5), "Predicate 'p': num_points: expected a"),
        (
            lambda: loose.StateAction(loose.HalfSpace, ActionBox(f=(0, 1))),
            "expected a constraint on states",
        ),
        (lambda: any_occupancy("m", [[True], [True, False]], (0, 0), 1.0), "a map [rows, columns]"),
        (lambda: any_occupancy("m", FREE, "ab", 1.0), "'m': expected a corner (x, y), got 'ab'"),
        (lambda: any_occupancy("m", FREE, (0, "a"), 1.0), "'m': expected a corner (x, y), got (0,"),
        (lambda: any_occupancy("m", FREE, (0, 0), 1.0, "xy"), "Occupancy 'm': names: expected the"),
        (lambda: Occupancy("m", FREE, (0, 0), 1.0).widened(0.0), "'m': distance to widen by"),
        (lambda: ConstraintHypotheses(loose.Ball(1.0, x=0.0)), "hypotheses: expected a list of c"),
        (
            lambda: ConstraintHypotheses(loose.Union),
            "hypotheses: expected a list of constraints, or",
        ),
    ],
)
def test_is_refused(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


@pytest.mark.parametrize(
    "constraint",
    [
        Ball(1.0, z=0.0),
        HalfSpace(1.0, z=1.0),
        Polygon(SQUARE, names=("x", "z")),
        Box(z=(0, 1)),
        StateAction(Box(z=(0, 1)), ActionBox(u=(0, 1))),
        Union("a", [Box(x=(0, 1)), Ball(1.0, z=0.0)]),
    ],
    ids=lambda constraint: type(constraint).__name__,
)
def test_an_unknown_state_is_named_with_its_place(constraint: Any) -> None:
    message = r"known\[1\]: no state named 'z'; the states are theta, x"
    with pytest.raises(ValueError, match=message):
        check_constraints([Box(x=(0, 1)), constraint], SPACE, ("u",), "known")


def test_a_list_is_expected() -> None:
    with pytest.raises(ValueError, match="known: expected a list of constraints, got None"):
        check_constraints(None, SPACE, ("u",), "known")


def test_a_factor_of_zero_leaves_its_state_free() -> None:
    """As comes about when a normal is worked out; that of an angle too says nothing of it."""
    half = HalfSpace(1.0, x=2.0, theta=0.0)
    half.check(SPACE, ())
    assert repr(half) == "HalfSpace(1.0, x=2.0)"
    assert half.spans == {"x": (0.5, math.inf)}
    assert half.contains(np.array([[3.0, 0.4], [3.0, 0.6]]), SPACE).tolist() == [False, True]


def test_numbers_of_other_kinds_are_taken() -> None:
    assert loose.Ball(np.float32(0.5), x=np.int64(1)).spans == {"x": (0.5, 1.5)}
    assert loose.Box(x=np.array([0, 1])).intervals == {"x": (0.0, 1.0)}
    assert len(Polygon(np.array(SQUARE, int)).vertices) == 4
    assert loose.windows(2, x=np.array([0.0, 4.0, 2.0])).shape == (3,)
