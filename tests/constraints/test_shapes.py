from __future__ import annotations

import json
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.reference import PENDULUM_TASK, enumerate_exactly, short_pendulum

from swerve import Ball, Box, Enumeration, HalfSpace, Polygon, Problem, Union, learn, sample
from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints import polygon_geometry
from swerve.constraints.base import Constraint, violates
from swerve.constraints.predicate import Predicate
from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import ConstraintHypotheses

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
SPACE = StateSpace(("theta", "x", "y"), ("theta",), np.array([[0.0, TWO_PI], [-4, 4], [-4, 4]]))
ARROW = [(0.0, 0.0), (3.0, 1.0), (0.0, 2.0), (1.0, 1.0)]  # not convex
SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
ALL = [
    Ball(1.3, x=0.5, y=-0.25),
    Ball(1.7, theta=5.9, x=1.0),
    Ball(0.9, theta=1.0),
    HalfSpace(1.0, x=1.0, y=-2.0),
    Polygon(ARROW),
    Polygon(ARROW, depth=0.2),
    Polygon(SQUARE, names=("y", "x")),
]
seeds = st.integers(0, 2**32 - 1)


def by_winding(vertices: Any, points: np.ndarray) -> np.ndarray:
    """Whether points [..., 2] lie inside, by the angle that the edge turns around them."""
    to = np.asarray(vertices, float) - points[..., None, :]
    angle = np.arctan2(to[..., 1], to[..., 0])
    turns = np.diff(np.concatenate([angle, angle[..., :1]], axis=-1), axis=-1)
    return np.abs((turns - TWO_PI * np.round(turns / TWO_PI)).sum(axis=-1)) > math.pi


def to_edge(vertices: Any, points: np.ndarray) -> np.ndarray:
    """The distance of points [M, 2] to a fine sample of a polygon's edges."""
    corners = np.asarray(vertices, float)
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    edge = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    return np.linalg.norm(points[:, None] - edge, axis=-1).min(axis=1)


def star(seed: int, num: int = 7) -> np.ndarray:
    """A polygon around the origin that does not cross itself and is seldom convex."""
    generator = np.random.default_rng(seed)
    angle = np.arange(num) * TWO_PI / num + generator.uniform(0.0, 4.2 / num, num)
    radius = generator.uniform(0.4, 3.0, num)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


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
        np.testing.assert_array_equal(
            Polygon(SQUARE).crosses(starts, ends, PLANE), box.crosses(starts, ends, PLANE)
        )

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
        axes = [np.linspace(0.0, TWO_PI, 90), *[np.linspace(-4.5, 4.5, 91)] * 2]
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


