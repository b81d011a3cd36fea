"""Define policies with a soft value, and policies that look one step ahead with a soft value.

With the value V of the state that each action leads to, or r_T where the episode ends,

    Q_t(s, a) = beta r(s, a, s') + V_{t+1}(s'),     pi(a | s, t) = exp Q_t(s, a) / sum_a exp Q_t,
    (B V)_t(s) = log mean_a exp Q_t(s, a)           (log sum for the counting measure),

so that along a path sampled from pi

    sum_t [beta r + log m - log pi] + V(s_end) - V(s_0) = sum_t [(B V)_t(s_t) - V_t(s_t)]:

for the exact V, with B V = V, every path has the same weight, and pi is pi_0.

Shapes: n state dimensions, g goal dimensions, A actions.
"""

from __future__ import annotations

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.trajectory import take_step

FORBIDDEN = -1e9  # nats, value of a forbidden action; finite, since all actions may be forbidden
CLOSED = -1e8  # nats, V of a closed state; above FORBIDDEN, since a coarse grid may miss a way out
LOWEST = -1e4  # nats, least value: sums with lower values would lose digits in float32


class ValuedPolicy(eqx.Module):
    """A policy with a soft value, as sequential Monte Carlo needs.

    Attributes:
      problem: the MDP, beta, the measure and the known constraints.
    """

    problem: eqx.AbstractVar[Problem]

    @property
    def beta(self) -> float | Float[Array, ""]:
        """Inverse temperature of the policy: the problem's beta unless overridden."""
        return self.problem.beta

    @abc.abstractmethod
    def propose(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " A"], Float[Array, ""]]:
        """Return log pi(a | s, t) of every action, and the policy's estimate of V_t(s) [nats]."""

    def __call__(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return log pi(a | s, t) of every action."""
        return self.propose(state, step, goal)[0]

    def soft_value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return the policy's estimate of V_t(s), nats; at the start of a task, V is log Z_0."""
        return self.propose(state, step, goal)[1]

    @property
    def least_value(self) -> float:
        """Soft values below this one [nats] stand for states that known constraints close in.

        Such a value is no estimate, and is never shown.
        """
        return CLOSED / 2


class LookAhead(ValuedPolicy):
    """The policy that looks one step ahead with a soft value V, which subclasses provide."""

    problem: eqx.AbstractVar[Problem]

    @abc.abstractmethod
    def value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return V_t(s) [nats] of a state in which the episode has not ended."""

    def action_values(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return Q_t(s, a) for every action [nats], FORBIDDEN where the action is not allowed."""
        problem = self.problem

        def look(action: Array) -> Array:
            taken = take_step(problem, state, action, step, goal)
            ahead = jnp.where(taken.ended, 0.0, self.value(taken.state, step + 1, goal))
            forbidden = jnp.isneginf(taken.reward)
            reward = jnp.where(forbidden, 0.0, taken.reward)
            return jnp.where(forbidden, FORBIDDEN, self.beta * reward + ahead)

        return jax.vmap(look)(jnp.arange(problem.mdp.num_actions, dtype=jnp.int32))

    def propose(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " A"], Float[Array, ""]]:
        """Return log pi(a | s, t) of every action, and (B V)_t(s) [nats]."""
        return self.backed_up(self.action_values(state, step, goal))

    def backed_up(
        self, action_values: Float[Array, " A"]
    ) -> tuple[Float[Array, " A"], Float[Array, ""]]:
        """Return log pi(a | s, t) of every action, and (B V)_t(s) [nats], from action values."""
        total = jax.nn.logsumexp(action_values)
        return action_values - total, total - log_measure(self.problem)


def is_open(values: Any) -> Any:
    """Return where a value belongs to an open state, from which some step is allowed."""
    return values > CLOSED / 2


def log_measure(problem: Problem) -> float:
    """Return -log m of each step under the base measure: log A if uniform, else 0."""
    return math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
