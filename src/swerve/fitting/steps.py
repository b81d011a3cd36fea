"""Find the steps of the model that a demonstration took: what actions and rewards are read from.

A demonstration may be recorded at any rate and go on after its end. A trajectory of the model is a
state for each step of dt seconds, and one action between two states, until its episode ends:

    s_0, a_0, s_1, ..., s_L.

Shapes: L steps, n state dimensions, m action dimensions, S states of a tabular MDP.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from swerve.demonstrations.checks import check_finite, check_horizon, check_transitions, row_namer
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.durations import is_too_long, unit_hint
from swerve.demonstrations.headers import why_absent
from swerve.problem.mdp import MDP
from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem, padded
from swerve.systems.tabular import TabularMDP

ON_TIME = 1e-3  # of a step: rows as close as this to the MDP's time steps are not interpolated
LEAST_PADDED = 64  # rows in the smallest batch that is compiled for: most demonstrations have fewer


class Steps(NamedTuple):
    """The steps that a demonstration took.

    Attributes:
      states: [L+1, n].
      actions: [L, m].
    """

    states: np.ndarray
    actions: np.ndarray


def steps_taken(problem: Problem, demonstration: Demonstration) -> Steps:
    """Return the steps of the model that a demonstration took until its episode ended.

    Where the model has a clock and the demonstration has times, a state is interpolated for each of
    the model's steps: states change linearly between rows, angles along their shorter arc. The last
    state is kept, and the number of steps is the nearest to the demonstration's duration. The
    action of a step is the recorded action in force at the middle of the step; where the recorded
    action changes there, the action before. Without times, or without a clock, each row is a step.

    Rows after the end of the episode do not count. Actions in a tabular MDP are checked against its
    transitions; where the demonstration has no actions and only one action makes each of its steps,
    these actions are returned.

    Raises:
      ValueError: if actions are missing and cannot be found, a step is impossible, or the
        demonstration goes on for more steps than the horizon, or lasts for more than
        `durations.MAX_HORIZONS` horizons.
    """
    mdp = problem.mdp
    rows = _at_steps(mdp, demonstration)
    if isinstance(mdp, TabularMDP):
        return _tabular_steps(mdp, rows, demonstration)
    name, states, actions = demonstration.name, rows.states, rows.actions
    length = _num_steps(problem, states, demonstration)
    check_horizon(length, mdp.num_steps, name)
    if actions is None or actions.shape[1] != len(mdp.action_names):
        raise ValueError(
            f"{name}: expected actions {', '.join(mdp.action_names)}, got "
            f"{'none' if actions is None else f'{actions.shape[1]} of them'}: the total reward "
            f"depends on them{why_absent(mdp.action_names, demonstration.notes)}"
        )
    check_finite(actions[:length], mdp.action_names, row_namer(name, None))
    return Steps(states[: length + 1], actions[:length])


class _Rows(NamedTuple):
    """States [L+1, n], and actions [L, m] or more, for each step of the model."""

    states: np.ndarray
    actions: np.ndarray | None


def _at_steps(mdp: MDP, demonstration: Demonstration) -> _Rows:
    """Return the states and actions of a demonstration at the time steps of the MDP."""
    states, actions = demonstration.states, demonstration.actions
    if demonstration.times is None or not mdp.is_timed:
        return _Rows(states, actions)
    elapsed, slack = demonstration.times - demonstration.times[0], ON_TIME * mdp.dt
    _check_duration(float(elapsed[-1]), mdp, demonstration.name)
    wanted = mdp.dt * np.arange(max(1, round(elapsed[-1] / mdp.dt)) + 1)
    wanted[-1] = elapsed[-1]
    before = _row_before(wanted, elapsed)
    share = (wanted - elapsed[before]) / (elapsed[before + 1] - elapsed[before])
    change = mdp.space.difference(states[before], states[before + 1])
    between = states[before] + share[:, None] * change
    nearest = before + (share > 0.5)
    is_on_time = np.abs(elapsed[nearest] - wanted) < slack
    path = np.where(is_on_time[:, None], states[nearest], between)
    if actions is not None:
        middle = 0.5 * (wanted[:-1] + wanted[1:])
        actions = actions[_row_before(middle - slack, elapsed)]
    return _Rows(path, actions)


def _check_duration(duration: float, mdp: MDP, name: str) -> None:
    """Raise ValueError where a duration [s] is so long that its steps might not fit in memory."""
    horizon = mdp.num_steps * mdp.dt
    if is_too_long(duration, horizon):
        raise ValueError(
            f"{name}: lasts {duration:.4g} s, and the model's episodes at most {horizon:.4g} s: "
            f"another unit of t? Convert the times to seconds{unit_hint(duration, horizon)}"
        )


def _row_before(wanted: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
    """Return the last row at or before each time, but for the last row, which nothing follows."""
    return np.clip(np.searchsorted(elapsed, wanted, side="right") - 1, 0, len(elapsed) - 2)


def _num_steps(problem: Problem, states: np.ndarray, demonstration: Demonstration) -> int:
    """Return the number of steps along states [L+1, n] until the episode ends.

    It ends where the MDP says so, or at the horizon if the demonstration only rests after that.
    """
    path, num_steps = states[1:], problem.mdp.num_steps
    goal = jnp.asarray(demonstration.task.goal, jnp.float32)
    batch = jnp.asarray(padded(path, LEAST_PADDED), jnp.float32)
    ended = np.asarray(_endings(problem, batch, goal))[: len(path)]
    if ended.any():
        return int(ended.argmax()) + 1
    rests = (states[num_steps:] == states[-1]).all()
    return min(len(path), num_steps) if rests else len(path)


@of_problem
def _endings(problem: Problem, states: Float[Array, "L n"], goal: Float[Array, " g"]) -> Array:
    """Return whether the episode ends [L] in each state."""
    return jax.vmap(problem.mdp.terminated, (0, None))(states, goal)


def _tabular_steps(mdp: TabularMDP, rows: _Rows, demonstration: Demonstration) -> Steps:
    """Return the steps along rows of a tabular MDP, until they rest in their last state."""
    transitions, name = mdp.transitions, demonstration.name
    states = rows.states[: _num_before_rest(mdp, rows.states, demonstration)]
    check_transitions(states, rows.actions, transitions, name)
    fits = transitions.fits(states)
    length = int(np.flatnonzero(fits.any(axis=1)).max(initial=-1)) + 1
    check_horizon(length, mdp.num_steps, name)
    if rows.actions is not None:
        return Steps(states[: length + 1], rows.actions[:length])
    several = np.flatnonzero(fits[:length].sum(axis=1) > 1)
    if len(several):
        step = int(several[0])
        raise ValueError(
            f"{name}: step {step + 1} from {states[step].tolist()} can be made by several actions: "
            "the demonstration needs its actions"
            f"{why_absent(mdp.action_names, demonstration.notes)}"
        )
    return Steps(states[: length + 1], transitions.actions[fits[:length].argmax(axis=1)])


def _num_before_rest(mdp: TabularMDP, states: np.ndarray, demonstration: Demonstration) -> int:
    """Return the number of states up to the end of the episode, after which the state repeats.

    Raises:
      ValueError: if the demonstration goes on to another state after the end.
    """
    number = mdp.transitions.number(states)
    _, ends = at_states(mdp, jnp.asarray(demonstration.task.goal, jnp.float32))
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
def at_states(mdp: TabularMDP, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return r_T [S] and whether episodes end [S] at the states of a tabular MDP."""
    states = jnp.asarray(mdp.states, jnp.float32)
    terminal = jax.vmap(mdp.terminal_reward, (0, None))(states, goal)
    return terminal, jax.vmap(mdp.terminated, (0, None))(states, goal)
