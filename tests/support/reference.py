"""Slow, plain answers to hold the library against: every action sequence, one after another."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve import MDP, Pendulum, Problem, Task, grid
from swerve.base.space import Actions
from swerve.constraints.base import violates
from swerve.hypotheses.bits import unpack


class Exact(NamedTuple):
    """log Z_0, and for each hypothesis the probability of entering it."""

    log_partition: float
    violation_probability: np.ndarray


def enumerate_exactly(problem: Problem, start: np.ndarray, goal: np.ndarray) -> Exact:
    """Sum over all A^T action sequences; sequences that end early are counted once each."""
    mdp = problem.mdp
    sequences = np.array(list(itertools.product(range(mdp.num_actions), repeat=mdp.num_steps)))
    actions = np.asarray(mdp.actions)[sequences]
    dynamics = jax.jit(jax.vmap(mdp.dynamics))
    reward = jax.jit(jax.vmap(mdp.reward, (0, 0, 0, None)))
    terminal = jax.jit(jax.vmap(mdp.terminal_reward, (0, None)))
    terminated = jax.jit(jax.vmap(mdp.terminated, (0, None)))

    states = [np.repeat(np.asarray(start, np.float32)[None], len(sequences), 0)]
    active = np.ones(len(sequences), bool)
    total, length = np.zeros(len(sequences)), np.zeros(len(sequences), int)
    for step in range(mdp.num_steps):
        following = np.asarray(dynamics(states[-1], actions[:, step]))
        earned = np.asarray(reward(states[-1], actions[:, step], following, goal), np.float64)
        ended = np.asarray(terminated(following, goal)) | (step == mdp.num_steps - 1)
        earned = earned + np.where(ended, np.asarray(terminal(following, goal), np.float64), 0.0)
        total += np.where(active, earned, 0.0)
        length += active
        states.append(np.where(active[:, None], following, states[-1]))
        active &= ~ended
    path = np.stack(states, axis=1)
    after_end = np.arange(mdp.num_steps) >= length[:, None]
    taken = Actions(mdp.action_names, np.where(after_end[..., None], np.nan, actions))

    log_weight = problem.beta * total
    if problem.measure == "uniform":
        log_weight = log_weight - length * math.log(mdp.num_actions)
    # a sequence that ended early stands here once for every way to go on
    log_weight = log_weight - (mdp.num_steps - length) * math.log(mdp.num_actions)
    for constraint in problem.known:
        entered = violates(
            constraint, path.astype(np.float64), mdp.space, problem.between_states, taken
        )
        log_weight = np.where(entered, -np.inf, log_weight)
    largest = log_weight.max()
    weight = np.exp(log_weight - largest)
    bits = problem.hypotheses.violations(path, mdp.space, problem.between_states, taken)
    entered = unpack(bits, len(problem.hypotheses))
    return Exact(float(largest + np.log(weight.sum())), weight @ entered / weight.sum())


def short_pendulum(**settings: Any) -> Problem:
    """A pendulum that goes far in its 6 steps of 0.4 s: several cells are entered half the time."""
    mdp = Pendulum(max_torque=3.0, dt=0.4, num_steps=6)
    cells = grid(theta=(0.0, 2.0 * math.pi, 6), omega=(-4.0, 4.0, 5))
    settings = {"beta": 0.05} | settings
    return Problem(mdp, cells, **settings)


PENDULUM_TASK = Task(np.array([2.5, 0.5]), np.array([4.0, -0.5]))


class Cart(MDP):
    """A cart on a line that must not leave the track: the episode ends beyond either end."""

    dt: float = 0.5
    num_steps: int = eqx.field(default=7, static=True)
    state_names = ("x", "v")
    action_names = ("force",)
    bounds = ((-2.0, 2.0), (-3.0, 3.0))

    @property
    def actions(self):
        return jnp.array([[-1.0], [0.0], [1.0]])

    def dynamics(self, state, action):
        x, v = state
        v = v + self.dt * action[0]
        return jnp.stack([x + self.dt * v, v])

    def reward(self, state, action, next_state, goal):
        return -0.3 * action[0] ** 2 - 0.2 * (next_state[0] - goal[0]) ** 2

    def terminal_reward(self, state, goal):
        return jnp.where(jnp.abs(state[0]) > 1.5, -2.0, 0.0) - (state[0] - goal[0]) ** 2

    def terminated(self, state, goal):
        return jnp.abs(state[0]) > 1.5


def short_cart(**settings: Any) -> Problem:
    """The cart with hypotheses over position and speed."""
    cells = grid(x=(-1.5, 1.5, 6), v=(-2.0, 2.0, 4))
    return Problem(Cart(), cells, **settings)


CART_TASK = Task(np.array([0.6, 0.3]), np.array([-0.5, 0.0]))
