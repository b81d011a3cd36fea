"""Hypotheses that are the same set, or lie outside the bounds."""

from __future__ import annotations

import math
import re
import tracemalloc
from typing import Any

import numpy as np
import pytest
from support.synthetic import SPACE, make_evidence, make_record, make_samples

import swerve
from swerve import (
    ActionBox,
    Ball,
    Box,
    Constraint,
    HalfSpace,
    Predicate,
    StateAction,
    Union,
    infer,
)
from swerve.base.space import TWO_PI, StateSpace
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.hypotheses.windows import windows
from swerve.trust.hypothesis_doubts import hypothesis_warnings

INF = math.inf


def said(*constraints: Constraint) -> list[str]:
    return list(hypothesis_warnings(ConstraintHypotheses(constraints), SPACE))


def right(states):
    return states[..., 1] > 5.0


LEFT = Box(x=(0.0, 1.0))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Box(x=(1.0, 2.0)), Box(x=(1.0, 2.0))),
        (Box(x=(0.1 + 0.2, 2.0)), Box(x=(0.3, 2.0))),
        (Box(x=(1.0, 2.0), theta=(0.0, TWO_PI)), Box(x=(1.0, 2.0))),
        (Box(x=(1.0, 2.0), theta=(-INF, INF)), Box(x=(1.0, 2.0))),
        (Box(theta=(1.0, 2.0)), Box(theta=(1.0 + TWO_PI, 2.0 + TWO_PI))),
        (Box(theta=(-0.5, 0.5)), Box(theta=(TWO_PI - 0.5, TWO_PI + 0.5))),
        (Box(theta=(0.0, 1.0)), Box(theta=(TWO_PI, TWO_PI + 1.0))),
        (Box(x=(1.0, 2.0), theta=(1.0, 2.0)), Box(theta=(1.0, 2.0), x=(1.0, 2.0))),
        (Ball(0.5, x=1.0), Ball(0.5, x=1.0)),
        (HalfSpace(4.0, x=1.0), HalfSpace(4.0, x=1.0)),
        (Union("a", [LEFT, Ball(0.5, x=3.0)]), Union("b", [Ball(0.5, x=3.0), LEFT, LEFT])),
        (Union("a", [Box(x=(1.0, 2.0))]), Box(x=(1.0, 2.0))),
        (Predicate("a", right), Predicate("b", right)),
        (ActionBox(u=(0.0, 1.0)), ActionBox(u=(0.0, 1.0))),
        (StateAction(LEFT, ActionBox(u=(0, 1))), StateAction(LEFT, ActionBox(u=(0, 1)))),
    ],
)
def test_the_same_set_twice(first: Constraint, second: Constraint) -> None:
    [text] = said(first, Box(x=(7.0, 8.0)), second)
    assert text.startswith("hypotheses 0, 2 are the same set (")
    assert text.endswith(
        "each with a share of the prior: together they count 2 times. Keep one of them"
    )


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Box(x=(1.0, 2.0)), Box(x=(1.0, 2.0 + 1e-6))),
        (Box(x=(1.0, 2.0)), Box(theta=(1.0, 2.0))),
        (Box(theta=(1.0, 2.0)), Box(theta=(1.0 + math.pi, 2.0 + math.pi))),
        (Ball(0.5, x=1.0), Ball(0.6, x=1.0)),
        (Predicate("a", right), Predicate("a", lambda states: states[..., 1] > 5.0)),
        (Union("a", [LEFT, Ball(0.5, x=3.0)]), LEFT),
        (ActionBox(u=(0.0, 1.0)), ActionBox(u=(0.0, 2.0))),
    ],
)
def test_other_sets(first: Constraint, second: Constraint) -> None:
    assert said(first, second) == []


def test_many_of_the_same_are_told_once() -> None:
    [text] = said(*[Box(x=(1.0, 2.0))] * 6)
    assert text.startswith("hypotheses 0, 1, 2 and 3 more are the same set (x [1, 2)), each")
    assert "together they count 6 times" in text


@pytest.mark.parametrize(
    ("constraint", "place"),
    [
        (Box(x=(10.5, 12.0)), "from 10.5 to 12"),
        (Box(x=(-3.0, 0.0), theta=(0.0, 1.0)), "from -3 to 0"),
        (Ball(0.5, x=11.0, theta=1.0), "from 10.5 to 11.5"),
        (HalfSpace(10.5, x=1.0), "from 10.5 to inf"),
        (Union("two", [Box(x=(11.0, 12.0)), Box(x=(-9.0, -8.0))]), "from 11 to 12"),
    ],
)
def test_outside_the_bounds(constraint: Constraint, place: str) -> None:
    """The bounds of x are [0, 10]; theta is an angle."""
    [text] = said(LEFT, constraint)
    assert text.startswith(
        f"hypothesis 1: wholly outside the bounds of x, [0, 10] (hypothesis 1 has x {place})"
    )
    assert "it has a share of the prior: another unit? Leave out what cannot be, or widen" in text


