from __future__ import annotations

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import CART_TASK, Cart, enumerate_exactly

from swerve import (
    ActionBox,
    Ball,
    Box,
    Demonstration,
    Enumeration,
    Grid,
    Gridworld,
    HalfSpace,
    Pendulum,
    Predicate,
    Problem,
    StateAction,
    Tabular,
    Task,
    Union,
    demonstrate,
    infer,
    learn,
    sample,
)
from swerve.base.space import Actions, StateSpace
from swerve.constraints.base import violates
from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.simulation.trajectory import enters

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
FAST, LEFT = ActionBox(f=(0.5, 2.0)), Box(x=(-4.0, 0.0))
FAST_LEFT = StateAction(LEFT, FAST)
PUSH = ActionBox(force=(0.5, 1.5))
HYPOTHESES = [
    StateAction(Box(x=(-1.0, 0.5)), ActionBox(force=(-1.5, -0.5))),
    StateAction(HalfSpace(0.2, x=1.0, v=0.5), PUSH),
    Union("either", [StateAction(Ball(0.4, x=0.0, v=-0.3), PUSH), Box(x=(0.9, 1.2))]),
]
KNOWN = [StateAction(Box(v=(-4.0, -0.4)), ActionBox(force=(-1.5, -0.5)))]


class TestJudging:
    def test_forbids_actions_where_they_begin(self) -> None:
        states = np.array([[-1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
        actions = Actions(("f",), np.array([[1.0], [0.0], [1.0]]))
        np.testing.assert_array_equal(
            FAST_LEFT.forbids_in(states, actions, PLANE), [True, False, False]
        )
        assert not FAST_LEFT.forbids(actions).any()
        assert not FAST_LEFT.contains(states, PLANE).any()
        assert not FAST_LEFT.crosses(states, -states, PLANE).any()
        assert FAST.forbids_in(states, actions, PLANE).tolist() == [True, False, True]
        assert not LEFT.forbids_in(states, actions, PLANE).any()

    @pytest.mark.parametrize("between_states", [True, False])
    def test_a_trajectory_violates_it_by_a_step_that_begins_there(self, between_states) -> None:
        path = np.array([[-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
        values = np.array([[[1.0], [0.0]], [[0.0], [1.0]], [[np.nan], [np.nan]]])
        hit = violates(
            FAST_LEFT, np.stack([path] * 3), PLANE, between_states, Actions(("f",), values)
        )
        np.testing.assert_array_equal(hit, [True, False, False])

    def test_random_trajectories_one_step_after_another(self) -> None:
        generator = np.random.default_rng(0)
        states = generator.uniform(-2.0, 2.0, (300, 4, 2))
        values = generator.uniform(-1.0, 1.0, (300, 3, 1))
        expected = ((states[:, :-1, 0] < 0.0) & (values[..., 0] >= 0.5)).any(axis=1)
        listed = [FAST_LEFT, Union("u", [FAST_LEFT, Box(y=(1.9, 2.0))]), LEFT]
        actions = Actions(("f",), values)
        bits = ConstraintHypotheses(listed).violations(states, PLANE, False, actions)
        found = unpack(bits, 3).T
        np.testing.assert_array_equal(found[0], expected)
        high = (states[..., 1] >= 1.9).any(axis=1)
        np.testing.assert_array_equal(found[1], expected | high)
        np.testing.assert_array_equal(found[2], (states[..., 0] < 0.0).any(axis=1))
        assert 0.2 < expected.mean() < 0.8

    def test_works_under_jax(self) -> None:
        mdp = Cart()
        known = [StateAction(Box(x=(-1.0, 0.5)), PUSH)]
        states = jnp.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
        actions = jnp.array([[1.0], [0.0], [1.0]])
        judge = jax.jit(jax.vmap(lambda s, a: enters(known, s, mdp.dynamics(s, a), mdp, True, a)))
        np.testing.assert_array_equal(judge(states, actions), [True, False, False])

    def test_which_actions_of_an_mdp_a_box_forbids(self) -> None:
        assert PUSH.among(Cart()).tolist() == [False, False, True]
        assert ActionBox(force=(-2.0, 0.5)).among(Cart()).tolist() == [True, True, False]


class TestExact:
    """Hypotheses and known constraints of the kind, against every sequence of actions."""

    def expected(self, known: list) -> tuple[Problem, Any]:
        problem = Problem(Cart(), HYPOTHESES, known=known)
        return problem, enumerate_exactly(problem, *CART_TASK)

    @pytest.mark.parametrize("known", [[], KNOWN], ids=["free", "known"])
    def test_enumeration(self, known: list) -> None:
        problem, expected = self.expected(known)
        found = sample(learn(problem, Enumeration()), CART_TASK)
        np.testing.assert_allclose(
            found.violation_probability[0], expected.violation_probability, atol=1e-4
        )
        assert found.log_partition[0] == pytest.approx(expected.log_partition, abs=1e-4)
        assert (expected.violation_probability > 0.02).all()
        assert (expected.violation_probability < 0.98).all()

    def test_what_is_known_changes_the_answer(self) -> None:
        free, known = (self.expected(known)[1] for known in ([], KNOWN))
        assert known.log_partition < free.log_partition - 0.1

    @pytest.mark.parametrize("known", [[], KNOWN], ids=["free", "known"])
    def test_samples_of_the_grid_solver(self, known: list) -> None:
        problem, expected = self.expected(known)
        nominal = learn(problem, Grid(num_points=(41, 41)), tasks=CART_TASK)
        found = sample(nominal, CART_TASK, num_trajectories=20_000, method="importance", seed=0)
        assert found.effective_sample_size[0] > 10_000
        np.testing.assert_allclose(
            found.violation_probability[0], expected.violation_probability, atol=0.02
        )
        assert found.log_partition[0] == pytest.approx(expected.log_partition, abs=0.05)
        kept = found.samples.kept[0]
        forces = np.round(np.diff(kept[..., 1], axis=1) / 0.5)
        if known:
            assert not ((kept[:, :-1, 1] < -0.4) & (forces < -0.5)).any()

    @pytest.mark.parametrize("is_known", [False, True])
    def test_tabular_agrees_with_enumeration(self, is_known: bool) -> None:
        world = Gridworld(width=3, height=3, num_steps=5)
        right = ActionBox(dx=(0.5, 1.5), dy=(-0.5, 0.5))
        known = [StateAction(Box(y=(-0.5, 0.5)), right)] if is_known else []
        listed = [StateAction(Box(x=(0.5, 1.5)), right), StateAction(Box(y=(0.5, 1.5)), right)]
        problem = Problem(world, listed, beta=0.7, known=known)
        task = Task(np.array([0.0, 0.0]), np.array([2.0, 1.0]))
        exact, table = (
            sample(learn(problem, solver), task) for solver in (Enumeration(), Tabular())
        )
        np.testing.assert_allclose(
            table.violation_probability, exact.violation_probability, atol=1e-5
        )
        np.testing.assert_allclose(table.log_partition, exact.log_partition, atol=1e-4)
        assert (exact.violation_probability > 0.01).all()


class TestDemonstrations:
    def evidence(self, known: list | None = None) -> Any:
        problem = Problem(Cart(), HYPOTHESES, known=known or [])
        return sample(learn(problem, Enumeration()), CART_TASK)

    def test_their_continuous_actions_are_tested_as_they_were(self) -> None:
        """A force of 0.6 is none of the three; that of 1.6 would be the forbidden 1, if rounded."""
        states = np.array([[0.6, 0.3], [0.7, 0.3], [0.8, 0.3]])
        for force, expected in ((0.45, False), (0.5, True), (0.6, True), (1.6, False)):
            actions = np.array([[0.0], [force]])
            demonstration = Demonstration("d", states, CART_TASK, np.arange(3) * 0.5, actions)
            entered = infer(self.evidence(), [demonstration]).entered
            assert entered.tolist() == [[False, expected, False]], force

    def test_without_actions_they_are_refused(self) -> None:
        states = np.array([[0.6, 0.3], [0.7, 0.3]])
        with pytest.raises(ValueError, match="d: the problem has constraints on actions, so"):
            infer(self.evidence(), [Demonstration("d", states, CART_TASK)])

    def test_one_that_breaks_a_known_constraint_is_refused(self) -> None:
        states = np.array([[0.6, 0.3], [0.7, -0.5], [0.8, -0.6]])
        times = np.arange(3) * 0.5
        fine = Demonstration("d", states, CART_TASK, times, np.array([[-1.0], [0.0]]))
        evidence = self.evidence(KNOWN)
        infer(evidence, [fine])
        wrong = Demonstration("d", states, CART_TASK, times, np.array([[-1.0], [-1.0]]))
        with pytest.raises(ValueError, match=r"d enters the known constraint action force \[-1\.5"):
            infer(evidence, [wrong])

    def test_the_true_one_is_found_from_demonstrations_that_obey_it(self) -> None:
        problem = Problem(Cart(), HYPOTHESES)
        made = demonstrate(problem, HYPOTHESES[1], [CART_TASK] * 12, seed=1)
        assert not any(
            violates(
                HYPOTHESES[1],
                item.states,
                problem.mdp.space,
                True,
                Actions(("force",), np.asarray(item.actions)),
            )
            for item in made
        )
        result = infer(self.evidence(), made)
        assert not result.struck_out[1]
        assert result.ranking[0] == 1


class TestWords:
    def test_names_repr_and_json(self) -> None:
        assert FAST_LEFT.name == "action f [0.5, 2) in x [-4, 0)"
        assert repr(FAST_LEFT) == "StateAction(Box(x=(-4.0, 0.0)), ActionBox(f=(0.5, 2.0)))"
        for constraint in (FAST_LEFT, *HYPOTHESES):
            stored = constraint_from_json(json.loads(json.dumps(constraint.to_json())))
            assert repr(stored) == repr(constraint)
        assert ConstraintHypotheses(HYPOTHESES).state_names == ("x", "v")
        assert ConstraintHypotheses(HYPOTHESES).about_actions

    def test_less_a_margin(self) -> None:
        smaller = FAST_LEFT.eroded({"x": 0.5}, PLANE)
        assert isinstance(smaller, StateAction)
        assert repr(smaller.states) == "Box(x=(-3.5, -0.5))"
        assert smaller.actions is FAST

    def test_distance_is_that_of_its_states(self) -> None:
        states = np.array([[-5.5, 0.0], [-4.0, 9.0], [-1.0, 0.0], [2.0, -3.0]])
        np.testing.assert_allclose(FAST_LEFT.distance(states, PLANE), [1.5, 0.0, 0.0, 2.0])
        # no state lies in or near what forbids actions alone
        assert np.isposinf(FAST.distance(states, PLANE)).all()
        both = Union("both", [LEFT, FAST])
        np.testing.assert_array_equal(both.distance(states, PLANE), LEFT.distance(states, PLANE))

    def test_needs_code_where_its_states_do(self) -> None:
        assert StateAction(Predicate("p", lambda states: states[..., 0] > 0), FAST).needs_code
        assert not FAST_LEFT.needs_code

    def test_what_is_none_is_refused(self) -> None:
        wrong: Any = FAST
        with pytest.raises(ValueError, match="expected a constraint on states alone first, such"):
            StateAction(wrong, FAST)
        wrong = LEFT
        with pytest.raises(ValueError, match="StateAction: expected an ActionBox second, got Box"):
            StateAction(LEFT, wrong)
        with pytest.raises(ValueError, match="no state named 'z'"):
            StateAction(Box(z=(0, 1)), FAST).check(PLANE, ("f",))
        with pytest.raises(ValueError, match="no action component 'f'"):
            FAST_LEFT.check(PLANE, ("g",))

    def test_what_forbids_no_action_is_refused(self) -> None:
        beyond = ActionBox(torque=(30.0, 40.0))
        message = (
            r"hypotheses: action torque \[30, 40\) in omega \[0, 1\) forbids none of the 5 actions "
            r"of Pendulum \(torque from -1 to 1\)"
        )
        with pytest.raises(ValueError, match=message):
            Problem(Pendulum(), [ActionBox(torque=(0, 2)), StateAction(Box(omega=(0, 1)), beyond)])
        with pytest.raises(ValueError, match="forbids none of the 5 actions"):
            Problem(Pendulum(), [Union("both", [Box(omega=(0, 1)), beyond])])
