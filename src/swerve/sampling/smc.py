"""Twisted sequential Monte Carlo: trajectories of a policy with a value, resampled on the way.

A particle begins with the log-weight V_0(s_0). Each step adds to its log-weight

    beta r + log m + V_{t+1}(s') - V_t(s) - log pi(a | s, t),

which is 0 if V is exact and pi is the policy of V. V is 0 where the episode has ended. Where the
effective sample size of an island's weights w falls below half of its P particles, the particles
are resampled by weight (systematic resampling) and all weigh alike afterwards. With the means of w
before each resampling and at the end,

    log Z_0 ~ sum log mean w,        E[prod mean w] = Z_0.

Islands are independent of one another, so that their spread is the error of the estimate. Each
particle's ancestors are stored, and followed back once, at the end.

Shapes: N = I P particles in I islands, T steps, n state dimensions, g goal dimensions. The batch is
the last axis of every array.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem
from swerve.simulation.policies import LOWEST, ValuedPolicy, log_measure
from swerve.simulation.trajectory import Trajectory, sample_action, take_step

RESAMPLED = 0.5  # share of its particles: an island with fewer effective ones is resampled


class Particles(NamedTuple):
    """Trajectories, and their weights after resampling.

    Attributes:
      trajectory: N of them, followed back to the start.
      log_weight: [N] log of the weight of each, nats: the mean weight of an island's particles is
        an unbiased estimate of Z_0.
      root: [N] number, within its island, of the particle at the start that each comes from.
    """

    trajectory: Trajectory
    log_weight: Float[Array, " N"]
    root: Int[Array, " N"]


class _Particle(NamedTuple):
    """Particles at one time, all [..., N].

    Attributes:
      root: number, within its island, of the particle at the start that each comes from.
      log_weight: log-weight gained since the last resampling, nats.
      owed: part of the log-weight that the last step adds, still without the value of the state
        that the step led to, nats.
    """

    state: Array
    total_reward: Array
    log_probability: Array
    length: Array
    ended: Array
    root: Array
    log_weight: Array
    owed: Array


@of_problem
def smc_rollout(
    policy: ValuedPolicy,
    start: Float[Array, " n"],
    goal: Float[Array, " g"],
    key: Key[Array, ""],
    num_islands: int,
    num_particles: int,
) -> Particles:
    """Roll out islands of particles of one task.

    Args:
      policy: proposes the actions, with a soft value.
      start: start of all particles.
      goal: goal of all particles.
      key: source of randomness.
      num_islands: I, static.
      num_particles: P of an island, static.

    Returns:
      N = I P particles, island by island.
    """
    num_steps, num = policy.problem.mdp.num_steps, num_islands * num_particles
    key_actions, key_resampling = jax.random.split(key)
    uniforms = jax.random.uniform(key_actions, (num_steps, num), jnp.float32)
    offsets = jax.random.uniform(key_resampling, (num_steps, num_islands), jnp.float32)
    first = _at_start(start, num_islands, num_particles)
    propose = jax.vmap(policy.propose, (-1, None, None), -1)
    move = jax.vmap(partial(_move, policy.problem, policy.beta), (-1, -1, None, None, -1), -1)

    def advance(carry: tuple[_Particle, Array], x: tuple) -> tuple[tuple[_Particle, Array], tuple]:
        (particles, log_mean), (step, uniform, offset) = carry, x
        proposed = propose(particles.state, step, goal)
        proposed = (proposed[0], jnp.maximum(proposed[1], LOWEST))
        gain = particles.owed + jnp.where(particles.ended, 0.0, proposed[1])
        particles = particles._replace(log_weight=particles.log_weight + gain)
        particles, proposed, mean, ancestor = _resampled(particles, proposed, offset)
        particles, action = move(particles, proposed, step, goal, uniform)
        return (particles, log_mean + mean), (particles.state, action, ancestor)

    initial = (first, jnp.zeros(num_islands, jnp.float32))
    (last, log_mean), history = jax.lax.scan(
        advance, initial, (jnp.arange(num_steps, dtype=jnp.int32), uniforms, offsets)
    )
    states, actions = _followed_back(*history)
    states = jnp.concatenate([first.state[None], states])
    trajectory = Trajectory(states, actions, last.total_reward, last.log_probability, last.length)
    log_weight = last.log_weight + last.owed + jnp.repeat(log_mean, num_particles)
    return Particles(trajectory, log_weight, last.root)


def _at_start(start: Float[Array, " n"], num_islands: int, num_particles: int) -> _Particle:
    """Return particles that are at the start, each its own root."""
    num = num_islands * num_particles
    zeros = jnp.zeros(num, jnp.float32)
    return _Particle(
        state=jnp.broadcast_to(start[:, None], (len(start), num)),
        total_reward=zeros,
        log_probability=zeros,
        length=jnp.zeros(num, jnp.int32),
        ended=jnp.zeros(num, bool),
        root=jnp.tile(jnp.arange(num_particles, dtype=jnp.int32), num_islands),
        log_weight=zeros,
        owed=zeros,
    )


def _move(
    problem: Problem,
    beta: float | Float[Array, ""],
    particle: _Particle,
    proposed: tuple[Array, Array],
    step: Array,
    goal: Array,
    uniform: Array,
) -> tuple[_Particle, Array]:
    """Take one step with one particle, unless its episode has ended; return the action too."""
    log_probabilities, value = proposed
    action, log_probability = sample_action(log_probabilities, uniform)
    taken = take_step(problem, particle.state, action, step, goal)
    allowed = ~jnp.isneginf(taken.reward)
    reward = jnp.where(allowed, beta * taken.reward, -jnp.inf)
    per_step = log_measure(problem)
    active = ~particle.ended
    moved = particle._replace(
        state=jnp.where(active, taken.state, particle.state),
        total_reward=particle.total_reward + jnp.where(active, taken.reward, 0.0),
        log_probability=particle.log_probability + jnp.where(active, log_probability, 0.0),
        length=particle.length + active,
        ended=particle.ended | taken.ended,
        owed=jnp.where(active, reward - per_step - value - log_probability, 0.0),
    )
    return moved, action


def _resampled(
    particles: _Particle, proposed: tuple[Array, Array], offset: Float[Array, " I"]
) -> tuple[_Particle, tuple[Array, Array], Float[Array, " I"], Int[Array, " N"]]:
    """Resample the islands whose effective sample size is too low.

    Returns:
      The particles, the action probabilities and value proposed to each, the log-mean of the
      weights of each island that was resampled [nats], 0 for others, and each particle's ancestor.
    """
    islands = particles.log_weight.reshape(len(offset), -1)
    num_islands, num_particles = islands.shape
    largest = islands.max(axis=1, keepdims=True)
    weight = jnp.exp(islands - jnp.where(jnp.isneginf(largest), 0.0, largest))
    total = weight.sum(axis=1)
    effective = total**2 / jnp.maximum((weight**2).sum(axis=1), 1e-30)
    needed = (effective < RESAMPLED * num_particles) & (total > 0.0)
    itself = jnp.arange(num_islands * num_particles, dtype=jnp.int32)

    def resample(particles: _Particle, proposed: tuple[Array, Array]) -> tuple:
        chosen = jax.vmap(_systematic)(weight, offset)
        first = num_particles * jnp.arange(num_islands, dtype=jnp.int32)[:, None]
        ancestor = jnp.where(needed[:, None], first + chosen, itself.reshape(islands.shape))
        ancestor = ancestor.reshape(-1)
        log_weight = jnp.where(needed[:, None], 0.0, islands).reshape(-1)
        particles, proposed = jax.tree.map(lambda x: x[..., ancestor], (particles, proposed))
        log_mean = jnp.where(needed, jnp.log(total / num_particles) + largest[:, 0], 0.0)
        return particles._replace(log_weight=log_weight), proposed, log_mean, ancestor

    def keep(particles: _Particle, proposed: tuple[Array, Array]) -> tuple:
        return particles, proposed, jnp.zeros(num_islands, jnp.float32), itself

    return jax.lax.cond(needed.any(), resample, keep, particles, proposed)


def _systematic(weight: Float[Array, " P"], offset: Float[Array, ""]) -> Int[Array, " P"]:
    """Return P indices sampled by weight: even steps through the sum, from one uniform number."""
    num = len(weight)
    cumulative = jnp.cumsum(weight)
    points = (jnp.arange(num, dtype=jnp.float32) + offset) / num * cumulative[-1]
    return jnp.minimum(jnp.searchsorted(cumulative, points, side="right"), num - 1)


def _followed_back(
    states: Float[Array, "T n N"], actions: Int[Array, "T N"], ancestors: Int[Array, "T N"]
) -> tuple[Float[Array, "T n N"], Int[Array, "T N"]]:
    """Return the states and actions that led to each particle at the end."""

    def back(index: Array, x: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        state, action, ancestor = x
        return ancestor[index], (state[:, index], action[index])

    last = jnp.arange(states.shape[-1], dtype=jnp.int32)
    return jax.lax.scan(back, last, (states, actions, ancestors), reverse=True)[1]
