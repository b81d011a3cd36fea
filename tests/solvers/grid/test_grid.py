"""The grid solver against exact enumeration, and its behaviour at cliffs and limits."""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)

from swerve import MDP, Box, Grid, Pendulum, Predicate, Problem, Task, grid, infer, learn, sample
from swerve.base.solver_kinds import KINDS
from swerve.solvers.grid.grid import GridNominal, GridPolicy

STANDARD_ERRORS = 4.5


def assert_agrees(problem: Problem, task: Task, least_ess: float = 0.5, num: int = 20_000) -> None:
    """Importance-weighted estimates lie within a few standard errors of enumeration."""
    exact = enumerate_exactly(problem, task.start, task.goal)
    evidence = sample(learn(problem, Grid()), task, num, seed=1)
    ess = evidence.effective_sample_size[0]
    assert ess >= least_ess * num
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / ess
    difference = evidence.violation_probability[0] - exact.violation_probability
    assert np.abs(difference / error).max() < STANDARD_ERRORS
    assert (
        np.count_nonzero((exact.violation_probability > 0.1) & (exact.violation_probability < 0.9))
        >= 3
    )
    spread = math.sqrt(max(1.0 / ess - 1.0 / num, 0.0))
    assert evidence.log_partition[0] == pytest.approx(
        exact.log_partition, abs=STANDARD_ERRORS * spread + 1e-3
    )
    assert evidence.soft_value[0] == pytest.approx(exact.log_partition, abs=KINDS["grid"].value_gap)


@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_pendulum_agrees_with_enumeration(measure: str, between_states: bool) -> None:
    assert_agrees(short_pendulum(measure=measure, between_states=between_states), PENDULUM_TASK)


@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_early_termination_agrees_with_enumeration(measure: str) -> None:
    assert_agrees(short_cart(measure=measure), CART_TASK)


@pytest.mark.parametrize("between_states", [True, False])
def test_known_constraints_agree_with_enumeration(between_states: bool) -> None:
    wall = Box(x=(-0.2, 0.3), v=(-0.9, 0.1))
    problem = short_cart(known=[wall], between_states=between_states)
    free = enumerate_exactly(short_cart(), CART_TASK.start, CART_TASK.goal)
    walled = enumerate_exactly(problem, CART_TASK.start, CART_TASK.goal)
    assert np.abs(free.violation_probability - walled.violation_probability).max() > 0.1
    assert_agrees(problem, CART_TASK, least_ess=0.2)


def test_a_thin_wall_that_is_dear_to_go_round_is_gone_round() -> None:
    """Thinner than the nodes lie apart, more than 30 nats to avoid: nothing of V leaks through."""
    wall = Box(x=(0.1, 0.105), v=(-0.75, 9.0))
    problem = short_cart(known=[wall], beta=40.0)
    free = enumerate_exactly(short_cart(beta=40.0), CART_TASK.start, CART_TASK.goal)
    exact = enumerate_exactly(problem, CART_TASK.start, CART_TASK.goal)
    assert free.log_partition - exact.log_partition > 30.0
    nominal = learn(problem, Grid(num_points=61))
    evidence = sample(nominal, CART_TASK, 4_000, method="importance")
    ess = evidence.effective_sample_size[0]
    assert ess > 200
    error = STANDARD_ERRORS / math.sqrt(ess)
    assert evidence.log_partition[0] == pytest.approx(exact.log_partition, abs=error)
    difference = evidence.violation_probability[0] - exact.violation_probability
    assert np.abs(difference).max() < error
    resampled = infer(sample(nominal, CART_TASK, 4_000))  # by values on the way, which are off
    assert resampled.verdict(0).startswith("not to be trusted")
    assert any("take method 'importance'" in text for text in resampled.warnings)


class Walk(MDP):
    """Steps much shorter than the nodes lie apart; all that counts is to end beyond x = 0."""

    drop: float = -10.0
    dt: float = 1.0
    num_steps: int = eqx.field(default=100, static=True)
    state_names = ("x",)
    action_names = ("u",)
    bounds = ((-1.0, 1.0),)

    @property
    def actions(self):
        return jnp.array([[-0.004], [0.0], [0.004]])

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return jnp.zeros(())

    def terminal_reward(self, state, goal):
        return jnp.where(state[0] > 0.0114, self.drop, 0.0)


@pytest.mark.parametrize("drop", [-1.5, -10.0, 10.0])
def test_nothing_leaks_through_a_thin_wall_in_many_short_steps(drop: float) -> None:
    wall = Box(x=(0.0113, 0.0114))
    problem = Problem(Walk(drop=drop), grid(x=(-1.0, 1.0, 10)), known=[wall])
    nominal = learn(problem, Grid(num_points=101))
    assert isinstance(nominal, GridNominal)
    values = nominal.backward(np.zeros((1, 1)))[0]
    before = nominal.grid.nodes()[:, 0] < 0.0113
    assert values[:, before].max() < 1e-4  # at most log 1: all rewards there are 0
    assert values[:, ~before].max() < drop + 1e-4
    free = values[0, nominal.grid.nodes()[:, 0] < -0.5]
    np.testing.assert_allclose(free, 0.0, atol=1e-4)


def test_known_predicate_is_the_same_as_the_box_it_describes() -> None:
    box = Box(x=(-0.22, 0.27))
    predicate = Predicate(
        "strip", lambda states: (states[..., 0] >= -0.22) & (states[..., 0] < 0.27)
    )
    start = Task(np.array([0.6, 0.3]), np.array([1.0, 0.0]))
    by_box, by_predicate = (
        sample(learn(short_cart(known=[c], between_states=False), Grid(61)), start, 500).samples
        for c in (box, predicate)
    )
    np.testing.assert_array_equal(by_box.violations, by_predicate.violations)
    np.testing.assert_array_equal(by_box.log_probability, by_predicate.log_probability)


