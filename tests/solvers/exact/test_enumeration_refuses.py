"""What enumeration refuses: too many sequences, bad sets, bad numbers."""

from __future__ import annotations

import math
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from support.enumerations import CART_NOMINAL, FAST, answer, nominal_of
from support.reference import CART_TASK, Cart, short_cart, short_pendulum

from swerve import ActionBox, Box, Pendulum, Problem, Task, grid, learn, sample
from swerve.solvers.exact.enumeration import Enumeration


def test_a_reward_of_minus_infinity_is_a_step_not_allowed() -> None:
    wall = Box(x=(-0.2, 0.3))

    class Fenced(Cart):
        def reward(self, state, action, next_state, goal):
            inside = wall.contains(next_state, self.space)
            return jnp.where(inside, -jnp.inf, Cart.reward(self, state, action, next_state, goal))

    settings = {"beta": 0.3, "between_states": False}
    cells = short_cart().hypotheses
    fenced = answer(Problem(Fenced(), cells, **settings), CART_TASK)
    walled = answer(Problem(Cart(), cells, known=[wall], **settings), CART_TASK)
    assert fenced.log_partition == pytest.approx(walled.log_partition, abs=1e-6)
    np.testing.assert_allclose(fenced.avoid_probability, walled.avoid_probability, atol=1e-7)


def test_nothing_is_allowed() -> None:
    problem = short_cart(known=[ActionBox(force=(-2.0, 2.0))])
    found = answer(problem, CART_TASK)
    assert found.log_partition == -math.inf
    assert np.isnan(found.avoid_probability).all()
    assert found.kept.states.shape == (0, 8, 2)
    assert found.kept.violations.shape == (0, 3)
    assert nominal_of(problem).log_partition(CART_TASK, [[]])[0] == -math.inf
    with pytest.raises(ValueError, match=r"no trajectory is allowed, log Z_0 = -inf"):
        sample(nominal_of(problem), CART_TASK)


def test_too_many_sequences_are_refused_with_their_number() -> None:
    problem = short_pendulum()
    assert Enumeration(max_sequences=5**6).check(problem) is None
    with pytest.raises(
        ValueError,
        match=r"would go through 5\^6 = 15,625 action sequences, at most 15,624 are allowed "
        r"\(max_sequences\): shorten num_steps, or use solver 'grid'",
    ):
        learn(problem, Enumeration(max_sequences=5**6 - 1))
    cells = problem.hypotheses
    with pytest.raises(ValueError, match=r"5\^300 = 10\^210 action .* at most 50,000,000 are"):
        learn(Problem(Pendulum(), cells), Enumeration())
    with pytest.raises(ValueError, match=r"5\^30 = 10\^21 .* at most 9,223,372,036,854,775,807"):
        learn(Problem(Pendulum(num_steps=30), cells), Enumeration(max_sequences=2**63 - 1))
    with pytest.raises(ValueError, match=r"5\^1000000000 = 10\^698970004 action sequences"):
        learn(Problem(Pendulum(num_steps=10**9), cells), Enumeration())


def test_another_solver_is_named_that_takes_the_dimensions() -> None:
    class Wide(Cart):
        state_names = ("x", "v", "y", "z")
        bounds = ((-1.0, 1.0),) * 4

        def dynamics(self, state, action):
            return state

    with pytest.raises(ValueError, match=r"3\^7 = 2,187 .* or use solver 'soft-value'"):
        learn(Problem(Wide(), grid(x=(-1.0, 1.0, 2))), Enumeration(max_sequences=100))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0, r"Enumeration: max_sequences: expected a whole number >= 1, got 0"),
        (1e6, r"Enumeration: max_sequences: expected a whole number >= 1, got 1000000\.0"),
        (2**63, r"max_sequences: expected at most 9,223,372,036,854,775,807, got 9,223.*808"),
    ],
)
def test_max_sequences_is_checked(value: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Enumeration(max_sequences=value)


@pytest.mark.parametrize(
    ("avoiding", "message"),
    [
        ([[0], [24]], r"avoiding\[1\]: expected indices from 0 to 23, got 24"),
        ([[-1]], r"avoiding\[0\]: expected a whole number >= 0, got -1"),
        ([[0.0]], r"avoiding\[0\]: expected a whole number >= 0, got 0\.0"),
        ([3, 4], r"avoiding\[0\]: expected a list of hypotheses, .* got 3"),
    ],
)
def test_sets_of_hypotheses_are_checked(avoiding: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CART_NOMINAL.log_partition(CART_TASK, avoiding)


def test_the_task_of_log_partition_is_checked() -> None:
    with pytest.raises(ValueError, match="task: expected a single one, got 2"):
        CART_NOMINAL.log_partition(Task.stack([CART_TASK, FAST]), [[0]])
    with pytest.raises(ValueError, match=r"expected a start of 2 numbers \(x, v\), got 1"):
        CART_NOMINAL.log_partition(Task(np.zeros(1), np.zeros(1)), [[0]])


class Broken(Cart):
    """The cart with one method that goes wrong where x > 1.1."""

    method: str = eqx.field(default="reward", static=True)
    value: float = math.nan

    def _spoilt(self, method, x, right):
        return jnp.where((x > 1.1) & (self.method == method), self.value, right)

    def dynamics(self, state, action):
        state = Cart.dynamics(self, state, action)
        return self._spoilt("dynamics", state[0], state)

    def reward(self, state, action, next_state, goal):
        right = Cart.reward(self, state, action, next_state, goal)
        return self._spoilt("reward", next_state[0], right)

    def terminal_reward(self, state, goal):
        return self._spoilt("terminal_reward", state[0], Cart.terminal_reward(self, state, goal))


@pytest.mark.parametrize(
    ("method", "value", "found"),
    [
        ("dynamics", math.nan, "[nan, nan]"),
        ("dynamics", math.inf, "[inf, inf]"),
        ("reward", math.nan, "nan"),
        ("reward", math.inf, "inf"),
        ("terminal_reward", math.nan, "nan"),
        ("terminal_reward", math.inf, "inf"),
    ],
)
def test_what_is_no_number_is_named(method: str, value: float, found: str) -> None:
    forward = ActionBox(force=(-2.0, -0.5))
    problem = Problem(Broken(method=method, value=value), grid(x=(-1.0, 1.0, 2)), known=[forward])
    state = r"\[1\.0, 0\.8\d*\]" if method == "terminal_reward" else r"\[0\.75\d*, 0\.3\d*\]"
    message = rf"Broken\.{method} returned {re.escape(found)} at step 1 from state {state} by "
    message += r"action \[1\.0\]"
    message += {
        "dynamics": r": expected finite numbers",
        "reward": r": expected a finite number, or -inf for what is not allowed",
        "terminal_reward": r" to state \[1\.6\d*, 1\.\d*\]: expected a finite number, or -inf",
    }[method]
    with pytest.raises(ValueError, match=message):
        answer(problem, CART_TASK)


def test_what_is_no_number_does_not_matter_where_it_is_forbidden() -> None:
    wall = Box(x=(1.1, 9.0))
    cells = short_cart().hypotheses
    broken, right = (
        answer(Problem(mdp, cells, known=[wall]), CART_TASK) for mdp in (Broken(), Cart())
    )
    assert broken.log_partition == pytest.approx(right.log_partition, abs=1e-6)
