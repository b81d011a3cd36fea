"""The double pendulum: its dynamics against conserved energy and small swings."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swerve import DoublePendulum, Problem, Task, grid, learn, sample
from swerve.systems.double_pendulum import double_pendulum


def swing(mdp: DoublePendulum, state: list[float], torque: float, num: int) -> np.ndarray:
    """Return the states [num + 1, 4] under one torque."""
    step = jax.jit(mdp.dynamics)
    states = [jnp.array(state)]
    for _ in range(num):
        states.append(step(states[-1], jnp.array([torque])))
    return np.array(states, float)


def energy(states: np.ndarray) -> np.ndarray:
    first, second, speed, other = states.T
    kinetic = speed**2 + 0.5 * other**2 + speed * other * np.cos(first - second)
    return kinetic - 2.0 * np.cos(first) - np.cos(second)


def test_energy_is_kept_without_a_torque_and_gained_by_its_work() -> None:
    mdp = DoublePendulum()
    free = energy(swing(mdp, [1.0, -0.5, 0.7, -1.2], 0.0, 100))
    np.testing.assert_allclose(free, free[0], atol=1e-4)
    states = swing(mdp, [1.0, -0.5, 0.7, -1.2], 1.5, 100)
    work = 1.5 * (states[:, 0] - states[0, 0])
    np.testing.assert_allclose(energy(states) - energy(states)[0], work, atol=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_small_swings_have_their_two_frequencies(sign: float) -> None:
    """Both bobs in phase or in opposition, theta_2 = +-sqrt(2) theta_1, omega^2 = 2 -+ sqrt(2)."""
    mdp, small = DoublePendulum(), 0.01
    start = [small, sign * math.sqrt(2.0) * small, 0.0, 0.0]
    states = swing(mdp, start, 0.0, 100)
    times = mdp.dt * np.arange(101)
    expected = small * np.cos(math.sqrt(2.0 - sign * math.sqrt(2.0)) * times)
    np.testing.assert_allclose(states[:, 0], expected, atol=2e-5)


@pytest.mark.parametrize("whole_turns", [0.0, 2.0 * math.pi])
def test_features_tell_what_small_swings_miss_the_goal_by(whole_turns: float) -> None:
    """In both modes at once, started with speed: nothing is missed where coasting ends."""
    mdp = DoublePendulum()
    states = swing(mdp, [0.01, -0.004, 0.006, 0.008], 0.0, 60)
    goal = jnp.array(states[60], jnp.float32)
    start = jnp.array(states[0] + [whole_turns, 0.0, 0.0, 0.0], jnp.float32)
    features = mdp.features(start, jnp.array(mdp.num_steps - 60), goal)
    assert features.shape == (32,)
    np.testing.assert_allclose(features[18:22], 0.0, atol=2e-5)
    elsewhere = mdp.features(start, jnp.array(mdp.num_steps - 30), goal)
    assert np.abs(elsewhere[18:22]).max() > 1e-3


def test_solvers_take_it() -> None:
    assert len(double_pendulum().hypotheses) == 100
    mdp = DoublePendulum(max_torque=2.0, num_torques=3, dt=0.4, num_steps=6)
    cells = grid(theta_1=(-1.5, 1.5, 6), theta_2=(-1.5, 1.5, 6))
    problem = Problem(mdp, cells, beta=0.1)
    evidence = sample(learn(problem, "enumeration"), Task([0.5, -0.5, 0, 0], [0.0, 0.3, 0, 0]))
    probability = evidence.violation_probability[0]
    assert np.count_nonzero((probability > 0.1) & (probability < 0.9)) >= 5