@pytest.mark.parametrize(
    "constraint",
    [
        Box(x=(9.9, 12.0)),
        Box(x=(10.0, 12.0)),  # holds its low edge
        HalfSpace(10.0, x=1.0),
        HalfSpace(0.0, x=-1.0),
        StateAction(HalfSpace(0.0, x=-1.0), ActionBox(u=(0.0, 1.0))),
        Box(theta=(20.0, 21.0)),
        Ball(2.0, x=11.0),
        HalfSpace(9.0, x=1.0),
        Union("one", [Box(x=(11.0, 12.0)), Box(theta=(1.0, 2.0))]),
        Predicate("right", right),
        ActionBox(u=(50.0, 60.0)),
    ],
)
def test_not_outside_the_bounds(constraint: Constraint) -> None:
    assert said(LEFT, constraint) == []


def test_cells_and_windows_outside_the_bounds() -> None:
    cells = grid(theta=(0.0, TWO_PI, 2), x=(-10.0, 20.0, 6))
    [text] = hypothesis_warnings(cells, SPACE)
    assert text.startswith("hypotheses 0, 1, 5 and 3 more: wholly outside the bounds of x, [0, 10]")
    assert "(hypothesis 0 has x from -10 to -5)" in text
    assert "each has a share of the prior" in text
    [text] = hypothesis_warnings(windows(x=(0.0, 14.0, 2.0), overlap=1), SPACE)
    assert text.startswith("hypothesis 6: wholly outside the bounds of x")
    assert not list(hypothesis_warnings(grid(x=(-1.0, 11.0, 4)), SPACE))


def test_cells_within_the_bounds_take_no_memory() -> None:
    cells = grid(theta=(0.0, TWO_PI, 500), x=(0.0, 10.0, 500))
    tracemalloc.start()
    assert not list(hypothesis_warnings(cells, SPACE))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(cells)  # not even a byte for each


@pytest.mark.parametrize("name", ["pendulum", "car", "double-pendulum", "gridworld"])
def test_shipped_problems_have_no_odd_hypotheses(name: str) -> None:
    problem = swerve.load_problem(name)
    assert not list(hypothesis_warnings(problem.hypotheses, problem.mdp.space))


def test_infer_tells_them_with_and_without_demonstrations() -> None:
    cells = ConstraintHypotheses([LEFT, LEFT, Box(x=(30.0, 31.0))])
    warnings = infer(make_evidence(make_record(hypotheses=cells))).warnings
    assert any("hypotheses 0, 1 are the same set" in text for text in warnings)
    assert any("hypothesis 2: wholly outside the bounds of x" in text for text in warnings)
    assert not np.any(["the same set" in text for text in infer(make_evidence()).warnings])


UTM = StateSpace(("x", "y"), (), np.array([[691_600.0, 691_620.0], [5_334_700.0, 5_334_720.0]]))


@pytest.mark.parametrize(
    ("hypotheses", "index"),
    [
        (grid(y=(5_334_700.0, 5_334_720.0, 50), x=(691_600.0, 691_620.0, 10)), 0),
        (grid(y=(5e5, 5_334_720.0, 806_450), x=(691_600.0, 691_620.0, 2)), 1_232_448),
        (windows(2, y=(5_334_700.0, 5_334_720.0, 0.4)), 0),
        ([Box(x=(691_600.0, INF)), Ball(0.2, x=691_605.0, y=5_334_705.0)], 1),
        ([Union("two", [Box(x=(0.0, 9.0)), Box(y=(5_334_701.0, 5_334_701.5))])], 0),
    ],
    ids=["grid", "far away", "windows", "ball", "union"],
)
def test_a_region_that_is_narrow_for_single_precision_is_told(hypotheses: Any, index: int) -> None:
    """Half a metre lies between two numbers of float32 at 5,334,700."""
    if isinstance(hypotheses, list):
        hypotheses = ConstraintHypotheses(hypotheses)
    (*_, text) = [text for text in hypothesis_warnings(hypotheses, UTM) if "precision" in text]
    assert re.match(rf"hypothesis {index} is \S+ wide in y, at \d{{7}}(\.\d+)?: states are", text)
    assert re.search(r"0\.5 apart there\. Count y from an origin nearby, such as \d{7}", text)


def test_a_region_that_is_wide_enough_or_an_angle_is_not() -> None:
    wide = ConstraintHypotheses([Box(y=(5_334_700.0, 5_334_710.0)), Box(y=(-INF, 5_334_704.0))])
    assert not list(hypothesis_warnings(wide, UTM))
    far = StateSpace(("x",), (), np.array([[-1e9, 1e9]]))  # bounds that say nothing
    assert not list(hypothesis_warnings(grid(x=(-1.0, 1.0, 10)), far))
    assert not said(Box(x=(1.0, 1.0 + 1e-4)), Box(theta=(1.0, 1.0 + 1e-9)))


def test_what_is_known_already_is_told_whatever_its_name() -> None:
    half = HalfSpace(2.0, x=2.0)  # the states of x >= 1
    known = (Box(x=(1.0, INF)), Ball(0.5, x=2.0))
    hypotheses = ConstraintHypotheses([LEFT, half, Ball(0.5, x=2.1)])
    record = make_record(hypotheses=hypotheses, known=known)
    samples = make_samples(num_hypotheses=3)
    texts = infer(make_evidence(record, samples)).warnings
    (text,) = [text for text in texts if "known" in text]
    assert text.startswith("hypothesis 1 is known already (x [1, inf)): nobody enters it")
