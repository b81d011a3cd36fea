"""The rule of what enters a constraint, unions, and the checks of lists of constraints."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import Union, check_constraints, step_enters, violates
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)


def in_disc(states: Any) -> Any:
    return (states**2).sum(axis=-1) < 1.0


class TestStepEnters:
    @pytest.mark.parametrize("between_states", [True, False])
    @pytest.mark.parametrize(
        "constraint",
        [
            Box(theta=(1.0, 2.0), omega=(-1.0, 1.0)),
            ActionBox(torque=(0.5, 2.0)),
            StateAction(Box(omega=(-2.0, 2.0)), ActionBox(torque=(0.5, 2.0))),
            Union("both", [Box(theta=(1.0, 2.0)), ActionBox(torque=(0.5, 2.0))]),
        ],
    )
    def test_a_trajectory_enters_by_a_step_or_by_its_start(
        self, constraint, between_states
    ) -> None:
        generator = np.random.default_rng(0)
        states = generator.uniform(-6.0, 6.0, (300, 4, 2))
        torques = generator.uniform(-1.0, 1.0, (300, 3, 1))
        expected = constraint.contains(states[:, 0], PENDULUM)
        for k in range(3):
            actions = Actions(("torque",), torques[:, k])
            start, end = states[:, k], states[:, k + 1]
            hit = step_enters(constraint, start, end, PENDULUM, between_states, actions)
            start, end = jnp.asarray(start), jnp.asarray(end)
            in_jax = step_enters(constraint, start, end, PENDULUM, between_states, actions)
            np.testing.assert_array_equal(in_jax, hit)
            expected = expected | hit
        actions = Actions(("torque",), torques)
        found = violates(constraint, states, PENDULUM, between_states, actions)
        np.testing.assert_array_equal(found, expected)
        assert 0 < found.sum() < 300

    def test_an_end_beside_the_set_counts_only_with_the_segment(self) -> None:
        start, end, box = np.array([-1.0, 0.0]), np.array([2.0, 0.0]), Box(x=(0.0, 1.0))
        assert step_enters(box, start, end, PLANE, True)
        assert not step_enters(box, start, end, PLANE, False)
        inside = np.array([0.5, 0.0])
        assert step_enters(box, inside, end, PLANE, True)
        assert not step_enters(box, inside, end, PLANE, False)  # its own step entered it

    def test_without_actions_the_states_alone_are_judged(self) -> None:
        start, end = np.zeros(2), np.ones(2)
        both = Union("both", [Box(x=(5.0, 6.0)), ActionBox(torque=(0.0, 1.0))])
        assert not step_enters(both, start, end, PLANE, True)
        actions = Actions(("torque",), np.array([0.5]))
        assert step_enters(both, start, end, PLANE, True, actions)


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
