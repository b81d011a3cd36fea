"""Each hypothesis is resolved by random numbers of its own."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from swerve import MDP, Box, Demonstration, Problem, Task, infer, learn, resolve, sample

TASK = Task([0.0], [3.0])
STAYS = Demonstration("stays", np.zeros((2, 1)), TASK)


class Drawn(MDP):
    """Steps to the left and to the right, drawn to the goal."""

    state_names = ("x",)
    action_names = ("dx",)
    actions = jnp.array([[-0.53], [0.0], [0.61]])
    bounds = ((-5.0, 5.0),)
    dt = 1.0
    num_steps = 6

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return -0.3 * action[0] ** 2

    def terminal_reward(self, state, goal):
        return -2.0 * (state[0] - goal[0]) ** 2


def test_equal_hypotheses_have_errors_of_their_own() -> None:
    """From the same random numbers, both would be off by the same; the posterior adds errors."""
    problem = Problem(Drawn(), [Box(x=(0.8, 5.0)), Box(x=(0.8, 5.0)), Box(x=(4.0, 5.0))])
    nominal = learn(problem, "grid?num_points=15")
    evidence = sample(nominal, TASK, 400)
    inference = infer(evidence, [STAYS])
    assert inference.is_open[0].tolist() == [True, True, False]
    found = resolve(nominal, inference)
    assert found.is_resolved[0].tolist() == [True, True, False]
    first, second = found.log_ratio[0, :2]
    error = found.standard_error[0, 0]
    assert 1e-4 < error < 0.09
    assert 1e-2 * error < abs(first - second) < 5.0 * error
