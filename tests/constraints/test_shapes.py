"""Balls, half-spaces and polygons: what they contain, what crosses them, how far they are."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.shapes import ALL, ARROW, PLANE, SPACE, SQUARE, by_winding, star, to_edge

from swerve import Ball, Box, HalfSpace, Polygon
from swerve.base.space import TWO_PI
from swerve.constraints import polygon_geometry
from swerve.constraints.base import Constraint

seeds = st.integers(0, 2**32 - 1)


class TestContains:
    @given(seed=seeds)
    def test_ball_is_nearer_than_its_radius(self, seed) -> None:
        states = np.random.default_rng(seed).uniform(-9.0, 9.0, (200, 3))
        gap = np.angle(np.exp(1j * (states[:, 0] - 5.9)))
        inside = np.hypot(gap, states[:, 1] - 1.0) < 1.7
        np.testing.assert_array_equal(ALL[1].contains(states, SPACE), inside)
        turned = states + np.array([2 * TWO_PI, 0.0, 0.0])
        np.testing.assert_array_equal(ALL[1].contains(turned, SPACE), inside)

    def test_ball_is_open_and_half_space_is_closed(self) -> None:
        states = np.array([[1.0, 0.0], [0.999, 0.0], [1.001, 0.0]])
        assert Ball(1.0, x=0.0, y=0.0).contains(states, PLANE).tolist() == [False, True, False]
        assert HalfSpace(1.0, x=1.0).contains(states, PLANE).tolist() == [True, False, True]

    @given(seed=seeds)
    def test_polygon_agrees_with_the_winding_number(self, seed) -> None:
        vertices = star(seed)
        points = np.random.default_rng(seed).uniform(-3.0, 3.0, (300, 2))
        found = Polygon(vertices).contains(points, PLANE)
        np.testing.assert_array_equal(found, by_winding(vertices, points))
        np.testing.assert_array_equal(Polygon(vertices[::-1]).contains(points, PLANE), found)
        assert found.any()

    def test_polygon_over_states_in_another_order(self) -> None:
        states = np.random.default_rng(0).uniform(-1.0, 4.0, (500, 2))
        swapped = Polygon(ARROW, names=("y", "x")).contains(states, PLANE)
        np.testing.assert_array_equal(swapped, by_winding(ARROW, states[:, ::-1]))
        assert swapped.any()

    def test_depth_keeps_what_is_far_from_the_edge(self) -> None:
        states = np.random.default_rng(1).uniform(-0.5, 3.5, (2000, 2))
        distance = to_edge(ARROW, states)
        sure = np.abs(distance - 0.2) > 0.002
        expected = by_winding(ARROW, states) & (distance > 0.2)
        found = Polygon(ARROW, depth=0.2).contains(states, PLANE)
        np.testing.assert_array_equal(found[sure], expected[sure])
        assert 20 < expected.sum() < by_winding(ARROW, states).sum()


class TestManyVertices:
    """Points are told apart by their place first and judged some at a time: nothing may be lost."""

    VERTICES = star(5, 90)
    STATES = np.random.default_rng(4).uniform(-6.0, 6.0, (4, 600, 3))

    @pytest.mark.parametrize("depth", [0.0, 0.1])
    def test_a_batch_is_judged_as_each_of_it_is(self, depth: float) -> None:
        polygon = Polygon(self.VERTICES, depth=depth)
        starts, ends = self.STATES[:2], 0.8 * self.STATES[:2] + 0.2 * self.STATES[2:]
        assert starts.size * len(self.VERTICES) > polygon_geometry.AT_ONCE
        inside, crossed = polygon.contains(starts, SPACE), polygon.crosses(starts, ends, SPACE)
        assert inside.shape == crossed.shape == (2, 600)
        for index in np.ndindex(2, 100):
            assert polygon.contains(starts[index], SPACE) == inside[index]
            assert polygon.crosses(starts[index], ends[index], SPACE) == crossed[index]
        assert 0.01 < inside.mean() < crossed.mean() - 0.01

    def test_the_winding_number_agrees(self) -> None:
        polygon = Polygon(self.VERTICES)
        found = polygon.contains(self.STATES, SPACE)
        np.testing.assert_array_equal(found, by_winding(self.VERTICES, self.STATES[..., 1:]))
        deep = Polygon(self.VERTICES, depth=0.1).contains(self.STATES, SPACE)
        to = np.sqrt(
            polygon_geometry.square_to_edge(self.VERTICES, *np.moveaxis(self.STATES, -1, 0)[1:])
        )
        np.testing.assert_array_equal(deep, found & (to > 0.1))

    def test_distance_keeps_the_shape_of_a_batch(self) -> None:
        polygon, states = Polygon(self.VERTICES), self.STATES[:, :5]
        found = polygon.distance(states, SPACE)
        each = [[polygon.distance(state, SPACE) for state in row] for row in states]
        np.testing.assert_array_equal(found, each)
        assert (found > 0).any()

    def test_no_state_at_all(self) -> None:
        nothing = np.zeros((0, 3))
        assert Polygon(self.VERTICES).contains(nothing, SPACE).shape == (0,)
        assert Polygon(self.VERTICES).crosses(nothing, nothing, SPACE).shape == (0,)
        assert Polygon(self.VERTICES).distance(nothing, SPACE).shape == (0,)


class TestCrosses:
    @pytest.mark.parametrize("constraint", ALL, ids=repr)
    def test_agrees_with_dense_points(self, constraint: Constraint) -> None:
        """Where the points say yes so does it; where they say no, its set less a bit is missed."""
        generator = np.random.default_rng(3)
        starts, ends = generator.uniform(-4.0, 7.0, (2, 3000, 3))
        ends = starts + 0.4 * (ends - starts)
        share = np.linspace(0.0, 1.0, 501)[:, None, None]
        points = starts + share * SPACE.difference(starts, ends)
        dense = constraint.contains(points, SPACE).any(axis=0)
        found = constraint.crosses(starts, ends, SPACE)
        assert not (dense & ~found).any()
        smaller = constraint.eroded({"theta": 0.01, "x": 0.01, "y": 0.01}, SPACE)
        assert not (smaller.crosses(starts, ends, SPACE) & ~dense).any()
        assert (found != dense).mean() < 0.01
        assert 0.02 < found.mean() < 0.98
        through = dense & ~constraint.contains(starts, SPACE) & ~constraint.contains(ends, SPACE)
        assert through.any() != isinstance(constraint, HalfSpace)
        backwards = constraint.crosses(ends, starts, SPACE)
        assert (backwards != found).mean() < 1e-3

    @given(seed=seeds)
    def test_a_square_is_a_box(self, seed) -> None:
        starts, ends = np.random.default_rng(seed).uniform(-1.0, 3.0, (2, 300, 2))
        box = Box(x=(0.0, 2.0), y=(0.0, 2.0))
        expected = box.crosses(starts, ends, PLANE)
        moves = 1e-4 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        near = [box.crosses(starts + move, ends + move, PLANE) for move in moves]
        clear = (np.array(near) == expected).all(axis=0)  # the edges of the two differ in rounding
        assert clear.sum() > 290
        found = Polygon(SQUARE).crosses(starts, ends, PLANE)
        np.testing.assert_array_equal(found[clear], expected[clear])

    def test_from_corner_to_corner(self) -> None:
        """No edge is cut in its middle, yet the diagonal runs inside; beside a corner none does."""
        inside = Polygon(SQUARE).crosses(np.array([-1.0, -1.0]), np.array([3.0, 3.0]), PLANE)
        beside = Polygon(SQUARE).crosses(np.array([-1.0, 1.0]), np.array([1.0, -1.0]), PLANE)
        notch = Polygon(ARROW).crosses(np.array([0.5, 0.8]), np.array([0.5, 1.2]), PLANE)
        assert (bool(inside), bool(beside), bool(notch)) == (True, False, False)

    def test_a_touched_ball_is_not_crossed(self) -> None:
        starts, ends = np.array([[-2.0, 1.0], [-2.0, 0.999]]), np.array([[2.0, 1.0], [2.0, 0.999]])
        found = Ball(1.0, x=0.0, y=0.0).crosses(starts, ends, PLANE)
        np.testing.assert_array_equal(found, [False, True])

    @pytest.mark.parametrize("constraint", ALL, ids=repr)
    def test_resting_is_the_same_as_containing(self, constraint: Constraint) -> None:
        states = np.random.default_rng(5).uniform(-4.0, 7.0, (500, 3))
        inside = constraint.contains(states, SPACE)
        np.testing.assert_array_equal(constraint.crosses(states, states, SPACE), inside)

    @pytest.mark.parametrize("constraint", ALL, ids=repr)
    def test_jax_judges_like_numpy(self, constraint: Constraint) -> None:
        starts, ends = np.random.default_rng(7).uniform(-4.0, 7.0, (2, 2000, 3)).astype(np.float32)
        judges: Any = ((constraint.contains, (starts,)), (constraint.crosses, (starts, ends)))
        for judge, arguments in judges:
            traced = jax.jit(jax.vmap(lambda *values, judge=judge: judge(*values, SPACE)))
            by_jax = np.asarray(traced(*map(jnp.asarray, arguments)))
            by_numpy = judge(*(values.astype(float) for values in arguments), SPACE)
            assert (by_jax != by_numpy).mean() <= 0.001
            assert 0.002 < by_numpy.mean() < 0.99


class TestDistanceAndMargin:
    @pytest.mark.parametrize("constraint", [ALL[0], ALL[1], ALL[3], ALL[4], ALL[6]], ids=repr)
    def test_distance_is_that_of_the_nearest_of_many_points(self, constraint: Constraint) -> None:
        generator = np.random.default_rng(11)
        states = generator.uniform([0.0, -2.0, -2.0], [TWO_PI, 3.0, 3.0], (40, 3))
        axes = [np.linspace(0.0, TWO_PI, 60), *[np.linspace(-4.5, 4.5, 181)] * 2]
        dense = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = dense[constraint.contains(dense, SPACE)]
        named = [SPACE.column(name) for name in constraint.spans]
        inside = np.unique(inside[:, named], axis=0)
        away = states[:, None][..., named] - inside
        is_angle = SPACE.is_angle[named]
        away = np.where(is_angle, np.angle(np.exp(1j * away)), away)
        nearest = np.linalg.norm(away, axis=-1).min(axis=1)
        found = constraint.distance(states, SPACE)
        assert (found <= nearest + 1e-9).all()
        assert (nearest - found < 0.15).all()
        np.testing.assert_array_equal(found[constraint.contains(states, SPACE)], 0.0)
        assert (found > 0.2).any()

    def test_what_is_eroded_is_deeper_than_the_margin(self) -> None:
        states = np.random.default_rng(2).uniform(-4.0, 4.0, (4000, 2))
        ball = Ball(1.3, x=0.5, y=-0.25).eroded({"x": 0.1, "y": 0.3}, SPACE)
        assert isinstance(ball, Ball)
        assert ball.radius == pytest.approx(1.0)
        assert repr(Ball(1.3, x=0.5).eroded({"y": 9.0}, SPACE)) == "Ball(1.3, x=0.5)"
        half = HalfSpace(1.0, x=1.0, y=-2.0).eroded({"x": 0.1, "y": 0.3}, SPACE)
        for dx, dy in ((0.1, 0.3), (-0.1, 0.3), (0.1, -0.3), (-0.1, -0.3)):
            moved = states + np.array([dx, dy])
            inside = half.contains(states, PLANE)
            assert (ALL[3].contains(moved, PLANE) | ~inside).all()
        assert isinstance(half, HalfSpace)
        assert half.offset == pytest.approx(1.7)
        polygon = Polygon(ARROW).eroded({"x": 0.1}, SPACE).eroded({"y": 0.1, "x": 0.05}, SPACE)
        assert isinstance(polygon, Polygon)
        assert polygon.depth == pytest.approx(0.2)
        assert repr(polygon.eroded({"theta": 9.0}, SPACE)) == repr(polygon)

    def test_where_nothing_is_left(self) -> None:
        with pytest.raises(ValueError, match=r"margin: 1.3 for 'y' leaves nothing of ball .* 1\.3"):
            Ball(1.3, x=0.0, y=0.0).eroded({"x": 0.1, "y": 1.3}, SPACE)
        message = r"margin: 1 for 'x' leaves nothing of polygon .* expected less than 1, the dist"
        with pytest.raises(ValueError, match=message):
            Polygon(SQUARE).eroded({"x": 1.0}, SPACE)
        with pytest.raises(ValueError, match=r"a depth of 1 leaves nothing: expected less than"):
            Polygon(SQUARE, depth=1.0)
        with pytest.raises(ValueError, match=r"expected a Polygon without depth"):
            Polygon(SQUARE, depth=0.5).distance(np.zeros(2), PLANE)

    @given(seed=seeds)
    def test_the_deepest_point_is_found(self, seed) -> None:
        vertices = star(seed)
        points = np.random.default_rng(seed).uniform(-3.0, 3.0, (3000, 2))
        points = points[by_winding(vertices, points)]
        depth = polygon_geometry.square_to_edge(vertices, points[:, 0], points[:, 1]) ** 0.5
        assert depth.max() <= polygon_geometry.deepest(vertices) * 1.011
        assert polygon_geometry.deepest(vertices) < depth.max() + 0.25

    def test_the_deepest_point_of_known_polygons(self) -> None:
        long = np.array([(0.0, 0.0), (50.0, 0.0), (50.0, 1.0), (0.0, 1.0)])
        assert polygon_geometry.deepest(long) == pytest.approx(0.5, rel=0.01)
        triangle = np.array([(0.0, 0.0), (4.0, 0.0), (0.0, 3.0)])
        assert polygon_geometry.deepest(triangle) == pytest.approx(1.0, rel=0.01)
