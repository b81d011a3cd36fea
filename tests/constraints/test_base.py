"""Constraints of any kind: predicates, unions, and which trajectories violate them."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import Union, check_constraints, violates
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.predicate import Predicate
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)


def in_disc(states: Any) -> Any:
    return (states**2).sum(axis=-1) < 1.0


class TestPredicate:
    def test_contains_what_the_function_says(self) -> None:
        disc = Predicate("disc", in_disc)
        states = np.array([[[0.0, 0.0], [2.0, 0.0]], [[0.6, 0.6], [1.0, 0.0]]])
        np.testing.assert_array_equal(disc.contains(states, PLANE), [[True, False], [True, False]])
        assert disc.name == "disc"

    def test_repr_says_what_was_given_without_addresses(self) -> None:
        assert repr(Predicate("disc", in_disc)) == "Predicate('disc', in_disc, num_points=8)"
        bound = functools.partial(in_disc)
        assert repr(Predicate("a b", bound, 3)) == "Predicate('a b', partial, num_points=3)"

    def test_crosses_tries_evenly_spaced_points(self) -> None:
        start, end = np.array([-4.0, 0.0]), np.array([4.0, 0.0])
        assert Predicate("disc", in_disc).crosses(start, end, PLANE)  # one point in 8 is the middle
        assert not Predicate("disc", in_disc, num_points=1).crosses(start, end, PLANE)
        assert not Predicate("disc", in_disc, num_points=3).crosses(start, end, PLANE)
        assert Predicate("disc", in_disc, num_points=1).crosses(end, np.zeros(2), PLANE)
        assert Predicate("disc", in_disc, num_points=1).crosses(np.zeros(2), end, PLANE)

    def test_points_follow_the_shorter_arc(self) -> None:
        low = Predicate("zero", lambda states: np.cos(states[..., 0]) > 0.99)
        start, end = np.array([0.5, 0.0]), np.array([TWO_PI - 0.5, 0.0])
        assert low.crosses(start, end, PENDULUM)
        assert not low.crosses(start, np.array([math.pi, 0.0]), PENDULUM)

    def test_agrees_with_the_box_it_describes(self) -> None:
        generator = np.random.default_rng(0)
        states = generator.uniform(-2.0, 2.0, (200, 9, 2))
        box = Box(x=(0.0, 1.0))
        strip = Predicate("strip", lambda s: (s[..., 0] >= 0.0) & (s[..., 0] < 1.0), 50)
        np.testing.assert_array_equal(
            violates(strip, states, PLANE, False), violates(box, states, PLANE, False)
        )
        fine, exact = (violates(c, states[:, :2], PLANE, True) for c in (strip, box))
        assert not (fine & ~exact).any()
        assert (fine == exact).mean() > 0.95

    @pytest.mark.parametrize(
        ("function", "got"),
        [
            (lambda states: states > 0, r"bool of shape \(5, 2\)"),
            (lambda states: states[..., 0], r"float64 of shape \(5,\)"),
            (lambda states: True, "bool of shape None"),
        ],
    )
    def test_a_function_that_gives_no_boolean_a_state(self, function: Any, got: str) -> None:
        message = rf"Predicate 'both': expected one boolean a state, shape \(5,\), got {got}"
        with pytest.raises(ValueError, match=message):
            Predicate("both", function).contains(np.zeros((5, 2)), PLANE)

    def test_no_points_are_refused(self) -> None:
        with pytest.raises(ValueError, match=r"Predicate 'disc': num_points: .* >= 1, got 0"):
            Predicate("disc", in_disc, 0)


class TestViolates:
    @given(seed=seeds)
    def test_segments_only_add(self, seed) -> None:
        generator = np.random.default_rng(seed)
        states = generator.uniform(-6.0, 6.0, (40, 5, 2))
        box = Box(theta=(1.0, 2.0), omega=(-1.0, 1.0))
        alone, between = (violates(box, states, PENDULUM, flag) for flag in (False, True))
        assert not (alone & ~between).any()
        np.testing.assert_array_equal(alone, box.contains(states, PENDULUM).any(axis=1))

    def test_judges_each_trajectory_of_a_batch(self) -> None:
        path = np.array([[-1.0, 0.5], [2.0, 0.5], [2.0, 2.0]])
        batch = np.stack([path, path + np.array([0.0, 1.0]), np.full((3, 2), 0.5)])
        box = Box(x=(0.0, 1.0), y=(0.0, 1.0))
        np.testing.assert_array_equal(violates(box, batch, PLANE, True), [True, False, True])
        np.testing.assert_array_equal(violates(box, batch, PLANE, False), [False, False, True])
        assert violates(box, path, PLANE, True)

    @given(seed=seeds)
    def test_points_inserted_on_a_segment_change_nothing(self, seed) -> None:
        generator = np.random.default_rng(seed)
        states = generator.uniform(-6.0, 6.0, (30, 4, 2))
        middle = states[:, :-1] + generator.uniform(0.01, 0.99, (30, 3, 1)) * PENDULUM.difference(
            states[:, :-1], states[:, 1:]
        )
        finer = np.zeros((30, 7, 2))
        finer[:, ::2], finer[:, 1::2] = states, middle
        box = Box(theta=(4.0, 6.5), omega=(-1.0, 2.0))
        np.testing.assert_array_equal(
            violates(box, states, PENDULUM, True), violates(box, finer, PENDULUM, True)
        )

    @pytest.mark.parametrize("between_states", [True, False])
    def test_a_single_state_is_judged_as_it_is(self, between_states: bool) -> None:
        states = np.array([[[0.5, 0.5]], [[1.5, 0.5]]])
        box = Box(x=(0.0, 1.0), y=(0.0, 1.0))
        same = Predicate("box", lambda states: box.contains(states, PLANE))
        for constraint in (box, same):
            found = violates(constraint, states, PLANE, between_states)
            np.testing.assert_array_equal(found, [True, False])
            assert violates(constraint, states[0], PLANE, between_states)

    @pytest.mark.parametrize("between_states", [True, False])
    def test_grid_and_list_agree_on_single_states(self, between_states: bool) -> None:
        cells = grid(x=(-4.0, 4.0, 5), y=(-2.0, 2.0, 3))
        boxes = ConstraintHypotheses([cells.constraint(k) for k in range(len(cells))])
        states = np.random.default_rng(0).uniform(-4.0, 4.0, (200, 1, 2))
        by_grid, by_list = (h.violations(states, PLANE, between_states) for h in (cells, boxes))
        np.testing.assert_array_equal(by_grid, by_list)
        assert 0.3 < np.count_nonzero(by_grid.any(axis=1)) / 200 < 0.7


class TestCheckConstraints:
    def test_returns_a_tuple(self) -> None:
        boxes = [Box(x=(0, 1)), Predicate("disc", in_disc)]
        assert check_constraints(iter(boxes), PLANE, (), "known") == tuple(boxes)

    def test_names_the_argument_and_the_position(self) -> None:
        wrong: Any = [Box(x=(0, 1)), (0.0, 1.0)]
        with pytest.raises(ValueError, match=r"known\[1\]: expected a Constraint, got \(0.0, 1.0"):
            check_constraints(wrong, PLANE, (), "known")
        with pytest.raises(ValueError, match="no state named 'z'"):
            check_constraints([Box(z=(0, 1))], PLANE, (), "known")


class TestUnion:
    def test_is_what_one_of_its_parts_forbids(self) -> None:
        generator = np.random.default_rng(0)
        states = generator.uniform(-2.0, 2.0, (300, 3, 2))
        actions = Actions(("f",), generator.uniform(-1.0, 1.0, (300, 2, 1)))
        parts = [Box(x=(0.0, 0.2)), Box(y=(1.0, 1.2)), ActionBox(f=(0.8, 2.0))]
        both = Union("both", [parts[0], Union("inner", parts[1:])])
        for between in (True, False):
            each = [violates(part, states, PLANE, between, actions) for part in parts]
            found = violates(both, states, PLANE, between, actions)
            np.testing.assert_array_equal(found, np.any(each, axis=0))
            assert 0.1 < found.mean() < 0.95
        assert both.parts == tuple(parts)
        assert both.about_actions
        assert not Union("states", parts[:2]).about_actions

    def test_needs_code_where_a_part_does(self) -> None:
        assert Union("a", [Predicate("disc", in_disc)]).needs_code
        assert not Union("a", [Box(x=(0, 1))]).needs_code

    @pytest.mark.parametrize("parts", [[], [(0.0, 1.0)]])
    def test_what_are_no_parts(self, parts: list) -> None:
        with pytest.raises(ValueError, match="Union 'a': expected constraints, got"):
            Union("a", parts)

    def test_its_parts_are_checked(self) -> None:
        with pytest.raises(ValueError, match="no state named 'z'"):
            Union("a", [Box(z=(0, 1))]).check(PLANE, ())
