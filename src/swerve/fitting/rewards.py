"""Work out total rewards of demonstrations, and their divergence from a constrained distribution.

    R(xi) = sum_t r(s_t, a_t, s_{t+1}) + r_T(s_L)

Shapes: M demonstrations, L states of one, n state dimensions, m action dimensions.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve.demonstrations.checks import check_finite, check_horizon, check_transitions, row_namer
from swerve.demonstrations.demonstration import Demonstration
from swerve.problem.mdp import MDP
from swerve.problem.problem import Problem
from swerve.systems.tabular import TabularMDP

DIGITS = 9  # decimals in which two demonstrations must agree to count as the same
ON_TIME = 1e-3  # of a step: rows as close as this to the MDP's time steps are not interpolated


def total_rewards(problem: Problem, demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Return the total rewards R_i [M] of demonstrations, at the MDP's time step.

    A demonstration whose times are not the MDP's is interpolated: states change linearly between
    rows, angles along their shorter arc, and an action is held until the next. The last state is
    kept, and the number of steps is the nearest to the demonstration's duration. Rows after the end
    of the episode do not count. Without times, each row is a step.

    Raises:
      ValueError: if a demonstration lacks actions, takes more steps than the horizon, or has a
        total reward that is not finite.
    """
    mdp, earned = problem.mdp, []
    for demonstration in demonstrations:
        is_stepped = isinstance(mdp, TabularMDP)
        steps = demonstration if is_stepped else _until_end(mdp, _at_steps(mdp, demonstration))
        earned.append(total_reward(mdp, steps, taken_actions(mdp, steps)))
        if not math.isfinite(earned[-1]):
            raise ValueError(
                f"{steps.name}: expected a finite total reward, got {earned[-1]}: correct the "
                "demonstration, or the rewards of the MDP"
            )
    return np.array(earned)


def taken_actions(mdp: MDP, demonstration: Demonstration) -> np.ndarray:
    """Return the actions [L-1, m] of a demonstration.

    Actions in a tabular MDP are checked against its transitions. Where the demonstration has no
    actions and only one action makes each of its steps, these actions are returned.

    Raises:
      ValueError: if actions are missing and cannot be found, or a step is impossible.
    """
    name, states, actions = demonstration.name, demonstration.states, demonstration.actions
    if isinstance(mdp, TabularMDP):
        return _tabular_actions(mdp, demonstration)
    check_horizon(len(states) - 1, mdp.num_steps, name)
    if actions is None or actions.shape[1] != len(mdp.action_names):
        raise ValueError(
            f"{name}: expected actions {', '.join(mdp.action_names)}, got "
            f"{'none' if actions is None else f'{actions.shape[1]} of them'}: the total reward "
            "depends on them"
        )
    actions = actions[: len(states) - 1]
    check_finite(actions, mdp.action_names, row_namer(name, None))
    return actions


def _tabular_actions(mdp: TabularMDP, demonstration: Demonstration) -> np.ndarray:
    """Return the actions [L-1, m] of a demonstration until it rests in its last state."""
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
    """Return the number of states up to the end of the episode, after which the state repeats.

    Raises:
      ValueError: if the demonstration goes on to another state after the end.
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


def divergence(
    problem: Problem, demonstrations: Sequence[Demonstration], log_partition: np.ndarray
) -> float:
    """Return KL(demonstrations || pi_C) in nats per demonstration.

        KL = sum p log p - mean [beta R + log m] + mean log Z_C,

    where p is the frequency of a distinct demonstration among the demonstrations of its task.

    Args:
      problem: dynamics and reward.
      demonstrations: demonstrations with actions; of a tabular MDP, states may be enough.
      log_partition: [M] log Z_C of the task of each demonstration, nats.

    Raises:
      ValueError: if there is not one log Z_C for each demonstration, or a demonstration lacks
        actions, or has a step that the MDP does not allow.
    """
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    log_partition = np.asarray(log_partition, float)
    if log_partition.shape != (len(demonstrations),):
        raise ValueError(
            f"log_partition: expected one number for each of {len(demonstrations)} demonstrations, "
            f"log Z_C of its task, got shape {log_partition.shape}"
        )
    log_measure = -math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
    tasks, paths, terms = [], [], []
    for demonstration, value in zip(demonstrations, log_partition, strict=True):
        actions = taken_actions(problem.mdp, demonstration)
        reward = total_reward(problem.mdp, demonstration, actions)
        terms.append(value - problem.beta * reward - log_measure * len(actions))
        tasks.append(_key(*demonstration.task))
        paths.append((tasks[-1], _key(demonstration.states, actions)))
    of_task, of_path = Counter(tasks), Counter(paths)
    log_share = [math.log(of_path[path] / of_task[path[0]]) for path in paths]
    return float(np.mean(log_share) + np.mean(terms))


def _key(*arrays: np.ndarray) -> bytes:
    """Return a key that is the same for arrays that are equal up to rounding."""
    return np.concatenate([np.round(a, DIGITS).ravel() + 0.0 for a in arrays]).tobytes()


def _at_steps(mdp: MDP, demonstration: Demonstration) -> Demonstration:
    """Return a demonstration with a row for each time step of the MDP; see `total_rewards`."""
    if demonstration.times is None:
        return demonstration
    states, elapsed = demonstration.states, demonstration.times - demonstration.times[0]
    wanted = mdp.dt * np.arange(max(1, round(elapsed[-1] / mdp.dt)) + 1)
    wanted[-1] = elapsed[-1]
    if len(wanted) == len(elapsed) and np.abs(wanted - elapsed).max() < ON_TIME * mdp.dt:
        return demonstration
    changes = mdp.space.difference(states[:-1], states[1:])
    path = states[0] + np.concatenate([np.zeros_like(states[:1]), changes.cumsum(axis=0)])
    columns = [np.interp(wanted, elapsed, column) for column in path.T]
    actions = demonstration.actions
    if actions is not None:
        begun = np.searchsorted(elapsed, wanted[:-1] + ON_TIME * mdp.dt, side="right") - 1
        actions = actions[np.minimum(begun, len(states) - 2)]
    return dataclasses.replace(
        demonstration, states=np.stack(columns, axis=1), times=wanted, actions=actions
    )


def _until_end(mdp: MDP, demonstration: Demonstration) -> Demonstration:
    """Return a demonstration without the rows after the end of its episode."""
    states, goal = (
        jnp.asarray(x, jnp.float32) for x in (demonstration.states, demonstration.task.goal)
    )
    ended = np.asarray(jax.vmap(mdp.terminated, (0, None))(states[1:], goal))
    if not ended.any():
        return demonstration
    length = int(ended.argmax()) + 1
    actions = demonstration.actions
    return dataclasses.replace(
        demonstration,
        states=demonstration.states[: length + 1],
        times=None,
        actions=None if actions is None else actions[:length],
    )


def _only_way(fits: np.ndarray, demonstration: Demonstration) -> np.ndarray:
    """Return the only action [L-1] that makes each step; `fits` [L-1, A] tells which actions do.

    Raises:
      ValueError: if several actions make a step.
    """
    several = np.flatnonzero(fits.sum(axis=1) > 1)
    if len(several):
        step = int(several[0])
        raise ValueError(
            f"{demonstration.name}: step {step + 1} from {demonstration.states[step].tolist()} can "
            "be made by several actions: the demonstration needs its actions"
        )
    return fits.argmax(axis=1)
