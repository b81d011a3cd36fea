"""MDPs with the least that an MDP has to define."""

from __future__ import annotations

import jax.numpy as jnp

from swerve import MDP, grid
from swerve.base.space import TWO_PI

CELLS = grid(x=(-1.5, 1.5, 6), v=(-2.0, 2.0, 4))
ANGLES = grid(theta=(0.0, TWO_PI, 4))


class Bare(MDP):
    """Only what has to be there."""

    push: float = 1.0
    state_names = ("theta", "speed")
    action_names = ("a", "b")
    actions = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    dt = 0.5
    num_steps = 4
    bounds = ((0.0, TWO_PI), (-1.0, 3.0))
    angles = ("theta",)

    def dynamics(self, state, action):
        return state + self.push * action

    def reward(self, state, action, next_state, goal):
        return -jnp.sum(action)


class Height(Bare):
    """Its goal is a number that is no state."""

    @property
    def goal_names(self) -> tuple[str, ...]:
        return ("height",)

    def goal_of(self, states):
        return states[-1:, 1]


class Stroll(MDP):
    """Steps to the left and to the right, the longer ones at a cost; `pull` draws to the goal."""

    pull: float = 0.0
    state_names = ("x",)
    action_names = ("dx",)
    actions = jnp.array([[-0.42], [0.0], [0.57]])
    bounds = ((-4.0, 4.0),)
    dt = 1.0
    num_steps = 6

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return -0.4 * action[0] ** 2

    def terminal_reward(self, state, goal):
        return -self.pull * (state[0] - goal[0]) ** 2
