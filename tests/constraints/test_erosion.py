"""What a margin leaves of a constraint is what lies farther than the margin from all outside it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from swerve import ActionBox, Ball, Box, HalfSpace, Polygon, Predicate, StateAction, Union, grid
from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.base import Constraint
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.grid_axis import GridAxis
from swerve.hypotheses.windows import windows

SPACE = StateSpace(("theta", "x", "y"), ("theta",), np.array([[0.0, TWO_PI], [-4, 4], [-4, 4]]))
MARGIN = 0.3
ARROW = [(-2.0, -2.0), (2.5, 0.0), (-2.0, 2.0), (-0.5, 0.0)]
FAST = ActionBox(f=(0.5, 2.0))
BY_SIDES = {
    "box": Box(x=(-1.5, 1.0), y=(0.0, 2.0)),
    "wrapped": Box(theta=(5.5, 7.0), x=(-1.0, 2.0)),
    "below 0": Box(theta=(-4.0, -1.0)),
    "nearly round": Box(theta=(1.0, 1.0 + TWO_PI - 0.2), x=(-1.0, 2.0)),
    "round": Box(theta=(1.0, 1.0 + TWO_PI), x=(-1.0, 2.0)),
    "all": Box(theta=(-9.0, -9.0 + TWO_PI)),
    "open side": Box(x=(-math.inf, 1.0), y=(-1.0, math.inf)),
    "open": Box(x=(-math.inf, math.inf), theta=(0.0, 2.0)),
    "half-space": HalfSpace(0.5, x=1.0, y=-2.0),
    "one side": HalfSpace(-1.0, y=-2.0),
    "far apart": Union("two", [Box(theta=(5.5, 7.0)), Box(theta=(2.0, 4.0), y=(0.0, 3.0))]),
}
BY_DISTANCE = {
    "ball": Ball(1.4, x=0.5, y=-0.25),
    "ball of an angle": Ball(1.7, theta=6.0, x=0.0),
    "arc": Ball(3.0, theta=6.0),
    "round": Ball(3.2, theta=6.0),
    "polygon": Polygon(ARROW),
    "apart": Union("two", [Ball(1.0, x=-2.0, y=0.0), Polygon([(0, 0), (3, 0), (0, 3)])]),
}
CASES = [
    *(pytest.param(case, np.inf, id=f"{name} by sides") for name, case in BY_SIDES.items()),
    *(pytest.param(case, 2, id=f"{name} by distance") for name, case in BY_DISTANCE.items()),
]


def lattice(names: list[str]) -> tuple[np.ndarray, float]:
    """States all over those of some names, and the diagonal between neighbours."""
    axes = [
        np.arange(120) * (TWO_PI / 120) if name == "theta" else np.linspace(-5.0, 5.0, 201)
        for name in names
    ]
    states = np.zeros((math.prod(map(len, axes)), 3))
    columns = [SPACE.column(name) for name in names]
    states[:, columns] = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(names))
    return states, math.hypot(*(axis[1] - axis[0] for axis in axes))


@pytest.mark.parametrize(("constraint", "order"), CASES)
def test_is_inside_and_farther_than_the_margin_from_outside(
    constraint: Constraint, order: float
) -> None:
    """By brute force: noise moves every state by up to the margin, or a point in any direction."""
    names = list(constraint.spans)
    columns = [SPACE.column(name) for name in names]
    dense, rounding = lattice(names)
    outside = dense[~constraint.contains(dense, SPACE)]
    states = np.random.default_rng(0).uniform((-7.0, -4.0, -4.0), (7.0, 4.0, 4.0), (150, 3))
    nearest = np.array(
        [
            np.linalg.norm(SPACE.difference(outside, state)[:, columns], order, axis=1).min(
                initial=np.inf
            )
            for state in states
        ]
    )
    depth = np.where(constraint.contains(states, SPACE), nearest, 0.0)
    sure = np.abs(depth - MARGIN) > rounding
    found = constraint.eroded({"theta": MARGIN, "x": MARGIN, "y": MARGIN}, SPACE)
    np.testing.assert_array_equal(found.contains(states, SPACE)[sure], (depth > MARGIN)[sure])
    assert sure.mean() > 0.8
    lost = constraint.contains(states, SPACE) & ~found.contains(states, SPACE)
    assert lost.any() != (outside.size == 0)
    with_actions = StateAction(constraint, FAST).eroded({"x": MARGIN}, SPACE)
    assert repr(with_actions) == repr(StateAction(constraint.eroded({"x": MARGIN}, SPACE), FAST))


def test_parts_that_adjoin_are_less_the_margin_each() -> None:
    """Never more than is left of the whole, and a gap where they meet."""
    halves = Union("round", [Box(theta=(0.0, 3.0)), Box(theta=(3.0, TWO_PI))])
    left = halves.eroded({"theta": 0.1}, SPACE)
    states = np.zeros((3, 3))
    states[:, 0] = [1.0, 3.05, 3.2]
    np.testing.assert_array_equal(left.contains(states, SPACE), [True, False, True])


@pytest.mark.parametrize(
    "hypotheses",
    [
        grid(theta=(-1.0, -1.0 + TWO_PI, 1), x=(0.0, 4.0, 4)),
        windows(2, theta=(1.0, 1.0 + TWO_PI, TWO_PI), x=(0.0, 4.0, 2.0)),
    ],
    ids=["grid", "windows"],
)
def test_hypotheses_that_go_round_keep_going_round(hypotheses: HypothesisSet) -> None:
    left = hypotheses.eroded({"theta": 0.4, "x": 0.1}, SPACE)
    states = np.random.default_rng(1).uniform((-9.0, 0.0, 0.0), (9.0, 4.0, 1.0), (200, 3))
    for index in range(len(hypotheses)):
        before, after = hypotheses.constraint(index), left.constraint(index)
        low, high = before.spans["x"]
        expected = (states[:, 1] >= low + 0.1) & (states[:, 1] < high - 0.1)
        np.testing.assert_array_equal(after.contains(states, SPACE), expected)
        assert after.spans["theta"] == before.spans["theta"]


def test_an_interval_of_no_angle_has_sides_however_wide() -> None:
    left = Box(x=(-4.0, -4.0 + TWO_PI)).eroded({"x": 0.5}, SPACE)
    assert left.spans["x"] == pytest.approx((-3.5, TWO_PI - 4.5))
    assert GridAxis(SPACE, "x", 0.0, TWO_PI, 3, 1).period == 4


@pytest.mark.parametrize(
    ("margin", "message"),
    [
        (0.1, r"margin: expected widths by state, as in \{'x': 0\.05\}, got 0\.1"),
        ({"z": 0.1}, "margin: no state named 'z'; the states are theta, x, y"),
        ({1: 0.1}, "margin: no state named 1"),
        ({"x": -0.1}, "margin: expected a width >= 0 for 'x', in its unit, got -0.1"),
        ({"x": math.nan}, "margin: expected a width >= 0 for 'x', in its unit, got nan"),
        ({"x": math.inf}, "margin: expected a width >= 0 for 'x', in its unit, got inf"),
        ({"x": "0.1"}, "margin: expected a width >= 0 for 'x', in its unit, got '0.1'"),
        ({"x": None}, "margin: expected a width >= 0 for 'x', in its unit, got None"),
        ({"x": True}, "margin: expected a width >= 0 for 'x', in its unit, got True"),
        ({"x": [0.1, 0.2]}, r"margin: expected a width >= 0 for 'x', in its unit, got \[0\.1"),
        ({"x": 0.75}, r"margin: 0\.75 for 'x' leaves nothing of x \[0, 1\.5\): expected less"),
    ],
)
def test_bad_margins(margin: Any, message: str) -> None:
    for whole in (Box(x=(0.0, 1.5)), grid(x=(0.0, 3.0, 2))):
        with pytest.raises(ValueError, match=message):
            whole.eroded(margin, SPACE)


def test_what_has_no_shape() -> None:
    message = "p: a Predicate cannot be made smaller by a margin: use constraints with a shape"
    with pytest.raises(ValueError, match=message):
        Predicate("p", lambda states: states[..., 0] > 0).eroded({"x": 0.1}, SPACE)
