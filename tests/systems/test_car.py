"""The car: its dynamics by hand, where episodes end, and that solvers take it."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swerve import Car, Problem, Task, grid, infer, learn, sample
from swerve.demonstrations.demonstration import Demonstration
from swerve.systems.car import car


def drive(mdp: Car, state: list[float], action: list[float], num: int) -> np.ndarray:
    """Return the state after some steps of one action."""
    step = jax.jit(mdp.dynamics)
    now = jnp.array(state)
    for _ in range(num):
        now = step(now, jnp.array(action))
    return np.asarray(now)


def test_it_drives_circles_and_speeds_up() -> None:
    mdp = Car()
    turned = drive(mdp, [0.0, 0.0, 0.0, 1.0], [0.5, 0.0], 40)  # 2 s
    np.testing.assert_allclose(turned, [2 - 2 * math.cos(1), 2 * math.sin(1), 1, 1], atol=1e-5)
    faster = drive(mdp, [0.0, 1.0, 0.0, 1.0], [0.0, 1.0], 40)
    np.testing.assert_allclose(faster, [0.0, 5.0, 0.0, 3.0], atol=1e-5)


@pytest.mark.parametrize(
    ("state", "ends", "reward"),
    [
        ([0.1, 8.0, 0.0, 1.0], False, 0.0),
        ([0.1, 8.5, 0.0, 1.0], True, 100.0),
        ([0.21, 4.0, 0.0, 1.0], True, -100.0),
        ([-0.81, 9.0, 0.0, 1.0], True, -100.0),
    ],
)
def test_episodes_end_past_the_line_and_off_the_track(
    state: list[float], ends: bool, reward: float
) -> None:
    mdp, goal = Car(), jnp.zeros(0)
    assert bool(mdp.terminated(jnp.array(state), goal)) is ends
    assert float(mdp.terminal_reward(jnp.array(state), goal)) == reward


def test_being_off_the_middle_is_charged_by_the_second() -> None:
    mdp, goal = Car(), jnp.zeros(0)
    state, action = jnp.array([-0.3, 6.5, 0.0, 1.0]), mdp.actions[0]
    reward = float(mdp.reward(state, action, state, goal))
    assert reward == pytest.approx(-(100 * 0.3 + 0.05 * 2.0) * 0.05)


def test_it_is_as_in_the_paper() -> None:
    problem = car(beta=200.0)
    assert len(problem.hypotheses) == 28
    assert problem.mdp.num_actions == 9
    assert problem.mdp.num_steps == 500
    starts = jax.vmap(problem.mdp.sample_task)(jax.random.split(jax.random.key(0), 200)).start
    np.testing.assert_allclose(starts.mean(axis=0), [0.0, 0.0, 0.0, 1.0], atol=0.05)
    assert (np.abs(starts[:, 0]) < 0.2).all()


def test_a_short_drive_is_enumerated() -> None:
    """A coarse car, and a demonstration whose goal nobody names."""
    problem = Problem(Car(dt=0.7, num_steps=5), grid(x=(-0.8, 0.2, 2), y=(0.0, 8.5, 4)), beta=0.02)
    task = Task([0.0, 4.0, 0.0, 1.5], [])
    evidence = sample(learn(problem, "enumeration"), task)
    probability = evidence.violation_probability[0]
    assert np.count_nonzero((probability > 0.1) & (probability < 0.9)) >= 2
    assert problem.mdp.goal_of(np.zeros((3, 4))).shape == (0,)
    path = np.array([[0.0, 4.0, 0.0, 1.5], [0.1, 5.0, 0.1, 1.5]])
    assert len(infer(evidence, [Demonstration("drive", path, task)]).ranking)
