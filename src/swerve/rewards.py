"""What a demonstration earned: R(xi) = sum_t r(s_t, a_t, s_{t+1}) + r_T(s_L).

Shapes: L states of a demonstration, n state dimensions, m action dimensions.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve.demonstrations import Demonstration
from swerve.mdp import MDP
from swerve.state_checks import check_horizon, check_transitions
from swerve.systems.tabular import TabularMDP


def taken_actions(mdp: MDP, demonstration: Demonstration) -> np.ndarray:
    """Return the actions [L-1, m] of a demonstration.

    Those of a tabular MDP are checked against its transitions, or found from them where the
    demonstration names none and each of its steps can only be made in one way.

    Raises:
      ValueError: if actions are not there and cannot be found, or a step is impossible.
    """
    name, states, actions = demonstration.name, demonstration.states, demonstration.actions
    if isinstance(mdp, TabularMDP):
        return _tabular_actions(mdp, demonstration)
    check_horizon(len(states) - 1, mdp.num_steps, name)
    if actions is None:
        raise ValueError(
            f"{name}: expected actions {', '.join(mdp.action_names)}, got none: what a "
            "demonstration earned depends on them"
        )
    return actions[: len(states) - 1]


def _tabular_actions(mdp: TabularMDP, demonstration: Demonstration) -> np.ndarray:
    """Return the actions [L-1, m] of a demonstration up to where it rests."""
    actions, transitions = demonstration.actions, mdp.transitions
    states = demonstration.states[: _num_before_rest(mdp, demonstration)]
    check_transitions(states, actions, transitions, demonstration.name)
    fits = transitions.fits(states)
    num_moves = np.flatnonzero(fits.any(axis=1)).max(initial=-1) + 1
    check_horizon(num_moves, mdp.num_steps, demonstration.name)
    if actions is not None:
        return actions[:num_moves]
    return transitions.actions[_only_way(fits[:num_moves], demonstration)]


def _num_before_rest(mdp: TabularMDP, demonstration: Demonstration) -> int:
    """Return how many states there are until the episode has ended and its last state is repeated.

    Raises:
      ValueError: if it goes on elsewhere after its end.
    """
    number = mdp.transitions.number(demonstration.states)
    _, ends = _at_states(mdp, jnp.asarray(demonstration.task.goal, jnp.float32))
    ended = np.flatnonzero(np.asarray(ends)[number])
    if not len(ended):
        return len(number)
    if (number[ended[0] :] != number[ended[0]]).any():
        raise ValueError(
            f"{demonstration.name}: the episode has ended in state {ended[0]} (counted from 0), "
            "and yet the demonstration goes on"
        )
    return int(ended[0]) + 1


@eqx.filter_jit
def _at_states(mdp: TabularMDP, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return r_T [S] and whether episodes end [S] at the states of a tabular MDP."""
    states = jnp.asarray(mdp.states, jnp.float32)
    terminal = jax.vmap(mdp.terminal_reward, (0, None))(states, goal)
    return terminal, jax.vmap(mdp.terminated, (0, None))(states, goal)


def total_reward(mdp: MDP, demonstration: Demonstration, actions: np.ndarray) -> float:
    """Return R(xi) of a demonstration that took the actions of `taken_actions`."""
    states = demonstration.states[: len(actions) + 1]
    goal = jnp.asarray(demonstration.task.goal, jnp.float32)
    if isinstance(mdp, TabularMDP):
        number = mdp.transitions.number(states)
        end = np.asarray(_at_states(mdp, goal)[0], float)[number[-1]]
        return float(mdp.rewards[number[:-1], mdp.action_index(actions)].sum() + end)
    end = float(mdp.terminal_reward(jnp.asarray(states[-1], jnp.float32), goal))
    path, taken = jnp.asarray(states, jnp.float32), jnp.asarray(actions, jnp.float32)
    steps = jax.vmap(mdp.reward, (0, 0, 0, None))(path[:-1], taken, path[1:], goal)
    return float(np.asarray(steps, float).sum()) + end


def _only_way(fits: np.ndarray, demonstration: Demonstration) -> np.ndarray:
    """Return the action [L-1] that alone makes each step, from what fits [L-1, A]."""
    several = np.flatnonzero(fits.sum(axis=1) > 1)
    if len(several):
        step = int(several[0])
        raise ValueError(
            f"{demonstration.name}: step {step + 1} from {demonstration.states[step].tolist()} can "
            "be made by several actions: the demonstration needs its actions"
        )
    return fits.argmax(axis=1)
