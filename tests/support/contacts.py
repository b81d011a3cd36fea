"""Systems of one position and one speed whose motion is now and then cut off, and runs of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

import swerve
from swerve.demonstrations.demonstration import Demonstration


class Ball(swerve.MDP):
    """A ball that bounces from the floor without a loss."""

    state_names = ("y", "v")
    action_names = ("a",)
    dt, num_steps = 0.02, 120
    bounds = ((0.0, 10.0), (-10.0, 10.0))
    start = (4.0, 0.0)

    @property
    def actions(self):
        return jnp.linspace(-1.0, 1.0, 3)[:, None]

    def reward(self, state, action, next_state, goal):
        return -0.01 * action[0] ** 2

    def dynamics(self, state, action):
        v = state[1] + (action[0] - 9.81) * self.dt
        y = state[0] + v * self.dt
        return jnp.stack([jnp.abs(y), jnp.where(y < 0.0, -v, v)])


class Wall(Ball):
    """A cart that walls at both ends bring to rest."""

    bounds = ((0.0, 10.0), (-3.0, 3.0))
    start = (9.0, 1.5)

    def dynamics(self, state, action):
        v = state[1] + action[0] * self.dt
        y = state[0] + v * self.dt
        return jnp.stack([jnp.clip(y, 0.0, 10.0), jnp.where((y < 0.0) | (y > 10.0), 0.0, v)])


class Wrap(Wall):
    """A cart that goes on at 0 when it has come to 10."""

    start = (8.0, 2.0)

    def dynamics(self, state, action):
        v = state[1] + action[0] * self.dt
        y = state[0] + v * self.dt
        return jnp.stack([jnp.where(y > 10.0, y - 10.0, y), v])


def runs(mdp: Ball, num: int) -> list[Demonstration]:
    """Exact runs from the start of a system, with random actions that are held for a while."""
    generator, step = np.random.default_rng(0), jax.jit(mdp.dynamics)
    found = []
    for k in range(num):
        state, action = jnp.array(mdp.start), mdp.actions[0]
        states = [np.asarray(state, float)]
        for t in range(mdp.num_steps):
            if t % 25 == 0:
                action = mdp.actions[int(generator.integers(3))]
            state = step(state, action)
            states.append(np.asarray(state, float))
        times = mdp.dt * np.arange(len(states))
        task = swerve.Task(states[0], states[0])
        found.append(Demonstration(f"run_{k}", np.array(states), task, times))
    return found