class TestWords:
    @pytest.mark.parametrize("constraint", ALL, ids=repr)
    def test_repr_and_json_make_it_again(self, constraint: Constraint) -> None:
        names = {"Ball": Ball, "HalfSpace": HalfSpace, "Polygon": Polygon}
        again = eval(repr(constraint), names)  # noqa: S307
        stored = constraint_from_json(json.loads(json.dumps(constraint.to_json())))
        assert repr(again) == repr(stored) == repr(constraint)
        assert again.to_json() == stored.to_json() == constraint.to_json()

    def test_names(self) -> None:
        assert Ball(0.5, x=1.0, y=-2.0).name == "ball of radius 0.5 at x 1, y -2"
        assert repr(Ball(0.5, **{"x [m]": 1})) == "Ball(0.5, **{'x [m]': 1.0})"
        assert repr(Ball(0.5, radius=1.0)) == "Ball(0.5, radius=1.0)"
        assert HalfSpace(3.0, x=-1.0, y=2.5).name == "-x + 2.5 y >= 3"
        assert HalfSpace(0.0, y=1.0, x=-1.0).name == "y - x >= 0"
        assert Polygon(ARROW).name == "polygon of 4 vertices in x [0, 3], y [0, 2]"
        assert Polygon(ARROW, depth=0.2).name.endswith("y [0, 2], 0.2 deep")

    def test_hypotheses_list_the_states_that_they_name(self) -> None:
        listed = [HalfSpace(1.0, y=1.0), Union("both", [ALL[1], Box(omega=(0.0, 1.0))])]
        assert ConstraintHypotheses(listed).state_names == ("y", "theta", "x", "omega")
        assert ConstraintHypotheses([ALL[6]]).state_names == ("y", "x")

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: Ball(0.0, x=1.0), r"Ball: expected a finite radius > 0, got 0\.0"),
            (lambda: Ball(math.nan, x=1.0), "Ball: expected a finite radius > 0, got nan"),
            (lambda: Ball(1.0), r"Ball: expected a centre, as in Ball\(0\.5"),
            (lambda: Ball(1.0, x=math.inf), "Ball: expected a finite number for 'x', got inf"),
            (lambda: HalfSpace(1.0), r"HalfSpace: expected a normal, as in"),
            (lambda: HalfSpace(1.0, x=0.0, y=0.0), "expected a normal that is not zero"),
            (lambda: HalfSpace(1.0, x=math.nan), "HalfSpace: expected a finite number for 'x'"),
            (lambda: HalfSpace(math.inf, x=1.0), "HalfSpace: expected a finite offset, got inf"),
            (lambda: Polygon(SQUARE[:2]), r"at least 3 vertices, .* shape \(2, 2\)"),
            (lambda: Polygon([1.0, 2.0, 3.0]), r"each a pair of numbers, .* shape \(3,\)"),
            (lambda: Polygon([*SQUARE, (0.0, 0.0)]), r"vertices 0 and 4 are the same, \[0\.0, 0"),
            (lambda: Polygon([(0, 0), (1, 1), (3, 3)]), "all vertices lie on one line"),
            (lambda: Polygon([(0, 0), (1, 1), (2, math.nan)]), "vertex 2 is not finite"),
            (
                lambda: Polygon([(0, 0), (2, 2), (2, 0), (0, 2)]),
                r"edge 0, from \[0\.0, 0\.0\] to \[2\.0, 2\.0\], meets edge 2, from \[2\.0, 0\.0\]",
            ),
            (lambda: Polygon([(0, 0), (4, 0), (4, 4), (2, 0)]), "edge 0, .* meets edge 2"),
            (lambda: Polygon([(0, 0), (4, 0), (2, 0), (2, 2)]), "edge 0, .* meets edge 1"),
            (lambda: Polygon(SQUARE, depth=-0.1), "expected a finite depth >= 0, got -0.1"),
            (lambda: Polygon(SQUARE, names=("x", "x")), "expected the names of two states"),
            (lambda: Polygon(SQUARE, names="xy"), "expected the names of two states, got 'xy'"),
        ],
    )
    def test_what_is_none_is_refused(self, make: Any, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            make()

    def test_check_refuses_what_does_not_fit_the_states(self) -> None:
        for constraint in (Ball(1.0, z=0.0), HalfSpace(1.0, z=1.0), Polygon(SQUARE, ("x", "z"))):
            with pytest.raises(ValueError, match="no state named 'z'"):
                constraint.check(SPACE, ())
        for constraint in (HalfSpace(1.0, theta=1.0), Polygon(SQUARE, ("theta", "x"))):
            with pytest.raises(ValueError, match=r"'theta' is an angle, .* use a Box"):
                constraint.check(SPACE, ())
        for constraint in ALL:
            constraint.check(SPACE, ())


class TestInference:
    LISTED = (
        Ball(0.5, theta=3.6, omega=-1.0),
        HalfSpace(2.0, omega=1.0),
    )

    def test_enumeration_agrees_with_every_sequence(self) -> None:
        listed = [*self.LISTED[:2], Union("either", self.LISTED[:2])]
        for known in ([], [Ball(0.4, theta=2.4, omega=2.0)]):
            problem = Problem(short_pendulum().mdp, listed, beta=0.05, known=known)
            expected = enumerate_exactly(problem, *PENDULUM_TASK)
            found = sample(learn(problem, Enumeration()), PENDULUM_TASK)
            np.testing.assert_allclose(
                found.violation_probability[0], expected.violation_probability, atol=2e-3
            )
            assert (expected.violation_probability > 0.02).all()
            assert (expected.violation_probability < 0.99).all()

    def test_a_fine_predicate_says_nearly_the_same(self) -> None:
        states = np.random.default_rng(0).uniform(-3.0, 3.0, (500, 6, 2)).cumsum(axis=1) * 0.4
        polygon = Polygon(star(3))
        same = Predicate("same", lambda points: polygon.contains(points, PLANE), 300)
        found = violates(polygon, states, PLANE, True)
        by_points = violates(same, states, PLANE, True)
        assert not (by_points & ~found).any()
        assert (by_points != found).mean() < 0.01
        assert 0.2 < found.mean() < 0.95
