"""Twisted sequential Monte Carlo: trajectories of a look-ahead policy, resampled as they go.

A particle that follows the look-ahead policy of a value V gains in weight, at each step,

    beta r + log m + V(s') - V(s) - log pi = (B V)_t(s_t) - V_t(s_t),

nothing for the exact V. Where the effective sample size of an island's weights w falls below half
of its P particles, these are drawn anew by weight (systematic resampling) and weigh alike; with
the means of w before each of these times and at the end,

    log Z_0 ~ sum log mean w,        E[exp of it] = Z_0.

Islands have nothing to do with one another: how far they agree is how far they can be trusted.
Ancestry is kept, and followed back once, at the end.

Shapes: N = I P particles in I islands, T steps, n state dimensions, g goal dimensions. The batch is
the last axis of every array.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from swerve.look_ahead import LookAhead, log_measure
from swerve.trajectory import Trajectory, draw_action, take_step

RESAMPLED = 0.5  # of an island's particles: where fewer are effective, it is resampled


class Particles(NamedTuple):
    """Trajectories with what resampling did to their weights.

    Attributes:
      trajectory: N of them, followed back to the start.
      log_weight: [N] log of the weight of each, nats: the mean over an island's particles of its
        exponential is an unbiased estimate of Z_0.
      root: [N] which of its island's particles each comes from.
    """

    trajectory: Trajectory
    log_weight: Float[Array, " N"]
    root: Int[Array, " N"]


class _Carry(NamedTuple):
    """Particles at one time; all [..., N] but the last.

    Attributes:
      value: V_t(s_t) as the step before saw it; 0 at the start.
      log_weight: gained since the last resampling, nats.
      log_mean: [I] log of the product of the means of weights so far, nats.
    """

    state: Array
    value: Array
    total_reward: Array
    log_probability: Array
    length: Array
    ended: Array
    root: Array
    log_weight: Array
    log_mean: Array


@eqx.filter_jit
def smc_rollout(
    policy: LookAhead,
    start: Float[Array, " n"],
    goal: Float[Array, " g"],
    key: Key[Array, ""],
    num_islands: int,
    num_particles: int,
) -> Particles:
    """Roll out islands of particles of one task.

    Args:
      policy: what proposes, and weighs.
      start: where all start.
      goal: of all.
      key: source of randomness.
      num_islands: I, static.
      num_particles: P of an island, static.

    Returns:
      N = I P particles; those of an island follow one another.
    """
    mdp, num = policy.problem.mdp, num_islands * num_particles
    key_actions, key_resampling = jax.random.split(key)
    uniforms = jax.random.uniform(key_actions, (mdp.num_steps, num))
    offsets = jax.random.uniform(key_resampling, (mdp.num_steps, num_islands))
    zeros = jnp.zeros(num)
    initial = _Carry(
        state=jnp.broadcast_to(start[:, None], (len(start), num)),
        value=zeros,
        total_reward=zeros,
        log_probability=zeros,
        length=jnp.zeros(num, jnp.int32),
        ended=jnp.zeros(num, bool),
        root=jnp.tile(jnp.arange(num_particles), num_islands),
        log_weight=zeros,
        log_mean=jnp.zeros(num_islands),
    )

    def advance(carry: _Carry, x: tuple) -> tuple[_Carry, tuple]:
        step, uniform, offset = x
        carry, action = _step(policy, carry, step, goal, uniform)
        state = carry.state
        carry, ancestor = _resampled(carry, offset, step < mdp.num_steps - 1)
        return carry, (state, action, ancestor)

    final, history = jax.lax.scan(advance, initial, (jnp.arange(mdp.num_steps), uniforms, offsets))
    states, actions = _followed_back(*history)
    states = jnp.concatenate([initial.state[None], states])
    trajectory = Trajectory(
        states, actions, final.total_reward, final.log_probability, final.length
    )
    log_weight = final.log_weight + jnp.repeat(final.log_mean, num_particles)
    return Particles(trajectory, log_weight, final.root)


def _step(
    policy: LookAhead, carry: _Carry, step: Array, goal: Array, uniform: Array
) -> tuple[_Carry, Array]:
    """Take one step of all particles, none of those that have ended; return their actions too."""
    problem = policy.problem

    def one(state: Array, value: Array, uniform: Array) -> tuple:
        action_values, ahead = policy.look(state, step, goal)
        action, log_probability = draw_action(jax.nn.log_softmax(action_values), uniform)
        taken = take_step(problem, state, action, step, goal)
        gain = jax.nn.logsumexp(action_values) - log_measure(problem) - value
        gain = jnp.where(jnp.isneginf(taken.reward), -jnp.inf, gain)
        return action, log_probability, gain, ahead[action], taken

    axes = (-1, -1, -1)
    action, log_probability, gain, ahead, taken = jax.vmap(one, axes, -1)(
        carry.state, carry.value, uniform
    )
    active = ~carry.ended
    moved = carry._replace(
        state=jnp.where(active, taken.state, carry.state),
        value=jnp.where(active, ahead, carry.value),
        total_reward=carry.total_reward + jnp.where(active, taken.reward, 0.0),
        log_probability=carry.log_probability + jnp.where(active, log_probability, 0.0),
        length=carry.length + active,
        ended=carry.ended | taken.ended,
        log_weight=carry.log_weight + jnp.where(active, gain, 0.0),
    )
    return moved, action


def _resampled(carry: _Carry, offset: Array, goes_on: Array) -> tuple[_Carry, Array]:
    """Resample the islands that need it; return each particle's ancestor too."""
    islands = carry.log_weight.reshape(len(carry.log_mean), -1)
    num_islands, num_particles = islands.shape
    largest = islands.max(axis=1, keepdims=True)
    weight = jnp.exp(islands - jnp.where(jnp.isneginf(largest), 0.0, largest))
    total = weight.sum(axis=1)
    effective = total**2 / jnp.maximum((weight**2).sum(axis=1), 1e-30)
    needed = (effective < RESAMPLED * num_particles) & (total > 0.0) & goes_on
    itself = jnp.arange(num_islands * num_particles)

    def resample(carry: _Carry) -> tuple[_Carry, Array]:
        chosen = jax.vmap(_systematic)(weight, offset)
        first = num_particles * jnp.arange(num_islands)[:, None]
        ancestor = jnp.where(needed[:, None], first + chosen, itself.reshape(islands.shape))
        ancestor = ancestor.reshape(-1)
        drawn = {
            name: column[..., ancestor]
            for name, column in carry._asdict().items()
            if name != "log_mean"
        }
        mean = jnp.log(total / num_particles) + largest[:, 0]
        drawn["log_weight"] = jnp.where(needed[:, None], 0.0, islands).reshape(-1)
        drawn["log_mean"] = carry.log_mean + jnp.where(needed, mean, 0.0)
        return _Carry(**drawn), ancestor

    return jax.lax.cond(needed.any(), resample, lambda carry: (carry, itself), carry)


def _systematic(weight: Float[Array, " P"], offset: Float[Array, ""]) -> Int[Array, " P"]:
    """Return P indices drawn by weight from one uniform number, by even steps through their sum."""
    num = len(weight)
    cumulative = jnp.cumsum(weight)
    points = (jnp.arange(num) + offset) / num * cumulative[-1]
    return jnp.minimum(jnp.searchsorted(cumulative, points, side="right"), num - 1)


def _followed_back(
    states: Float[Array, "T n N"], actions: Int[Array, "T N"], ancestors: Int[Array, "T N"]
) -> tuple[Float[Array, "T n N"], Int[Array, "T N"]]:
    """Return the states and actions that led to each particle at the end."""

    def back(index: Array, x: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        state, action, ancestor = x
        index = ancestor[index]
        return index, (state[:, index], action[index])

    last = jnp.arange(states.shape[-1])
    return jax.lax.scan(back, last, (states, actions, ancestors), reverse=True)[1]
