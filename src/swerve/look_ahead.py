"""Policies that look one step ahead with a soft value.

With the value V of where each action leads, r_T in place of V where the episode ends,

    Q_t(s, a) = beta r(s, a, s') + V_{t+1}(s'),     pi(a | s, t) = exp Q_t(s, a) / sum_a exp Q_t,
    (B V)_t(s) = log mean_a exp Q_t(s, a)           (log sum for the counting measure),

so that along a path that pi draws

    sum_t [beta r + log m - log pi] + V(s_end) - V(s_0) = sum_t [(B V)_t(s_t) - V_t(s_t)]:

for the exact V, with B V = V, every path has the same weight, and pi is pi_0.

Shapes: n state dimensions, g goal dimensions, A actions.
"""

from __future__ import annotations

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from swerve.problem import Problem
from swerve.trajectory import take_step

FORBIDDEN = -1e9  # nats; finite, so that a state without a way out still has a policy


class LookAhead(eqx.Module):
    """The look-ahead policy of a soft value; subclasses provide the value.

    Attributes:
      problem: the MDP, beta, the measure and the known constraints.
    """

    problem: eqx.AbstractVar[Problem]

    @abc.abstractmethod
    def value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return V_t(s) [nats] of a state where the episode goes on."""

    def look(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " A"], Float[Array, " A"]]:
        """Return Q_t(s, a) and V_{t+1}(s') of every action [nats].

        Q is FORBIDDEN where the action is not allowed, V is 0 where the episode ends.
        """
        problem = self.problem

        def look(action: Array) -> tuple[Array, Array]:
            taken = take_step(problem, state, action, step, goal)
            ahead = jnp.where(taken.ended, 0.0, self.value(taken.state, step + 1, goal))
            forbidden = jnp.isneginf(taken.reward)
            reward = jnp.where(forbidden, 0.0, taken.reward)
            return jnp.where(forbidden, FORBIDDEN, problem.beta * reward + ahead), ahead

        return jax.vmap(look)(jnp.arange(problem.mdp.num_actions))

    def action_values(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return Q_t(s, a) for every action [nats], FORBIDDEN where it is not allowed."""
        return self.look(state, step, goal)[0]

    def __call__(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return log pi(a | state, step) for every action."""
        return jax.nn.log_softmax(self.action_values(state, step, goal))

    def soft_value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return (B V)_t(s), nats; that of a start at t = 0 is log Z_0 of the task."""
        total = jax.nn.logsumexp(self.action_values(state, step, goal))
        return total - log_measure(self.problem)


def log_measure(problem: Problem) -> float:
    """Return what the base measure takes off each step's log-sum: log A if uniform, else 0."""
    return math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
