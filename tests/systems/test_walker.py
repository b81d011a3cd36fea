"""People who walk, and maps of where they cannot: distances walked, blocked cells, segments."""

from __future__ import annotations

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import swerve
from swerve.base.space import StateSpace
from swerve.constraints.occupancy import Occupancy
from swerve.constraints.stored import constraint_from_json
from swerve.problem.problem import Problem
from swerve.systems.walker import Walker

SPACE = StateSpace(("x", "y"), (), np.array([[0.0, 4.0], [0.0, 3.0]]))
MAP = np.array([[0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], bool)  # the first row is the lowest


def walls() -> Occupancy:
    """Return a map of 4 x 3 cells of 1 m with its corner at (0, 0)."""
    return Occupancy("walls", MAP, (0.0, 0.0), 1.0)


def test_a_walker_earns_minus_the_distance_walked() -> None:
    walker = Walker(spacing=0.5, reach=0.3)
    steps = np.asarray(walker.actions)
    assert len(steps) == len(np.unique(steps, axis=0)) == 16
    lengths = np.linalg.norm(steps, axis=1)
    np.testing.assert_allclose(np.unique(lengths.round(4)), 0.5 * np.sqrt([1, 2, 5]), atol=1e-4)
    headings = np.sort(np.arctan2(*steps.T[::-1]))
    gaps = np.degrees(np.diff(headings))
    assert gaps.min() == pytest.approx(18.43, abs=0.01)
    assert gaps.max() == pytest.approx(26.57, abs=0.01)
    state, goal = jnp.array([1.0, 1.0]), jnp.array([2.0, 1.0])
    for step, length in zip(steps, lengths, strict=True):
        following = walker.dynamics(state, jnp.asarray(step))
        np.testing.assert_allclose(following, np.array([1.0, 1.0]) + step)
        reward = walker.reward(state, jnp.asarray(step), following, goal)
        assert float(reward) == pytest.approx(-length)
    assert not walker.terminated(jnp.array([1.69, 1.0]), goal)
    assert walker.terminal_reward(jnp.array([1.69, 1.0]), goal) == -math.inf
    assert walker.terminated(jnp.array([1.71, 1.0]), goal)
    assert walker.terminal_reward(jnp.array([1.71, 1.0]), goal) == 0.0


@pytest.mark.parametrize("spacing", [0.25, 0.5])
def test_above_the_least_beta_walks_have_a_finite_sum(spacing: float) -> None:
    walker = Walker(spacing=spacing)
    lengths = np.linalg.norm(np.asarray(walker.actions, float), axis=1)
    assert np.exp(-walker.least_beta * lengths).sum() == pytest.approx(1.0, abs=1e-5)


def test_a_length_is_positive() -> None:
    with pytest.raises(ValueError, match=r"Walker: spacing: expected a finite number > 0, got 0"):
        Walker(spacing=0.0)
    with pytest.raises(ValueError, match=r"Walker: reach: expected a finite number > 0, got -1"):
        Walker(reach=-1)


@pytest.mark.parametrize(
    ("place", "is_blocked"),
    [
        ((1.5, 1.5), True),
        ((1.0, 1.0), True),  # cells are half-open
        ((2.0, 1.5), False),
        ((1.5, 0.99), False),
        ((3.9, 2.9), True),
        ((-0.01, 0.5), True),  # beyond the map
        ((4.0, 0.5), True),
        ((0.5, 3.0), True),
        ((math.nan, 0.5), True),
    ],
)
def test_a_map_says_where_nobody_can_be(place: tuple[float, float], is_blocked: bool) -> None:
    state = np.array([place])
    assert walls().contains(state, SPACE).tolist() == [is_blocked]
    assert bool(jax.jit(lambda s: walls().contains(s, SPACE))(jnp.asarray(state))[0]) == is_blocked


def test_segments_are_tried_all_the_way() -> None:
    generator = np.random.default_rng(0)
    fine = Occupancy("walls", generator.random((60, 80)) < 0.01, (0.0, 0.0), 0.05)
    starts = generator.uniform((0.0, 0.0), (4.0, 3.0), (400, 2))
    ends = generator.uniform((0.0, 0.0), (4.0, 3.0), (400, 2))
    share = np.linspace(0.0, 1.0, 10_001)[:, None, None]
    inside = np.concatenate(
        [fine.contains(starts + x * (ends - starts), SPACE) for x in np.array_split(share, 50)]
    )
    exact, got = inside.any(axis=0), fine.crosses(starts, ends, SPACE)
    assert 50 < exact.sum() < 350
    assert not (exact & ~got).any()
    assert (got & ~exact).sum() < 5  # tips of corners between two of the points
    traced = jax.jit(lambda a, b: fine.crosses(a, b, SPACE))(jnp.asarray(starts), jnp.asarray(ends))
    np.testing.assert_array_equal(np.asarray(traced), got)


def test_a_step_over_a_thin_wall_crosses_it() -> None:
    blocked = np.zeros((300, 400), bool)
    blocked[:, 200] = True
    thin = Occupancy("wall", blocked, (0.0, 0.0), 0.01)
    start, end = np.array([[1.9, 1.0]]), np.array([[2.4, 1.2]])
    assert not thin.contains(np.array([start[0], end[0]]), SPACE).any()
    assert thin.crosses(start, end, SPACE).all()


def test_a_body_keeps_its_distance() -> None:
    blocked = np.zeros((30, 40), bool)
    blocked[14, 19] = True
    wide = Occupancy("walls", blocked, (0.0, 0.0), 0.1).widened(0.35)
    rows, columns = np.mgrid[:30, :40]
    near = 0.1 * np.hypot(rows - 14, columns - 19) < 0.35
    beyond = 0.1 * np.minimum.reduce([rows + 1, 30 - rows, columns + 1, 40 - columns]) < 0.35
    np.testing.assert_array_equal(wide.blocked, near | beyond)


def test_a_map_is_stored_with_results() -> None:
    generator = np.random.default_rng(0)
    made = Occupancy("walls", generator.random((7, 11)) < 0.4, (-1.0, 2.0), 0.3)
    again = constraint_from_json(made.to_json())
    assert isinstance(again, Occupancy)
    np.testing.assert_array_equal(again.blocked, made.blocked)
    assert repr(again) == repr(made)
    assert "7 x 11" in repr(made)
    other = Occupancy("walls", ~made.blocked, (-1.0, 2.0), 0.3)
    prints = {
        Problem(Walker(), [swerve.Box(x=(0.0, 1.0))], known=[one]).record.fingerprint
        for one in (made, again, other)
    }
    assert len(prints) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((MAP.astype(float), (0.0, 0.0), 1.0), "a map [rows, columns] of booleans, got float64"),
        ((MAP[0], (0.0, 0.0), 1.0), "a map [rows, columns] of booleans, got bool of shape (4,)"),
        ((MAP, (0.0, math.nan), 1.0), "expected a corner (x, y), got (0.0, nan)"),
        ((MAP, (0.0,), 1.0), "expected a corner (x, y), got (0.0,)"),
        ((MAP, (0.0, 0.0), 0.0), "cell: expected a finite number > 0, got 0"),
        ((MAP, (0.0, 0.0), 1.0, ("x",)), "expected the names of two states, got ('x',)"),
    ],
)
def test_no_map(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        Occupancy("walls", *arguments)


def test_a_map_is_of_positions() -> None:
    with pytest.raises(ValueError, match="no state named 'z'; the states are x, y"):
        Occupancy("walls", MAP, (0.0, 0.0), 1.0, ("x", "z")).check(SPACE, ())
    space = StateSpace(("x", "y"), ("y",), SPACE.bounds)
    with pytest.raises(ValueError, match="'y' is an angle, no position"):
        walls().check(space, ())
