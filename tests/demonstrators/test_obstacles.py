"""Obstacles hold the points of their constraint, and paths that avoid them are separated."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve import ActionBox, Ball, Box, HalfSpace, Polygon, StateAction, Union
from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import Constraint
from swerve.constraints.polygon_geometry import encloses, triangles
from swerve.constraints.predicate import Predicate
from swerve.demonstrators.obstacles import UNUSED, Obstacle, Path, obstacles_of

SPACE = StateSpace(("theta", "x", "y"), ("theta",), np.array([[0.0, TWO_PI], [-4, 4], [-4, 4]]))
UNIT = np.array([TWO_PI, 8.0, 8.0, 2.0])
ARROW = [(0.0, 0.0), (3.0, 1.0), (0.0, 2.0), (1.0, 1.0)]
COMB = [(0, 0), (4, 0), (4, 3), (3, 3), (3, 1), (2, 1), (2, 3), (1, 3), (1, 1), (0, 1)]
ALL: list[Constraint] = [
    Box(theta=(5.5, 7.0), x=(-1.0, 2.0)),
    Box(theta=(1.0, 1.0 + TWO_PI), y=(0.0, 1.5)),
    Box(x=(0.5, np.inf)),
    Ball(1.3, x=0.5, y=-0.25),
    Ball(1.7, theta=5.9, x=1.0),
    HalfSpace(1.0, x=1.0, y=-2.0),
    Polygon(ARROW),
    Polygon(ARROW[::-1], names=("y", "x")),
    Polygon(COMB),
    ActionBox(push=(0.2, 0.7)),
    StateAction(Box(theta=(5.5, 7.0), x=(-1.0, 2.0)), ActionBox(push=(-0.5, 0.5))),
    Union("both", [Box(x=(0.0, 1.0)), Ball(1.0, y=2.0)]),
]
seeds = st.integers(0, 2**32 - 1)


def holds(obstacle: Obstacle, points: np.ndarray) -> np.ndarray:
    beyond = points[:, list(obstacle.columns)] @ obstacle.normal.T - obstacle.offset
    if obstacle.radius > 0.0:
        return np.asarray(np.linalg.norm(beyond, axis=1) < obstacle.radius)
    return np.asarray((beyond < 0.0).all(axis=1))


def obstacles(constraint: Constraint) -> list[Obstacle]:
    return obstacles_of(constraint, SPACE, ("push",), UNIT)


@pytest.mark.parametrize("constraint", ALL, ids=lambda c: c.name)
@given(seed=seeds)
def test_they_hold_what_the_constraint_holds(constraint: Constraint, seed: int) -> None:
    generator = np.random.default_rng(seed)
    states = generator.uniform([-15.0, -4.0, -4.0], [15.0, 4.0, 4.0], (200, 3))
    actions = generator.uniform(-1.0, 1.0, (200, 1))

    def held(states: np.ndarray) -> np.ndarray:
        taken = Actions(("push",), actions)
        return constraint.contains(states, SPACE) | constraint.forbids_in(states, taken, SPACE)

    expected = held(states)
    moves = 1e-4 * np.concatenate([np.eye(3), -np.eye(3)])
    clear = np.all([held(states + move) == expected for move in moves], axis=0)
    assert clear.sum() > 190  # away from the edges, where the resolution counts
    low, high = np.full(3, -15.0), np.full(3, 15.0)
    points = np.concatenate([states, actions], axis=1)
    found = [image for obstacle in obstacles(constraint) for image in obstacle.images(low, high)]
    by_planner = np.any([holds(one, points) for one in found], axis=0)
    np.testing.assert_array_equal(by_planner[clear], expected[clear])


@pytest.mark.parametrize("constraint", ALL, ids=lambda c: c.name)
@given(seed=seeds)
def test_weights_of_a_path_far_off_separate_it(constraint: Constraint, seed: int) -> None:
    """l^T (A z - b) >= 0 at both ends of a step, |l| <= 1 and l^T (z - c) >= r for balls."""
    generator = np.random.default_rng(seed)
    states = generator.uniform(-4.0, 4.0, (60, 3))
    path = Path(states, generator.uniform(-1.0, 1.0, (59, 1)))
    for obstacle in obstacles(constraint):
        beyond = path.steps[..., list(obstacle.columns)] @ obstacle.normal.T - obstacle.offset
        weights = obstacle.weights(path)
        along = np.einsum("tf,tef->te", weights, beyond).min(axis=1)
        if obstacle.radius > 0.0:
            assert np.linalg.norm(weights, axis=1).max() < 1.0 + 1e-12
            inside = np.linalg.norm(beyond, axis=2).min(axis=1) < obstacle.radius
            assert (along[inside] < obstacle.radius).all()
            continue
        assert weights.min() >= 0.0
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        inside = np.any((beyond < 0.0).all(axis=2), axis=1)
        assert (along[inside] < 0.0).all()
        best = beyond.min(axis=1).max(axis=1)
        surely = best > UNUSED * np.abs(beyond).sum(axis=2).max(axis=1)  # the others take no more
        assert surely.any()
        assert (along[surely] > 0.0).all()


@pytest.mark.parametrize("constraint", ALL, ids=lambda c: c.name)
def test_what_is_pushed_out_is_out(constraint: Constraint) -> None:
    """Both ends of an entering step move beyond the same side; other states stay."""
    generator = np.random.default_rng(0)
    path = Path(generator.uniform(-4.0, 4.0, (200, 3)), generator.uniform(-1.0, 1.0, (199, 1)))
    share = np.linspace(0.0, 1.0, 1001)[:, None]
    for obstacle in obstacles(constraint):
        before = np.concatenate([path.states, [*path.actions, path.actions[-1]]], axis=1)
        num = len(share) if obstacle.on_segments else 1
        inside = np.array(
            [
                holds(obstacle, begin + share[:num] * (end - begin) * [1, 1, 1, 0]).any()
                for begin, end in itertools.pairwise(before)
            ]
        )
        touched = np.append(inside, False)
        touched[1:] |= inside & obstacle.on_segments
        pushed = list(obstacle.pushed(path))
        assert bool(pushed) == bool(inside.any())
        for moved in pushed:
            after = np.concatenate([moved.states, [*moved.actions, moved.actions[-1]]], axis=1)
            np.testing.assert_array_equal(after[~touched][:-1], before[~touched][:-1])
            both = np.stack([after[:-1], after[1:]], axis=1)[inside, : 1 + obstacle.on_segments]
            beyond = both[..., list(obstacle.columns)] @ obstacle.normal.T - obstacle.offset
            if obstacle.radius > 0.0:
                beyond = np.concatenate([beyond, -beyond], axis=2) - obstacle.radius
            assert (beyond.min(axis=1).max(axis=1) > 0.0).all()


def test_a_step_through_a_thin_wall_is_led_around() -> None:
    wall = obstacles(Box(x=(-0.01, 0.01), y=(-9.0, 1.0)))[0]
    states = np.stack([np.zeros(5), np.linspace(-1.0, 1.0, 5) + 0.25, np.zeros(5)], axis=1)
    pushed = list(wall.pushed(Path(states, np.zeros((4, 1)))))
    assert len(pushed) == 4
    above = [moved for moved in pushed if moved.states[:, 2].max() > 1.0]
    np.testing.assert_allclose(above[0].states[:, 2], [0.0, 1.1, 1.1, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    "corners", [ARROW, ARROW[::-1], COMB, [(0, 0), (2, 0), (2, 2), (1, 2), (0, 2)]]
)
def test_triangles_make_up_a_polygon(corners: list[tuple[float, float]]) -> None:
    vertices = np.array(corners, float)
    parts = triangles(vertices)
    points = np.random.default_rng(0).uniform(-0.5, 4.5, (5000, 2))
    count = np.sum([encloses(part, *points.T) for part in parts], axis=0)
    np.testing.assert_array_equal(count, encloses(vertices, *points.T).astype(int))


def test_what_has_no_sides_is_refused() -> None:
    with pytest.raises(ValueError, match=r"disc: expected a constraint with sides.*got Predicate"):
        obstacles(Predicate("disc", lambda states: states[..., 0] > 0.0))
    round_one = StateAction(Ball(1.0, x=0.0), ActionBox(push=(0.0, 1.0)))
    with pytest.raises(ValueError, match="straight sides"):
        obstacles(round_one)
