"""Trajectories of a policy: steps, rewards, ends, known constraints."""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import CART_TASK, PENDULUM_TASK, Cart, short_cart, short_pendulum

from swerve import Box, Grid, Predicate, Problem, Task, grid, learn, rk4, sample
from swerve.constraints.base import violates
from swerve.problem.mdp import MDP
from swerve.simulation.trajectory import enters, rollout, take_step

NUM = 500
STANDARD_ERRORS = 4.5


class Linear(eqx.Module):
    """A policy whose logits are linear in state, goal and time."""

    weights: jax.Array
    gain: float = 0.5

    def __call__(self, state, step, goal):
        inputs = jnp.concatenate([state, goal, jnp.stack([0.1 * step, 1.0])])
        return jax.nn.log_softmax(self.gain * self.weights @ inputs)

    def log_probabilities(self, state: np.ndarray, step: int, goal: np.ndarray) -> np.ndarray:
        """The same in NumPy and float64, for states [N, n]."""
        rest = np.concatenate([goal, [0.1 * step, 1.0]])
        inputs = np.concatenate([state, np.tile(rest, (len(state), 1))], axis=1)
        logits = self.gain * inputs @ np.asarray(self.weights, float).T
        return logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))


class Fixed(eqx.Module):
    """A policy that is always the same."""

    log_probability: jax.Array

    def __call__(self, state, step, goal):
        return self.log_probability


def linear(problem: Problem, seed: int = 0) -> Linear:
    generator = np.random.default_rng(seed)
    inputs = 2 * len(problem.mdp.state_names) + 2
    return Linear(jnp.asarray(generator.normal(size=(problem.mdp.num_actions, inputs))))


def fixed(*probabilities: float) -> Fixed:
    with np.errstate(divide="ignore"):
        return Fixed(jnp.asarray(np.log(probabilities), jnp.float32))


class Rolled(NamedTuple):
    """A `Trajectory` of NumPy arrays."""

    states: np.ndarray
    actions: np.ndarray
    total_reward: np.ndarray
    log_probability: np.ndarray
    length: np.ndarray


def roll(problem: Problem, policy, task: Task, num: int = NUM, seed: int = 0) -> Rolled:
    """Roll out; policies are called with one state, the step and one goal."""
    found = rollout(
        problem,
        policy,
        jnp.asarray(task.start, jnp.float32),
        jnp.asarray(task.goal, jnp.float32),
        jax.random.key(seed),
        num,
    )
    return Rolled(**{name: np.asarray(array) for name, array in found._asdict().items()})


