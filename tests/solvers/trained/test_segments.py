"""The way between two states enters a constraint of any kind where dense points of it do."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swerve import ActionBox, Ball, Box, HalfSpace, Polygon, Predicate, StateAction, Union
from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import Constraint, violates
from swerve.constraints.occupancy import Occupancy

SPACE = StateSpace(("theta", "x", "y"), ("theta",), np.array([[0.0, TWO_PI], [-4, 4], [-4, 4]]))
NUM = 480  # points of a segment; a multiple of what a predicate tries
CELL = 0.5


def box(generator: np.random.Generator) -> Box:
    """A box whose angle interval may wrap or go all the way round."""
    low, width = generator.uniform(-8.0, 8.0), generator.choice([0.5, 3.0, 6.0, TWO_PI])
    x = np.sort(generator.uniform(-3.0, 3.0, 2))
    return Box(theta=(low, low + width), x=(float(x[0]), float(x[1])))


def ball(generator: np.random.Generator) -> Ball:
    """A ball over an angle and a position."""
    theta, y = generator.uniform((-8.0, -3.0), (8.0, 3.0))
    return Ball(generator.uniform(0.3, 2.5), theta=theta, y=y)


def half_space(generator: np.random.Generator) -> HalfSpace:
    """A half-space over both positions."""
    x, y = generator.normal(size=2)
    return HalfSpace(generator.uniform(-2.0, 2.0), x=x, y=y)


def polygon(generator: np.random.Generator, depth: float = 0.0) -> Polygon:
    """A star of few or many vertices."""
    num = int(generator.choice([3, 8, 70]))
    angle = (np.arange(num) + generator.uniform(0.0, 0.7, num)) * TWO_PI / num
    radius = generator.uniform(1.0, 3.5, num)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return Polygon(vertices, depth=depth)


def union(generator: np.random.Generator) -> Union:
    """One of each."""
    return Union("any", [kind(generator) for kind in (box, ball, polygon)])


def segments(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts and ends [S, 3] near and far, and points of the ways between them [P, S, 3]."""
    starts = generator.uniform((-9.0, -4.0, -4.0), (9.0, 4.0, 4.0), (60, 3))
    ends = starts + generator.normal(size=(60, 3)) * generator.choice([0.1, 1.0, 3.0], (60, 1))
    share = np.linspace(0.0, 1.0, NUM + 1)[:, None, None]
    return starts, ends, starts + share * SPACE.difference(starts, ends)


@pytest.mark.parametrize("kind", [box, ball, half_space, polygon, union])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_dense_points_agree(kind: Callable[[np.random.Generator], Constraint], seed: int) -> None:
    """What a point enters is entered; what is entered without one lies within half a spacing."""
    generator = np.random.default_rng(seed)
    constraint = kind(generator)
    starts, ends, points = segments(generator)
    dense = constraint.contains(points, SPACE).any(axis=0)
    found = constraint.crosses(starts, ends, SPACE)
    np.testing.assert_array_equal(found | dense, found)
    spacing = np.linalg.norm(SPACE.difference(starts, ends), axis=-1) / NUM
    away = constraint.distance(points, SPACE).min(axis=0)
    assert (away <= 0.5 * spacing + 1e-9)[found].all()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_what_is_deep_in_a_polygon(seed: int) -> None:
    """Entered without a point of it there: its depth and half a spacing less must have one."""
    generator = np.random.default_rng(seed)
    whole = polygon(generator)
    starts, ends, points = segments(generator)
    spacing = np.linalg.norm(SPACE.difference(starts, ends), axis=-1).max() / NUM
    deep, nearly = (Polygon(whole.vertices, depth=depth) for depth in (0.2, 0.2 - spacing))
    dense = deep.contains(points, SPACE).any(axis=0)
    found = deep.crosses(starts, ends, SPACE)
    np.testing.assert_array_equal(found | dense, found)
    assert nearly.contains(points, SPACE).any(axis=0)[found].all()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_an_action_counts_where_it_begins(seed: int) -> None:
    """However the way goes on, for a state-action constraint the first point alone tells."""
    generator = np.random.default_rng(seed)
    constraint = StateAction(union(generator), ActionBox(f=(0.0, 1.0)))
    starts, ends, points = segments(generator)
    values = generator.uniform(-1.0, 1.0, (60, 1, 1))
    expected = constraint.states.contains(points[0], SPACE) & (values[:, 0, 0] >= 0.0)
    found = violates(
        constraint, np.stack([starts, ends], axis=1), SPACE, True, Actions(("f",), values)
    )
    np.testing.assert_array_equal(found, expected)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_predicate_tries_some_of_the_points(seed: int) -> None:
    """It enters what one of its own points does, which all are among the dense ones."""
    generator = np.random.default_rng(seed)
    same, starts_ends_points = union(generator), segments(generator)
    starts, ends, points = starts_ends_points
    predicate = Predicate("same", lambda states: same.contains(states, SPACE), 8)
    tried = same.contains(points[:: NUM // 8], SPACE).any(axis=0)
    np.testing.assert_array_equal(predicate.crosses(starts, ends, SPACE), tried)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_map_misses_tips_of_corners_alone(seed: int) -> None:
    """Between two points that are tried, half a cell apart along an axis, at most."""
    generator = np.random.default_rng(seed)
    blocked = generator.uniform(size=(16, 16)) < 0.3
    walls = Occupancy("walls", blocked, (-4.0, -4.0), CELL)
    starts, ends, points = segments(generator)
    inside = walls.contains(points, SPACE)
    found = walls.crosses(starts, ends, SPACE)
    spacing = np.hypot(*np.moveaxis(ends - starts, -1, 0)[1:]) / NUM
    for k in np.flatnonzero(~found):
        free = np.flatnonzero(~np.r_[False, inside[:, k], False])
        assert (np.diff(free).max() - 2) * spacing[k] <= 0.5 * CELL * math.sqrt(2.0)
    assert found.any()
    assert inside[:, found].any(axis=0).mean() > 0.9