def test_soft_value_at_the_start_is_log_partition() -> None:
    problem = short_pendulum()
    exact = enumerate_exactly(problem, PENDULUM_TASK.start, PENDULUM_TASK.goal)
    nominal = Grid().learn(problem)
    policy = next(nominal.policies(PENDULUM_TASK.goal[None]))
    assert isinstance(policy, GridPolicy)
    value = eqx.filter_jit(policy.soft_value)(
        jnp.asarray(PENDULUM_TASK.start, jnp.float32), jnp.int32(0), jnp.asarray(PENDULUM_TASK.goal)
    )
    assert float(value) == pytest.approx(exact.log_partition, abs=0.01)


def test_policy_is_a_distribution_that_never_enters_a_known_constraint() -> None:
    problem = short_cart(known=[Box(x=(0.0, 0.4))])
    policy = next(Grid(61).learn(problem).policies(CART_TASK.goal[None]))
    state = jnp.array([0.6, -0.2])
    log_probabilities = eqx.filter_jit(policy)(state, jnp.int32(0), jnp.asarray(CART_TASK.goal))
    probabilities = np.exp(log_probabilities)
    assert probabilities.sum() == pytest.approx(1.0, abs=1e-6)
    for action, probability in zip(problem.mdp.actions, probabilities, strict=True):
        following = problem.mdp.dynamics(state, action)
        entered = bool(problem.known[0].crosses(state, following, problem.mdp.space))
        assert entered == (probability == 0.0)
    assert 0 < np.count_nonzero(probabilities) < len(probabilities)


def test_values_stay_bounded_beside_a_cliff() -> None:
    """A cubic alone overshoots at the edge of a constraint and grows with every step."""
    mdp = Pendulum(max_torque=10.0, num_steps=100)
    problem = Problem(
        mdp, grid(theta=(0.0, 6.0, 3)), beta=0.67, known=[Box(theta=(3.14, 3.77), omega=(0.0, 1.2))]
    )
    nominal = learn(problem, Grid(num_points=(90, 181)))
    assert isinstance(nominal, GridNominal)
    values = nominal.backward(np.array([[2.0, 0.0]]))
    free = learn(dataclasses.replace(problem, known=()), Grid(num_points=(90, 181)))
    assert isinstance(free, GridNominal)
    assert values.max() <= free.backward(np.array([[2.0, 0.0]])).max() + 0.3


def test_goals_solved_together_are_the_same_as_alone() -> None:
    nominal = learn(short_pendulum(), Grid(num_points=(40, 61)))
    assert isinstance(nominal, GridNominal)
    goals = np.array([[4.0, -0.5], [1.0, 0.5], [0.1, 0.0]])
    together = nominal.backward(goals)
    for k in range(3):
        np.testing.assert_allclose(together[k], nominal.backward(goals[k : k + 1])[0], atol=1e-4)


def test_a_constant_added_to_the_reward_moves_only_log_partition() -> None:
    class Shifted(Pendulum):
        def terminal_reward(self, state, goal):
            return Pendulum.terminal_reward(self, state, goal) + 100.0

    plain = short_pendulum()
    shifted = dataclasses.replace(plain, mdp=Shifted(max_torque=3.0, dt=0.4, num_steps=6))
    a, b = (sample(learn(p), PENDULUM_TASK, 4000) for p in (plain, shifted))
    assert b.log_partition[0] - a.log_partition[0] == pytest.approx(100.0 * plain.beta, abs=0.02)
    np.testing.assert_allclose(a.violation_probability, b.violation_probability, atol=0.01)


def test_too_many_dimensions_are_refused() -> None:
    class Big(MDP):
        state_names = ("a", "b", "c", "d")
        action_names = ("u",)
        actions = jnp.zeros((1, 1))
        dt = 1.0
        num_steps = 2
        bounds = ((0.0, 1.0),) * 4

        def dynamics(self, state, action):
            return state

        def reward(self, state, action, next_state, goal):
            return jnp.zeros(())

    with pytest.raises(ValueError, match=r"at most 3 state dimensions, Big has 4 \(a, b, c, d\)"):
        learn(Problem(Big(), grid(a=(0.0, 1.0, 2))), "grid")


def test_too_fine_a_grid_is_refused_with_its_size() -> None:
    with pytest.raises(ValueError, match=r"20000 x 20000 nodes needs .* GiB .* fewer num_points"):
        learn(short_pendulum(), Grid(num_points=20_000))


@pytest.mark.parametrize(
    ("method", "where"),
    [
        ("terminal_reward", r"inf from state \[0\.0, 2\.\d+\] with goal \[0\.0, 0\.5\]"),
        ("reward", r"inf from state \[0\.0, 2\.\d+\] with action 0, \[-1\.0\], with goal"),
    ],
)
def test_rewards_that_are_not_finite_are_named(method: str, where: str) -> None:
    class Broken(Pendulum):
        pass

    def broken(self, state, *others):
        return jnp.where(state[1] > 2.0, jnp.inf, 0.0)

    setattr(Broken, method, broken)
    problem = Problem(Broken(num_steps=3), grid(theta=(0.0, 1.0, 2)), beta=1.0)
    nominal = Grid(num_points=12).learn(problem)
    with pytest.raises(ValueError, match=rf"Broken\.{method} returned {where}"):
        next(nominal.policies(np.array([[0.0, 0.5]])))
