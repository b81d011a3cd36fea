"""MDPs: names, defaults, integration, checks."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import Cart
from support.small_mdps import ANGLES, Bare, Height

from swerve import MDP, Pendulum, Problem, rk4
from swerve.base.space import TWO_PI
from swerve.problem.mdp import check_mdp


class OfClass(Bare):
    goal_names = ("height",)


class OfField(Bare):
    goal_names: tuple[str, ...] = eqx.field(default=("height",), static=True)


class OfArgument(Bare):
    goal_names: tuple[str, ...] = eqx.field(kw_only=True, static=True)


class OfInit(Bare):
    goal_names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self) -> None:
        self.goal_names = ("height",)


class Higher(OfField):
    climb: float = 1.0


class TestGoalNames:
    @pytest.mark.parametrize(
        "mdp",
        [OfClass(), OfField(), OfArgument(goal_names=("height",)), OfInit(), Height(), Higher()],
    )
    def test_may_be_given_in_any_way(self, mdp: MDP) -> None:
        """Pyright, which `make test` runs, accepts them all too."""
        assert mdp.goal_names == ("height",)
        assert Problem(mdp, ANGLES).record.goal_names == ("height",)

    def test_a_field_may_be_chosen_when_it_is_made(self) -> None:
        assert OfField(goal_names=("p", "q")).goal_names == ("p", "q")
        make: Any = OfArgument
        with pytest.raises(TypeError, match="goal_names"):
            make()

    def test_are_those_of_the_states_unless_given(self) -> None:
        assert Bare().goal_names == ("theta", "speed")
        assert Cart().goal_names == ("x", "v")
        with pytest.raises(AttributeError, match=r"Bare\.goal_names needs an instance"):
            _ = Bare.goal_names


class TestDefaults:
    def test_episodes_go_on_to_the_horizon_and_end_without_reward(self) -> None:
        mdp, state = Bare(), jnp.array([1.0, 2.0])
        assert mdp.terminated(state, state) == np.False_
        assert mdp.terminal_reward(state, state) == 0.0

    def test_the_goal_is_the_last_state(self) -> None:
        mdp, states = Bare(), np.arange(6.0).reshape(3, 2)
        assert mdp.goal_names == mdp.state_names
        np.testing.assert_array_equal(mdp.goal_of(states), [4.0, 5.0])
        np.testing.assert_array_equal(Height().goal_of(states), [5.0])

    def test_space(self) -> None:
        space = Bare().space
        assert (space.names, space.angles) == (("theta", "speed"), ("theta",))
        np.testing.assert_allclose(space.bounds, [[0.0, TWO_PI], [-1.0, 3.0]])
        assert Bare().num_actions == 3
        assert Cart().space.angles == ()

    def test_features_are_of_unit_scale_and_do_not_mind_whole_turns(self) -> None:
        mdp, goal = Bare(), jnp.array([2.0, 1.0])
        state = jnp.array([0.3, 2.0])
        features = mdp.features(state, jnp.array(1), goal)
        time = [0.75, math.sqrt(0.75)]
        expected = [
            *[0.5, math.sin(0.3), math.cos(0.3)],
            *time,
            *[0.0, math.sin(2.0), math.cos(2.0)],
            *[1.7 / math.pi, -0.5],
        ]
        np.testing.assert_allclose(features, expected, atol=1e-6)
        turned = mdp.features(state + jnp.array([TWO_PI, 0.0]), jnp.array(1), goal)
        np.testing.assert_allclose(turned, expected, atol=1e-5)

    def test_features_show_goals_that_are_no_states_as_they_are(self) -> None:
        features = Height().features(jnp.array([0.3, 2.0]), jnp.array(0), jnp.array([7.5]))
        expected = [0.5, math.sin(0.3), math.cos(0.3), 1.0, 1.0, 7.5]
        np.testing.assert_allclose(features, expected, atol=1e-6)

    def test_tasks_and_states_fill_the_bounds(self) -> None:
        mdp = Bare()
        keys = jax.random.split(jax.random.key(0), 2000)
        task = jax.vmap(mdp.sample_task)(keys)
        low, high = mdp.space.bounds.T
        for values in map(np.asarray, (*task, jax.vmap(mdp.sample_state)(keys))):
            assert values.shape == (2000, 2)
            assert ((values >= low) & (values <= high)).all()
            # the mean of a uniform distribution, to 5 standard errors
            off = (values.mean(axis=0) - (low + high) / 2) / (high - low)
            assert np.abs(off).max() < 5 / math.sqrt(12 * 2000)
            np.testing.assert_allclose(values.std(axis=0), (high - low) / math.sqrt(12), rtol=0.1)
        correlation = np.corrcoef(np.hstack(task), rowvar=False) - np.eye(4)
        assert np.abs(correlation).max() < 0.12

    def test_tasks_with_goals_that_are_no_states_have_to_be_defined(self) -> None:
        message = r"Height has goals \('height',\) that are not states: define sample_task"
        with pytest.raises(ValueError, match=message):
            Height().sample_task(jax.random.key(0))
        assert Height().sample_state(jax.random.key(0)).shape == (2,)

    def test_dynamics_and_reward_have_to_be_defined(self) -> None:
        class Still(MDP):
            state_names = ("x",)
            action_names = ("u",)
            actions = jnp.zeros((1, 1))
            dt = 1.0
            num_steps = 1
            bounds = ((0.0, 1.0),)

        kind: Any = Still
        with pytest.raises(TypeError, match="abstract"):
            kind()


class TestRk4:
    def test_is_the_taylor_series_to_fourth_order_on_linear_systems(self) -> None:
        matrix = np.array([[0.1, 1.0], [-2.0, -0.3]])
        h, state = 0.2, np.array([0.7, -0.4])
        series = sum(np.linalg.matrix_power(h * matrix, k) / math.factorial(k) for k in range(5))
        found = rk4(lambda s: jnp.asarray(matrix, jnp.float32) @ s, jnp.asarray(state), h)
        np.testing.assert_allclose(found, series @ state, rtol=2e-6)

    def test_follows_an_oscillator(self) -> None:
        """s'' = -s from (1, 0): (cos t, -sin t)."""
        state = jnp.array([1.0, 0.0])
        for _ in range(100):
            state = rk4(lambda s: jnp.stack([s[1], -s[0]]), state, 0.05)
        np.testing.assert_allclose(state, [math.cos(5.0), -math.sin(5.0)], atol=1e-5)

    def test_the_error_falls_with_the_fourth_power_of_the_step(self) -> None:
        """s' = s cos t with t' = 1: s = exp(sin t); in float64, so without JAX."""

        def error(num: int) -> float:
            state: Any = np.array([1.0, 0.0])
            for _ in range(num):
                state = rk4(lambda s: np.array([s[0] * math.cos(s[1]), 1.0]), state, 2.0 / num)
            return abs(state[0] - math.exp(math.sin(2.0)))

        assert math.log2(error(20) / error(40)) == pytest.approx(4.0, abs=0.25)
        assert error(40) < 1e-5

    def test_the_pendulum_conserves_its_energy(self) -> None:
        mdp = Pendulum()
        energy = lambda s: 0.5 * float(s[1]) ** 2 + math.cos(float(s[0]))  # noqa: E731
        start = state = jnp.array([2.0, 0.5])
        step = jax.jit(mdp.dynamics)
        for _ in range(300):
            state = step(state, jnp.zeros(1))
        assert energy(state) == pytest.approx(energy(start), abs=1e-4)
        assert abs(float(state[0]) - 2.0) > 0.1


def nan(*_: Any) -> Any:
    return jnp.array(jnp.nan)


class TestCheck:
    def test_accepts_what_is_right(self) -> None:
        for mdp in (Bare(), Height(), Cart(), Pendulum()):
            check_mdp(mdp)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"actions": jnp.zeros(3)}, r"actions: expected shape \[A, 2\], .*, got \(3,\)"),
            ({"actions": jnp.zeros((3, 1))}, r"actions: .*action_names \('a', 'b'\), got \(3, 1\)"),
            ({"actions": jnp.zeros((0, 2))}, r"actions: expected shape \[A, 2\], .*, got \(0, 2\)"),
            ({"actions": jnp.array([[0.0, jnp.inf]])}, r"actions: .* finite .*, got \[\[0.0, inf"),
            ({"dt": 0.0}, "dt: expected a positive number of seconds, got 0.0"),
            ({"dt": math.nan}, "dt: expected a positive number of seconds, got nan"),
            ({"num_steps": 0}, "num_steps: expected a whole number >= 1, got 0"),
            ({"num_steps": 2.5}, "num_steps: expected a whole number >= 1, got 2.5"),
            ({"action_names": "ab"}, r"action_names: expected a tuple of names .*, got 'ab'"),
            (
                {"dynamics": lambda self, state: state},
                r"dynamics\(state, action\): expected a function .* raised TypeError: .*takes 2",
            ),
            (
                {
                    "dynamics": lambda self, state, action: (
                        np.array(state) if state[0] > 9 else state
                    )
                },
                r"dynamics: .* JAX can trace.*; .*test_mdp\.py, line \d+: use jnp.where, not",
            ),
            (
                {"terminated": lambda self, state, goal: 0.3 + 0.0 * state[0]},
                r"terminated: expected True or False, got 0.3\d* of float32",
            ),
            (
                {"dynamics": lambda self, state, action: state[:1]},
                r"dynamics\(state, action\): expected shape \(2,\), got \(1,\)",
            ),
            (
                {"dynamics": lambda self, state, action: jnp.log(-jnp.abs(state))},
                r"dynamics\(state, action\): expected finite .* at the centre of the bounds, state",
            ),
            (
                {"reward": lambda self, state, action, next_state, goal: action},
                r"reward\(state, action, next_state, goal\): expected shape \(\), got \(2,\)",
            ),
            ({"reward": nan}, r"reward\(.*\): expected finite numbers, got nan"),
            ({"terminal_reward": nan}, r"terminal_reward\(state, goal\): expected finite numbers"),
            (
                {"terminated": lambda self, state, goal: state > goal},
                r"terminated\(state, goal\): expected shape \(\), got \(2,\)",
            ),
        ],
    )
    def test_names_the_class_and_what_is_wrong(self, changes: dict, message: str) -> None:
        wrong = type("Wrong", (Bare,), changes)()
        with pytest.raises(ValueError, match=f"^Wrong.{message}"):
            check_mdp(wrong)
        with pytest.raises(ValueError, match=f"^Wrong.{message}"):
            Problem(wrong, ANGLES)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"bounds": ((0.0, 1.0),)}, r"bounds: expected shape \(2, 2\)"),
            ({"bounds": ((0.0, 1.0), (1.0, 1.0))}, "bounds: expected finite low < high"),
            ({"angles": ("phi",)}, "no state named 'phi'; the states are theta, speed"),
        ],
    )
    def test_a_space_that_is_wrong_is_refused(self, changes: dict, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            check_mdp(type("Wrong", (Bare,), changes)())

    def test_a_goal_that_is_no_state_has_its_own_length(self) -> None:
        class Goals(Height):
            @property
            def goal_names(self) -> tuple[str, ...]:
                return ("p", "q", "r")

            def reward(self, state, action, next_state, goal):
                return goal[2] - goal[0]

        check_mdp(Goals())
