"""Roll out a policy in batches: trajectories with their reward and exact log-probability.

    log pi(xi) = sum_t log pi(a_t | s_t, t),    R(xi) = sum_t r(s_t, a_t, s_{t+1}) + r_T(s_L).

An action is sampled from one uniform number by inverting the cumulative distribution; the stored
log-probability is that of the executed action. The batch is the LAST axis of every array inside the
scan, so that a network's weights multiply [features, batch] matrices.

Shapes: N trajectories, T steps, n state dimensions, A actions, g goal dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from swerve.base.space import Actions
from swerve.constraints.base import Constraint, step_enters
from swerve.problem.boundary import actions_of, number
from swerve.problem.mdp import MDP
from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem

Policy = Callable[[Array, Array, Array], Array]
"""Maps one state [n], the step t and one goal [g] to log-probabilities [A]."""


class Trajectory(NamedTuple):
    """A batch of trajectories; a trajectory that has ended repeats its last state.

    Attributes:
      states: [T+1, n, N].
      actions: [T, N] index of the executed action.
      total_reward: [N] R(xi); -inf where a known constraint was entered.
      log_probability: [N] log pi(xi), nats.
      length: [N] steps taken.
    """

    states: Float[Array, "T+1 n N"]
    actions: Int[Array, "T N"]
    total_reward: Float[Array, " N"]
    log_probability: Float[Array, " N"]
    length: Int[Array, " N"]


class Step(NamedTuple):
    """The result of one action.

    Attributes:
      state: [n] the next state.
      reward: r(s, a, s'), with r_T where the episode ends; -inf on entering a known constraint.
      ended: whether the episode is over.
    """

    state: Float[Array, " n"]
    reward: Float[Array, ""]
    ended: Bool[Array, ""]


class _Carry(NamedTuple):
    state: Array
    total_reward: Array
    log_probability: Array
    length: Array
    ended: Array


def enters(
    known: Sequence[Constraint],
    state: Float[Array, " n"],
    next_state: Float[Array, " n"],
    mdp: MDP,
    between_states: bool,
    action: Float[Array, " m"] | None = None,
) -> Bool[Array, ""]:
    """Return whether a step enters one of the known constraints, see `step_enters`.

    Args:
      known: the known constraints.
      state: state in which the step begins.
      next_state: state in which the step ends.
      mdp: MDP that the states and actions belong to.
      between_states: whether the segment between the states counts as well.
      action: action of the step; without an action the states alone are judged.
    """
    taken = None if action is None else Actions(tuple(mdp.action_names), action)
    hit = jnp.zeros((), bool)
    for constraint in known:
        hit = hit | step_enters(constraint, state, next_state, mdp.space, between_states, taken)
    return hit


def take_step(
    problem: Problem, state: Float[Array, " n"], action: Any, step: Any, goal: Float[Array, " g"]
) -> Step:
    """Take one action, given by its index, in a state at step t."""
    mdp = problem.mdp
    torque = actions_of(mdp)[action]
    next_state = mdp.dynamics(state, torque)
    ended = mdp.terminated(next_state, goal) | (step == mdp.num_steps - 1)
    reward = mdp.reward(state, torque, next_state, goal)
    reward = reward + jnp.where(ended, mdp.terminal_reward(next_state, goal), 0.0)
    forbidden = enters(problem.known, state, next_state, mdp, problem.between_states, torque)
    return Step(next_state, jnp.where(forbidden, -jnp.inf, reward), ended | forbidden)


def sample_action(
    log_probabilities: Float[Array, " A"], uniform: Float[Array, ""]
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """Sample an action from one uniform number in [0, 1); return (index, its log-probability).

    An action of probability zero is never sampled: the last positive step of the cumulative sum
    lies above `uniform` times the total, whatever the rounding.
    """
    log_probabilities = number(log_probabilities, "policy")
    cumulative = jnp.cumsum(jnp.exp(log_probabilities))
    action = jnp.sum(uniform * cumulative[-1] >= cumulative[:-1], dtype=jnp.int32)
    return action, log_probabilities[action]


@of_problem
def rollout(
    problem: Problem,
    policy: Policy,
    start: Float[Array, "n *N"],
    goal: Float[Array, "g *N"],
    key: Key[Array, ""],
    num_trajectories: int,
) -> Trajectory:
    """Roll out a batch of trajectories, for one task or with a task for each trajectory.

    Args:
      problem: the MDP and known constraints.
      policy: log-probabilities of the actions for one state.
      start: [n] the start of all trajectories, or [n, N].
      goal: [g] the goal of all trajectories, or [g, N].
      key: source of randomness.
      num_trajectories: N, static.

    Returns:
      Trajectories, the batch on the last axis.
    """
    mdp, batch = problem.mdp, (num_trajectories,)
    start, goal = (
        jnp.broadcast_to(x if x.ndim == 2 else x[:, None], (x.shape[0], *batch))
        for x in (start, goal)
    )
    uniforms = jax.random.uniform(key, (mdp.num_steps, num_trajectories), jnp.float32)

    initial = _Carry(
        start,
        jnp.zeros(batch, jnp.float32),
        jnp.zeros(batch, jnp.float32),
        jnp.zeros(batch, jnp.int32),
        jnp.zeros(batch, bool),
    )
    advance = jax.vmap(partial(_advance, problem, policy), (-1, -1, None, -1), -1)
    final, (states, actions) = jax.lax.scan(
        lambda carry, x: advance(carry, goal, *x),
        initial,
        (jnp.arange(mdp.num_steps, dtype=jnp.int32), uniforms),
    )
    return Trajectory(
        jnp.concatenate([initial.state[None], states]),
        actions,
        final.total_reward,
        final.log_probability,
        final.length,
    )


def _advance(
    problem: Problem, policy: Policy, carry: _Carry, goal: Array, step: Array, uniform: Array
) -> tuple[_Carry, tuple[Array, Array]]:
    """Take one step of one trajectory unless it has ended; return its state and action."""
    action, log_probability = sample_action(policy(carry.state, step, goal), uniform)
    taken = take_step(problem, carry.state, action, step, goal)
    active = ~carry.ended
    state = jnp.where(active, taken.state, carry.state)
    carry = _Carry(
        state,
        carry.total_reward + jnp.where(active, taken.reward, 0.0),
        carry.log_probability + jnp.where(active, log_probability, 0.0),
        carry.length + active,
        carry.ended | taken.ended,
    )
    return carry, (state, action)
