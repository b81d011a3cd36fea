"""Continue trajectories from any state at any step under a nominal policy.

The rest of a trajectory, from step t on, has a log-weight relative to the policy's value,

    l = sum_{k >= t} (beta r + log m - log pi) - V_t(s_t),

which is 0 for the exact V and its policy. For a policy without a value l = 0, as if the policy were
exact.

Shapes: N trajectories, T steps, n state dimensions, g goal dimensions.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem
from swerve.simulation.policies import LOWEST, ValuedPolicy, is_open, log_measure
from swerve.simulation.trajectory import Policy, sample_action, take_step


class Continuation(NamedTuple):
    """The rest of N trajectories; rows before the first step and after the end repeat a state.

    Attributes:
      states: [T+1, n, N].
      log_weight: [T+1, N] l of the rest from each step on, nats; -inf where the rest enters a
        known constraint.
    """

    states: Float[Array, "T+1 n N"]
    log_weight: Float[Array, "T+1 N"]


@of_problem
def continued(
    problem: Problem,
    policy: Policy,
    starts: Float[Array, "n N"],
    first: Int[Array, ""],
    goal: Float[Array, " g"],
    key: Key[Array, ""],
) -> Continuation:
    """Continue trajectories from states at a step to the end of the episode.

    Args:
      problem: the MDP, beta, the measure and the known constraints.
      policy: policy that chooses the actions.
      starts: states from which trajectories go on.
      first: t, the step at which all trajectories go on.
      goal: goal of all trajectories.
      key: source of randomness.
    """
    num_steps, num = problem.mdp.num_steps, starts.shape[1]
    advance = jax.vmap(partial(_advance, problem, policy), (-1, -1, None, None, -1), -1)

    def body(step: Array, carry: tuple) -> tuple:
        state, ended, states, gains, values = carry
        uniforms = jax.random.uniform(jax.random.fold_in(key, step), (num,), jnp.float32)
        moved, now_ended, gain, value = advance(state, ended, step, goal, uniforms)
        states = states.at[step + 1].set(moved)
        return moved, now_ended, states, gains.at[step].set(gain), values.at[step].set(value)

    ended = jax.vmap(problem.mdp.terminated, (-1, None))(starts, goal)
    states = jnp.broadcast_to(starts, (num_steps + 1, *starts.shape))
    zeros = jnp.zeros((num_steps + 1, num), jnp.float32)
    initial = (starts, ended, states, zeros, zeros)
    *_, states, gains, values = jax.lax.fori_loop(first, num_steps, body, initial)
    if not isinstance(policy, ValuedPolicy):
        gains = jnp.where(jnp.isneginf(gains), gains, 0.0)
    left = jnp.cumsum(gains[::-1], axis=0)[::-1]
    return Continuation(states, left - values)


def _advance(
    problem: Problem,
    policy: Policy,
    state: Array,
    ended: Array,
    step: Array,
    goal: Array,
    uniform: Array,
) -> tuple[Array, Array, Array, Array]:
    """Take one step unless the trajectory has ended.

    Returns:
      The next state, whether the trajectory has ended, the step's beta r + log m - log pi [nats],
      and V before the step [nats].
    """
    if isinstance(policy, ValuedPolicy):
        (log_probabilities, value), beta = policy.propose(state, step, goal), policy.beta
        value = jnp.where(is_open(value), value, LOWEST)  # sums with less would lose their digits
    else:
        log_probabilities, value = policy(state, step, goal), jnp.float32(0.0)
        beta = problem.beta
    action, log_probability = sample_action(log_probabilities, uniform)
    taken = take_step(problem, state, action, step, goal)
    forbidden = jnp.isneginf(taken.reward)
    gain = beta * jnp.where(forbidden, 0.0, taken.reward) - log_measure(problem) - log_probability
    return (
        jnp.where(ended, state, taken.state),
        ended | taken.ended,
        jnp.where(ended, 0.0, jnp.where(forbidden, -jnp.inf, gain)),
        jnp.where(ended, 0.0, value),
    )
