"""Exact dynamic programming on a table of states: the tabular method of Scobee & Sastry (2019).

With m the base measure of a step and all rewards times beta, in nats,

    V_t(s) = log sum_a exp(r(s, a) + log m + V_{t+1}(s')),   r_T(s) at t = T and where it ended,
    pi_t(a | s) = exp(r(s, a) + log m + V_{t+1}(s') - V_t(s)),   log Z_0 = V_0(start).

The forward pass carries, for each hypothesis, the mass of the trajectories that have not entered
the hypothesis so far; the mass at the end is Z_c / Z_0. (The paper adds up the mass that has
entered. Z_c / Z_0 is the same, but here it keeps all its digits where hardly any trajectory avoids
the hypothesis.)

Shapes: S states, A actions, T steps, K hypotheses, M trajectories.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse


@dataclass(frozen=True, eq=False)
class Table:
    """A deterministic MDP with one goal, as tables in nats.

    Attributes:
      successors: [S, A] the state that an action leads to; any state if it is not allowed.
      reward: [S, A] beta r + log m of an action; -inf where the action is not allowed.
      terminal: [S] beta r_T; -inf where an episode must not end.
      ended: [S] whether an episode ends here before the horizon.
      num_steps: T.
    """

    successors: np.ndarray
    reward: np.ndarray
    terminal: np.ndarray
    ended: np.ndarray
    num_steps: int

    @cached_property
    def arrivals(self) -> Any:
        """[S, S * A] sparse: which steps lead to a state."""
        steps = np.arange(self.successors.size)
        places = (np.ones(len(steps)), (self.successors.ravel(), steps))
        return scipy.sparse.csr_matrix(places, shape=(len(self.terminal), len(steps)))

    @cached_property
    def values(self) -> np.ndarray:
        """[T+1, S] soft values V, nats; -inf where no trajectory from there is allowed."""
        values = np.empty((self.num_steps + 1, len(self.terminal)))
        values[-1] = self.terminal
        for step in range(self.num_steps - 1, -1, -1):
            action_values = self.reward + values[step + 1][self.successors]
            values[step] = np.where(self.ended, self.terminal, _log_sum_exp(action_values))
        return values

    def policy(self, step: int, states: Any = slice(None)) -> np.ndarray:
        """Return pi_t(a | s) [S, A] of all states or some; 0 where no trajectory goes on."""
        value = self.values[step, states]
        going = np.isfinite(value) & ~self.ended[states]
        ahead = self.reward[states] + self.values[step + 1][self.successors[states]]
        ahead -= np.where(going, value, 0.0)[:, None]
        return np.exp(ahead, out=ahead) * going[:, None]

    def avoid_probability(
        self, start: int, enters: np.ndarray, advance: Callable[[float], None]
    ) -> np.ndarray:
        """Return Z_c / Z_0 [K] for trajectories from a start.

        Args:
          start: number of a state from which trajectories are allowed.
          enters: [S * A, K] True where a step enters a hypothesis, at its ends or between.
          advance: called with the share done since the last call.
        """
        clean = np.zeros((len(self.terminal), enters.shape[1]))
        clean[start] = 1.0
        over = np.zeros(enters.shape[1])
        stays = ~enters
        for step in range(self.num_steps):
            over += clean[self.ended].sum(axis=0)
            clean[self.ended] = 0.0
            moved = (clean[:, None] * self.policy(step)[..., None]).reshape(stays.shape)
            clean = self.arrivals @ np.where(stays, moved, 0.0)
            advance(1.0 / self.num_steps)
        return over + clean.sum(axis=0)

    def sample(
        self, start: int, num: int, generator: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sample trajectories from pi_0.

        Returns:
          States [M, T+1] and actions [M, T], by number, and lengths [M]; after its end a trajectory
          repeats its last state.
        """
        states = np.full((num, self.num_steps + 1), start)
        actions = np.zeros((num, self.num_steps), int)
        length = np.zeros(num, int)
        for step in range(self.num_steps):
            now = states[:, step]
            cumulative = np.cumsum(self.policy(step, now), axis=1)
            point = generator.random((num, 1)) * cumulative[:, -1:]
            actions[:, step] = (point >= cumulative[:, :-1]).sum(axis=1)
            active = ~self.ended[now]
            following = self.successors[now, actions[:, step]]
            states[:, step + 1] = np.where(active, following, now)
            length += active
        return states, actions, length


def _log_sum_exp(values: np.ndarray) -> np.ndarray:
    """Return log sum exp [S] over the last axis of [S, A]; -inf where all values are."""
    largest = values.max(axis=-1)
    finite = np.where(np.isneginf(largest), 0.0, largest)
    with np.errstate(divide="ignore"):
        return finite + np.log(np.exp(values - finite[:, None]).sum(axis=-1))