def cart_steps(actions: np.ndarray, task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States [T+1, 2, N], rewards and lengths [N] of carts, in NumPy and float64."""
    force = np.array([-1.0, 0.0, 1.0])[actions]
    x, v = (np.full(actions.shape[1], value) for value in task.start)
    states, total = [np.stack([x, v])], np.zeros(actions.shape[1])
    length, active = np.zeros(actions.shape[1], int), np.ones(actions.shape[1], bool)
    for step, push in enumerate(force):
        faster = v + 0.5 * push
        x, v = np.where(active, x + 0.5 * faster, x), np.where(active, faster, v)
        earned = -0.3 * push**2 - 0.2 * (x - task.goal[0]) ** 2
        off = np.abs(x) > 1.5
        ended = off | (step == len(force) - 1)
        earned = earned + ended * (np.where(off, -2.0, 0.0) - (x - task.goal[0]) ** 2)
        total, length = total + active * earned, length + active
        active = active & ~ended
        states.append(np.stack([x, v]))
    return np.stack(states), total, length


class TestRollout:
    @pytest.mark.parametrize(
        ("problem", "task"),
        [(short_pendulum(), PENDULUM_TASK), (short_cart(), CART_TASK)],
        ids=["pendulum", "cart"],
    )
    def test_log_probability_is_that_of_the_executed_actions(self, problem, task) -> None:
        policy = linear(problem)
        found = roll(problem, policy, task)
        expected = np.zeros(NUM)
        for step, actions in enumerate(found.actions):
            states = found.states[step].T.astype(float)
            each = policy.log_probabilities(states, step, np.asarray(task.goal))
            expected += np.where(step < found.length, each[np.arange(NUM), actions], 0.0)
        np.testing.assert_allclose(found.log_probability, expected, atol=1e-4)
        assert expected.std() > 0.5
        steps, names = problem.mdp.num_steps, problem.mdp.state_names
        assert found.states.shape == (steps + 1, len(names), NUM)
        assert found.actions.shape == (steps, NUM)

    def test_states_and_rewards_are_those_of_the_actions(self) -> None:
        problem = short_cart()
        task = Task(np.array([0.63, 0.3]), np.array([-0.5, 0.0]))  # 1.5 cannot be met exactly
        found = roll(problem, linear(problem), task)
        states, total, length = cart_steps(found.actions, task)
        np.testing.assert_allclose(found.states, states, atol=1e-5)
        np.testing.assert_allclose(found.total_reward, total, atol=1e-5)
        np.testing.assert_array_equal(found.length, length)
        # some leave the track, at different times, and some do not
        assert len(set(length)) >= 4
        assert 0.1 < (length == 7).mean() < 0.9

    def test_an_episode_that_ends_early_pays_once_and_rests(self) -> None:
        """Pushed right from 0.6 at 0.3: at 1.0, 1.65; -2 for leaving the track."""
        found = roll(short_cart(), fixed(0.0, 0.0, 1.0), CART_TASK, num=3)
        path = np.array([[0.6, 0.3], [1.0, 0.8], [1.65, 1.3]])
        expected = np.concatenate([path, np.repeat(path[-1:], 5, axis=0)])
        np.testing.assert_allclose(found.states, np.repeat(expected[..., None], 3, -1), atol=1e-6)
        reward = -0.3 - 0.2 * 1.5**2 - 0.3 - 0.2 * 2.15**2 - 2.0 - 2.15**2
        np.testing.assert_allclose(found.total_reward, reward, rtol=1e-6)
        np.testing.assert_array_equal(found.length, 2)
        np.testing.assert_array_equal(found.log_probability, 0.0)

    def test_an_episode_that_lasts_pays_at_the_horizon(self) -> None:
        task = Task(np.array([0.25, 0.0]), np.array([-0.5, 0.0]))
        found = roll(short_cart(), fixed(0.0, 1.0, 0.0), task, num=2)
        np.testing.assert_array_equal(found.length, 7)
        np.testing.assert_allclose(found.total_reward, -7 * 0.2 * 0.75**2 - 0.75**2, rtol=1e-6)
        np.testing.assert_allclose(found.states[-1], [[0.25, 0.25], [0.0, 0.0]], atol=1e-7)

    def test_frequencies_are_those_of_the_policy_at_every_step(self) -> None:
        """Steps and lanes are independent too."""
        probabilities = np.array([0.1, 0.0, 0.2, 0.3, 0.4])
        problem, num = short_pendulum(), 4000
        found = roll(problem, fixed(*probabilities), PENDULUM_TASK, num)
        taken = found.actions[..., None] == np.arange(5)
        error = np.sqrt(probabilities * (1 - probabilities) / num)
        assert (np.abs(taken.mean(axis=1) - probabilities) <= STANDARD_ERRORS * error).all()
        number = found.actions - found.actions.mean()
        correlation = np.corrcoef(number) - np.eye(6)
        assert np.abs(correlation).max() < STANDARD_ERRORS / math.sqrt(num)
        lanes = (number[:, :-1] * number[:, 1:]).mean() / number.var()
        assert abs(lanes) < STANDARD_ERRORS / math.sqrt(6 * num)

    def test_the_key_decides(self) -> None:
        problem = short_pendulum()
        policy = linear(problem)
        a, again, other = (roll(problem, policy, PENDULUM_TASK, seed=seed) for seed in (0, 0, 1))
        for x, y in zip(a, again, strict=True):
            np.testing.assert_array_equal(x, y)
        assert (a.actions != other.actions).mean() > 0.1


def between(states: np.ndarray, constraint, problem: Problem) -> np.ndarray:
    batch = np.moveaxis(states, -1, 0).astype(float)
    return violates(constraint, batch, problem.mdp.space, problem.between_states)


class TestKnownConstraints:
    @pytest.mark.parametrize("between_states", [True, False])
    def test_entering_one_costs_everything_and_ends_the_episode(self, between_states) -> None:
        # edges that no float32 state comes near
        walls = [Box(x=(-0.33, 0.07), v=(-0.45, 0.55)), Box(x=(0.92, 1.13))]
        free = short_cart(between_states=between_states)
        problem = short_cart(known=walls, between_states=between_states)
        policy = linear(free)
        a, b = roll(free, policy, CART_TASK), roll(problem, policy, CART_TASK)
        entered = np.any([between(a.states, wall, problem) for wall in walls], axis=0)
        assert 0.1 < entered.mean() < 0.9
        np.testing.assert_array_equal(b.total_reward == -np.inf, entered)
        # the others are as they were
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x[..., ~entered], y[..., ~entered])
        # those that entered have stopped where they did, at the first state or segment inside
        assert (b.length[entered] <= a.length[entered]).all()
        for n in np.flatnonzero(entered)[:60]:
            last = b.length[n]
            np.testing.assert_array_equal(b.states[: last + 1, :, n], a.states[: last + 1, :, n])
            np.testing.assert_array_equal(
                b.states[last:, :, n], np.repeat(b.states[last : last + 1, :, n], 8 - last, axis=0)
            )
            before = b.states[:last, :, n : n + 1]
            hit = [between(b.states[: last + 1, :, n : n + 1], wall, problem)[0] for wall in walls]
            assert any(hit)
            if last > 1:
                assert not any(between(before, wall, problem)[0] for wall in walls)

    def test_an_infinite_reward_of_a_forbidden_step_is_no_nan(self) -> None:
        class Cliff(Cart):
            def reward(self, state, action, next_state, goal):
                return jnp.log(1.0 - next_state[0])  # NaN beyond 1

        problem = Problem(Cliff(), grid(x=(-1.0, 1.0, 2)), known=[Box(x=(1.0, 9.0))])
        found = roll(problem, fixed(0.0, 0.0, 1.0), CART_TASK, num=2)
        np.testing.assert_array_equal(found.total_reward, -np.inf)

    @pytest.mark.parametrize(
        ("between_states", "expected"), [(True, [True, True, False]), (False, [False, True, False])]
    )
    def test_enters(self, between_states: bool, expected: list[bool]) -> None:
        mdp = Cart()
        strip = Predicate("strip", lambda states: abs(states[..., 0]) < 0.1)
        state = jnp.array([-1.0, 0.0])
        for known in ([Box(x=(-0.1, 0.1))], [strip], [Box(v=(2.0, 3.0)), strip]):
            found = [
                bool(enters(known, state, jnp.array([x, 0.0]), mdp, between_states))
                for x in (1.0, 0.0, -0.5)
            ]
            assert found == expected
        assert not enters((), state, state, mdp, between_states)


class TestTakeStep:
    def step(self, x: float, v: float, action: int, t: int, **settings):
        problem = short_cart(**settings)
        goal = jnp.array([-0.5, 0.0])
        return take_step(problem, jnp.array([x, v]), action, t, goal)

    def test_in_the_middle_of_an_episode(self) -> None:
        taken = self.step(0.0, 0.0, 2, 3)
        np.testing.assert_allclose(taken.state, [0.25, 0.5])
        assert float(taken.reward) == pytest.approx(-0.3 - 0.2 * 0.75**2)
        assert not taken.ended

    def test_the_last_step_pays_the_terminal_reward(self) -> None:
        taken = self.step(0.0, 0.0, 2, 6)
        assert float(taken.reward) == pytest.approx(-0.3 - 1.2 * 0.75**2)
        assert taken.ended

    @pytest.mark.parametrize("t", [0, 6])
    def test_leaving_the_track_pays_it_once(self, t: int) -> None:
        taken = self.step(1.4, 1.0, 1, t)
        assert float(taken.reward) == pytest.approx(-1.2 * 2.4**2 - 2.0)
        assert taken.ended

    def test_entering_a_known_constraint(self) -> None:
        for between_states in (True, False):
            settings = {"known": [Box(x=(0.5, 0.9))], "between_states": between_states}
            inside = self.step(0.4, 0.5, 1, 0, **settings)
            assert inside.reward == -jnp.inf
            assert inside.ended
            across = self.step(0.0, 2.0, 1, 0, **settings)
            assert (across.reward == -jnp.inf) == between_states
            assert across.ended == between_states


class Falling(MDP):
    """A mass with drag whose path is known: v = (v_0 + g/k) exp(-k t) - g/k."""

    state_names = ("height", "speed")
    action_names = ("none",)
    actions = jnp.zeros((1, 1))
    dt = 0.1
    num_steps = 30
    bounds = ((0.0, 100.0), (-20.0, 20.0))

    def dynamics(self, state, action):
        return rk4(lambda s: jnp.stack([s[1], -9.81 - 0.5 * s[1]]), state, self.dt)

    def reward(self, state, action, next_state, goal):
        return jnp.zeros(())


def test_rk4_in_a_rollout_follows_the_analytic_solution() -> None:
    problem = Problem(Falling(), grid(height=(0.0, 100.0, 2)))
    found = roll(problem, fixed(1.0), Task(np.array([90.0, 5.0]), np.zeros(2)), num=1)
    t = 0.1 * np.arange(31)
    terminal = 9.81 / 0.5
    speed = (5.0 + terminal) * np.exp(-0.5 * t) - terminal
    height = 90.0 + (5.0 + terminal) / 0.5 * (1.0 - np.exp(-0.5 * t)) - terminal * t
    np.testing.assert_allclose(found.states[:, 0, 0], height, atol=2e-4)
    np.testing.assert_allclose(found.states[:, 1, 0], speed, atol=1e-4)


def test_a_system_without_goals() -> None:
    class Aimless(Cart):
        goal_names = ()

        def reward(self, state, action, next_state, goal):
            return -(next_state[0] ** 2)

        def terminal_reward(self, state, goal):
            return jnp.zeros(())

        def sample_task(self, key):
            return Task(jax.random.uniform(key, (2,)), jnp.zeros(0))

    problem = Problem(Aimless(), grid(x=(-1.5, 1.5, 6)))
    task = Task(np.array([0.6, 0.3]), np.zeros(0))
    evidence = sample(learn(problem, Grid(num_points=41)), task, 500)
    assert evidence.effective_sample_size[0] > 400
    assert evidence.tasks.goal.shape == (1, 0)
