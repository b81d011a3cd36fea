"""Two routes past a wall, whose nominal masses are known: what samplers must find, and may miss.

A walker goes one to the right and at most one up or down a step, T = 8 of them. Half-way is a
known wall around the middle. All else is the mirror image of itself about the middle, but for a
toll that each path above pays once, so

    mass above : mass below = exp(-beta toll) : 1,    whatever the policy, measure or wall.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from swerve import MDP, Box, Problem, Task
from swerve.solvers.exact.tabular import Tabular
from swerve.systems.tabular import NOWHERE, TabularMDP

NUM_STEPS = 8
MIDDLE = 8.0
HEIGHT = 17  # nobody who starts in the middle leaves it
WALL = Box(x=(3.6, 4.4), y=(MIDDLE - 1.4, MIDDLE + 1.4))
ABOVE = Box(x=(3.5, 4.5), y=(MIDDLE, HEIGHT))
BELOW = Box(x=(3.5, 4.5), y=(-1.0, MIDDLE))
HYPOTHESES = [
    ABOVE,
    BELOW,
    *(Box(x=(x - 0.5, x + 0.5), y=(y - 0.5, y + 0.5)) for x in (2, 4, 6) for y in range(5, 12)),
]
TASK = Task(np.array([0.0, MIDDLE]), np.array([8.0, MIDDLE]))


class Routes(MDP):
    """The walker. All rewards are multiples of 1/8, exact in float32 if `toll` is.

    Attributes:
      toll: of the route above, paid on the step past x = 3.5.
    """

    toll: float = 0.0
    dt = 1.0
    num_steps = NUM_STEPS
    state_names = ("x", "y")
    action_names = ("dy",)
    bounds = ((-0.5, NUM_STEPS + 0.5), (-0.5, HEIGHT - 0.5))

    @property
    def actions(self):
        return jnp.array([[-1.0], [0.0], [1.0]])

    def dynamics(self, state, action):
        return state + jnp.stack([jnp.ones(()), action[0]])

    def reward(self, state, action, next_state, goal):
        pays = (state[0] < 3.5) & (next_state[0] >= 3.5) & (next_state[1] > MIDDLE)
        return -0.25 * action[0] ** 2 - jnp.where(pays, self.toll, 0.0)

    def terminal_reward(self, state, goal):
        return -0.125 * (state[1] - goal[1]) ** 2

    def sample_task(self, key):
        first, last = jax.random.uniform(key, (2,), minval=MIDDLE - 2.0, maxval=MIDDLE + 2.0)
        return Task(jnp.stack([0.0, first]), jnp.stack([1.0 * NUM_STEPS, last]))


class LatticeRoutes(TabularMDP):
    """The same as a table: the states where the walker can be."""

    toll: float = 0.0
    num_steps = NUM_STEPS
    state_names = ("x", "y")
    action_names = ("dy",)
    shape = (NUM_STEPS + 1, HEIGHT)
    actions = jnp.array([[-1.0], [0.0], [1.0]])

    @property
    def successors(self) -> np.ndarray:
        ahead = self.states[:, None] + np.array([[1, -1], [1, 0], [1, 1]])
        inside = ((ahead >= 0) & (ahead < self.shape)).all(axis=-1)
        return np.where(inside, ahead @ [1.0, NUM_STEPS + 1.0], NOWHERE).astype(int)

    @property
    def rewards(self) -> np.ndarray:
        x, y = self.states.T[:, :, None]
        dy = np.array([-1.0, 0.0, 1.0])
        return -0.25 * dy**2 - np.where((x == 3) & (y + dy > MIDDLE), self.toll, 0.0)

    def terminal_reward(self, state, goal):
        return Routes.terminal_reward(self, state, goal)  # pyright: ignore[reportArgumentType]


def routes(mdp: MDP, **settings: Any) -> Problem:
    """Return the problem of the wall that is known."""
    settings = {"known": [WALL]} | settings
    return Problem(mdp, HYPOTHESES, **settings)


def share_above(problem: Problem) -> float:
    """Return the mass of the route above."""
    assert isinstance(problem.mdp, Routes | LatticeRoutes)
    return 1.0 / (1.0 + math.exp(problem.beta * problem.mdp.toll))


class TablePolicy(eqx.Module):
    """Probabilities from a table [T, S, A]."""

    mdp: LatticeRoutes
    log_probabilities: Float[Array, "T S A"]

    def __call__(self, state: Array, step: Array, goal: Array) -> Array:
        return self.log_probabilities[step, self.mdp.state_index(state)]


@dataclass(frozen=True, eq=False)
class Planted:
    """A nominal of a problem, whose policy is exactly pi_0 of another that knows more.

    Attributes:
      problem: what trajectories are judged and weighed by.
      followed: what the policy is optimal for.
    """

    problem: Problem
    followed: Problem
    solver = Tabular()

    def arrays(self) -> dict[str, np.ndarray]:
        return {}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[TablePolicy]:
        mdp = self.followed.mdp
        assert isinstance(mdp, LatticeRoutes)
        for goal in goals:
            table = self.solver.learn(self.followed).goal_table(goal)
            policy = np.stack([table.policy(step) for step in range(mdp.num_steps)])
            with np.errstate(divide="ignore"):
                yield TablePolicy(mdp, jnp.asarray(np.log(policy), jnp.float32))
