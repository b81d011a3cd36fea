"""Shapes: names, JSON, checks, and inference with them."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from support.reference import PENDULUM_TASK, enumerate_exactly, short_pendulum
from support.shapes import ALL, ARROW, PLANE, SPACE, SQUARE, star

from swerve import Ball, Box, Enumeration, HalfSpace, Polygon, Problem, Union, learn, sample
from swerve.constraints.base import Constraint, violates
from swerve.constraints.predicate import Predicate
from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import ConstraintHypotheses


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
