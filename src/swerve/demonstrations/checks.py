"""Check recorded states and tasks before anything is computed from them.

Every message says where the error is (file, row, column), what was expected, what was found, and
what to do.

Shapes: L samples, n state dimensions, g goal dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from swerve.base.arguments import real_numbers
from swerve.base.phrases import told_apart
from swerve.base.space import MAX_HALF_EXTENTS, MAX_TURNS, TWO_PI, StateSpace, Task, Transitions
from swerve.demonstrations.durations import is_since_1970

START_TOLERANCE = 1e-3
"""Largest distance of a first state from the start of its task, and of a start or a goal from the
bounds, in extents of the state space: rounding in files explains distances up to this one."""

LATTICE_TOLERANCE = 1e-3  # distance to a whole number: numbers this near are rounded whole numbers
MAX_ARC = 0.45 * TWO_PI  # rad, change of an angle in a step: nearer to pi the direction is unclear

# Times that do not increase: what tells several recordings from rows that are out of order.
FEW_RETURNS = 0.2  # share of the rows: where times go back more often, rows are out of order
FAR_BACK = 3.0  # usual steps of time: rows in the wrong place go back by less
MANY_TWICE = 0.25  # share of the rows: where more times occur twice, recordings are mixed

# Limits beyond which a recorded state or demonstration is odd beside nominal trajectories of its
# task. Odd data are not refused: `trust.doubts` warns, and a monitor flags the state.
FAST = 3.0  # times the fastest nominal change of a state: more is a glitch or a wrong unit
USUAL_ERRORS = 6.0  # times the usual error of a step of a demonstration: more is a glitch
JITTER = 0.01  # share of the extent: two measurements of the same state may differ by so much
TIME_SLACK = 0.1  # share of the duration: demonstrators may be so much quicker or slower
COARSE = 1.5  # model steps between two states: with wider gaps, lines between them cut corners
NEAR_START = 0.05  # share of the extent: after a jump so near its start, another recording begins

# Limits beyond which the motion of a demonstration is impossible by the dynamics.
STRENGTH = 10.0  # times the model's strongest action: people act so much more strongly at most
RELATIVE = 0.3  # share of a motion: no model is more accurate
LEAST_MOTION = 0.03  # share of the extent: noise may hide in smaller motions
IMPOSSIBLE_SHARE = 0.25  # share of the motion in one state: walls of the model explain less

SPLIT = "Several recordings in one file? Split it, one file each"

RowNamer = Callable[[int], str]


class SeveralRecordingsError(ValueError):
    """Times that do not increase seem to be those of several recordings."""


def check_states(
    states: np.ndarray,
    times: np.ndarray | None,
    space: StateSpace,
    where: str,
    *,
    line_of: Callable[[int], int] | None = None,
    time_name: str = "t",
) -> None:
    """Check the states of a demonstration before anything is computed from them.

    Args:
      states: [L, n] states.
      times: [L] time of each state [s], or None.
      space: names, angles and bounds of the states.
      where: the file or demonstration, for messages.
      line_of: maps a row, counted from 0, to its line in the file.
      time_name: name of the column that holds the times, for messages.

    Raises:
      ValueError: if there are fewer than 2 states, a number is NaN or infinite, the times do not
        strictly increase, a state is so far outside the bounds that its unit must be wrong (more
        than MAX_HALF_EXTENTS half extents from the middle of the bounds, MAX_TURNS turns for an
        angle), a state on a lattice is not a whole number, or an angle changes by more than MAX_ARC
        [rad] between two states.
    """
    check_path(states, times, space, where, line_of=line_of, time_name=time_name)
    at = row_namer(where, line_of)
    if not are_plausible(states, space):
        check_finite(states, space.names, at)
        _check_units(states, space, at)
        if space.is_lattice:
            _check_lattice(states, space, at)
        _check_arcs(states, space, at)


def check_path(
    states: np.ndarray,
    times: np.ndarray | None,
    space: StateSpace,
    where: str,
    *,
    line_of: Callable[[int], int] | None = None,
    time_name: str = "t",
) -> None:
    """Check the number of states, the number of their components, and the times."""
    states = shaped(states, (None, len(space.names)), "states", where)
    if len(states) < 2:
        raise ValueError(f"{where}: expected at least 2 states, got {len(states)}")
    if times is not None:
        times = shaped(times, (len(states),), "times", where)
        _check_times(times, row_namer(where, line_of), time_name)


def are_plausible(states: np.ndarray, space: StateSpace) -> bool:
    """Return whether all paths of states [..., L, n] pass the checks of single states and arcs."""
    low, high = space.believable
    if not ((states >= low) & (states <= high)).all():  # NaN fails both
        return False
    if space.is_lattice and _off_lattice(states).any():
        return False
    return not (space.is_angle.any() and _wide_arcs(states, space).any())


def shaped(value: object, shape: Sequence[int | None], what: str, where: str) -> np.ndarray:
    """Return a value as float64 after checking its shape; None in `shape` stands for any length.

    Raises:
      ValueError: if the value is not made of real numbers, or has another shape; `what` and `where`
        are for the message.
    """
    array = real_numbers(value, f"{where}: {what}")
    fits = len(shape) == array.ndim and all(
        size is None or size == found for size, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        sizes = str(tuple(shape)).replace("None", "any")
        raise ValueError(f"{where}: expected {what} of shape {sizes}, got {array.shape}")
    return array


def row_namer(where: str, line_of: Callable[[int], int] | None) -> RowNamer:
    """Return a function that names a row, counted from 0, by its file and its line."""
    return lambda row: (
        f"{where}: row {row + 1}" + ("" if line_of is None else f" (line {line_of(row)})")
    )


def check_finite(values: np.ndarray, names: Sequence[str], at: RowNamer) -> None:
    """Raise ValueError where one of the values [L, n] is NaN or infinite."""
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise ValueError(
            f"{at(row)}, column {names[column]}: expected a finite number, got "
            f"{values[row, column]}; remove or repair that row"
        )


def _check_times(times: np.ndarray, at: RowNamer, name: str) -> None:
    rises = (times[1:] > times[:-1]).all()
    if rises and math.isfinite(times[0]) and math.isfinite(times[-1]):
        return
    check_finite(times[:, None], [name], at)
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        before, after = (float(time) for time in times[late[0] : late[0] + 2])
        kind, advice = _order_advice(times)
        raise kind(
            f"{at(late[0])} has {name} = {before!r} and row {late[0] + 2} has {name} = {after!r}; "
            f"expected times that strictly increase: {advice}"
        )


def _order_advice(times: np.ndarray) -> tuple[type[ValueError], str]:
    """Return the error for times [L] that do not strictly increase, and what to do about them."""
    changes = np.diff(times)
    back, usual = -changes[changes < 0.0], np.median(np.abs(changes))
    is_mixed = np.count_nonzero(changes == 0.0) > MANY_TWICE * len(times)
    is_joined = 0 < len(back) <= FEW_RETURNS * len(times) and back.min() > FAR_BACK * usual
    if is_mixed and not len(back) and is_since_1970(times[0]):
        return ValueError, (
            "times since 1970 with too few digits? Save them with all digits, or as seconds since "
            "the first row"
        )
    if is_mixed or is_joined:
        advice = f"{SPLIT[0].lower()}{SPLIT[1:]}; to sort the rows would mix the recordings"
        return SeveralRecordingsError, advice
    return ValueError, "sort the rows, or remove those recorded twice"


def _check_units(states: np.ndarray, space: StateSpace, at: RowNamer) -> None:
    low, high = space.believable
    far = np.argwhere((states < low) | (states > high))
    if not far.size:
        return
    row, column = far[0]
    raise ValueError(f"{at(row)}, column {unit_problem(float(states[row, column]), space, column)}")


def unit_problem(value: float, space: StateSpace, column: int) -> str:
    """Return the message about a number that is too far outside the bounds to be believed."""
    problem = f"{space.names[column]}: {value:.6g}"
    if space.is_angle[column]:
        return (
            f"{problem} is an angle of more than {MAX_TURNS} turns. Degrees? Radians are "
            f"expected; if it is right, wrap it to [0, 2 pi)"
        )
    low, high = space.bounds[column]
    return (
        f"{problem} is more than {MAX_HALF_EXTENTS} half-widths from the middle of the bounds "
        f"[{low:.6g}, {high:.6g}]. Another unit? If it is right, widen the MDP's bounds"
    )


def _check_lattice(states: np.ndarray, space: StateSpace, at: RowNamer) -> None:
    """Raise ValueError where a state [L, n] lies between two states of the lattice."""
    for row, column in np.argwhere(_off_lattice(states))[:1]:
        raise ValueError(
            f"{at(row)}, column {space.names[column]}: {states[row, column]:.6g} lies between two "
            "states: expected a whole number"
        )


def _off_lattice(states: np.ndarray) -> np.ndarray:
    return np.abs(states - np.round(states)) > LATTICE_TOLERANCE


def _wide_arcs(states: np.ndarray, space: StateSpace) -> np.ndarray:
    """Return [..., L-1, a] True where an angle of states [..., L, n] turns more than MAX_ARC."""
    angles = states[..., space.is_angle]
    turned = angles[..., 1:, :] - angles[..., :-1, :]
    return np.abs(turned - TWO_PI * np.round(turned / TWO_PI)) > MAX_ARC


def _check_arcs(states: np.ndarray, space: StateSpace, at: RowNamer) -> None:
    for row, angle in np.argwhere(_wide_arcs(states, space))[:1]:
        column = np.flatnonzero(space.is_angle)[angle]
        arcs = np.abs(space.difference(states[:-1], states[1:]))
        joined = f". {SPLIT}" if restarts(states, row + 1, space) else ""
        raise ValueError(
            f"{at(row + 1)}, column {space.names[column]}: {arcs[row, column]:.3f} rad from the "
            f"row before, too close to pi to tell which way it turned (at most {MAX_ARC:.3f}); "
            f"record at a higher sampling rate. Degrees? Radians are expected{joined}"
        )


def restarts(states: np.ndarray, row: int, space: StateSpace) -> bool:
    """Return whether a row of states [L, n], counted from 0, leads back to the start from afar."""
    before, after = space.relative_distance(states[row - 1 : row + 1], states[0]).tolist()
    return after <= NEAR_START < before


def check_bounds(task: Task, space: StateSpace, goal_names: Sequence[str], where: str) -> None:
    """Raise ValueError where a start, or a goal that is a state, lies outside the bounds."""
    low, high = space.bounds.T
    slack = START_TOLERANCE * space.extent
    for part, state in task._asdict().items():
        if part == "goal" and tuple(goal_names) != space.names:
            continue
        outside = ((state < low - slack) | (state > high + slack)) & ~space.is_angle
        for column in np.flatnonzero(outside):
            raise ValueError(
                f"{where}: {part} {space.names[column]} = {state[column]:.6g} is outside the "
                f"bounds [{low[column]:.6g}, {high[column]:.6g}] of the state space; correct it, "
                f"or widen the MDP's bounds"
            )
        if space.is_lattice:
            _check_lattice(state[None], space, lambda row, part=part: f"{where}: {part}")


def check_start(state: np.ndarray, task: Task, space: StateSpace, where: str) -> None:
    """Raise ValueError where a first state [n] is not the start of its task."""
    distance = space.relative_distance(state, task.start)
    if distance > START_TOLERANCE:
        pairs = [told_apart(*pair, 9) for pair in zip(state, task.start, strict=True)]
        first, start = (
            ", ".join(f"{name} = {x}" for name, x in zip(space.names, texts, strict=True))
            for texts in zip(*pairs, strict=True)
        )
        apart, most = told_apart(float(distance), START_TOLERANCE, 2)
        raise ValueError(
            f"{where}: the first state is {first}, but the task starts at {start}: {apart} of the "
            f"extent apart, expected at most {most}; correct either"
        )


def check_transitions(
    states: np.ndarray, actions: np.ndarray | None, transitions: Transitions, where: str
) -> None:
    """Raise ValueError where no action of a tabular MDP makes a step of states [L, n].

    Args:
      states: [L, n].
      actions: [L-1, m] or more rows, the recorded action of each step, which must make that step.
        None where no actions are recorded: then any action may make the step.
      transitions: transitions of the MDP.
      where: the demonstration, for messages.
    """
    fits, rests = transitions.fits(states), transitions.rests(states)
    for step in np.flatnonzero(~(fits.any(axis=1) | rests))[:1]:
        before, after = states[step : step + 2].tolist()
        raise ValueError(
            f"{where}: step {step + 1} leads from {before} to {after}, which no action does: "
            "correct the demonstration, or the transitions of the MDP"
        )
    if actions is None:
        return
    taken = transitions.action_number(actions[: len(fits)])
    for step in np.flatnonzero(~(fits[np.arange(len(fits)), taken] | rests))[:1]:
        before, after = states[step : step + 2].tolist()
        raise ValueError(
            f"{where}: step {step + 1} leads from {before} to {after}, which action "
            f"{actions[step].tolist()} does not do"
        )


def check_horizon(num_moves: int, num_steps: int, where: str) -> None:
    """Raise ValueError where a demonstration takes more steps than an episode of the MDP has."""
    if num_moves > num_steps:
        raise ValueError(
            f"{where}: {num_moves} steps, more than the horizon of {num_steps}: correct the "
            "demonstration, or raise num_steps"
        )
