"""Read the recording in a file: states, times and actions, and what is odd about its columns.

Files of robots and of pedestrians often hold several recordings, below one another or mixed, with a
column that tells them apart. Such a file is refused, and that column is named: by its name, such as
`episode_index`, or because times increase within each of its values. Where times go on through the
whole file, a name alone is no proof: where the value changes, states or times have to jump.

Shapes: L samples, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.base.phrases import cut, shown, some_names
from swerve.base.space import StateSpace
from swerve.demonstrations.checks import (
    FAR_BACK,
    JITTER,
    SeveralRecordingsError,
    check_finite,
    check_path,
    check_states,
    row_namer,
)
from swerve.demonstrations.formats import read_table
from swerve.demonstrations.headers import (
    can_be_seconds,
    names_recordings,
    notes_on_columns,
    tells_recordings,
    time_column,
)
from swerve.demonstrations.tables import Table, rename_hint

LEAST_ROWS = 5  # of each recording in a file, where no column tells them apart
MAX_VALUE = 30  # characters of a value in a message
LARGE_STEP = 0.98  # quantile of the steps of a recording: glitches make single steps larger
MIXED = 0.5  # share of the changes of a value: mixed recordings jump at more of them
FLAGS = {"true", "false", "yes", "no", "on", "off"}  # texts that number nothing
SAME_START = 0.1  # of the shortest recording: the recordings in a file begin so nearly alike


class Recording(NamedTuple):
    """The columns of a file; see `Demonstration`."""

    states: np.ndarray
    times: np.ndarray | None
    actions: np.ndarray | None
    notes: tuple[str, ...]


def read_recording(path: Path, space: StateSpace, action_names: Sequence[str]) -> Recording:
    """Read and check the recording in a file.

    Raises:
      ValueError: if the file cannot be understood, holds several recordings, has some of the
        actions alone, or its states fail `check_states`.
    """
    table, time_name = _with_times(
        path, read_table(path, space.names, optional=("t", *action_names))
    )
    states = table.columns(space.names)
    times = table.columns(["t"])[:, 0] if "t" in table.names else None
    absent = [name for name in ("t", *action_names) if name not in table.names]
    missing = [name for name in absent if name != "t"]
    actions = None if missing else table.columns(action_names)
    table = table._replace(values=table.values[:0].copy())  # frees the memory of a large file
    notes = notes_on_columns(table.unread, absent)
    notes += _check_recording(path, table, states, times, time_name, space)
    if len(missing) == len(action_names):
        return Recording(states, times, None, notes)
    if actions is None:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; expected all of the actions "
            f"{', '.join(action_names)}, or none{rename_hint(missing, table.unread)}"
        )
    if np.isnan(actions[-1]).all():  # blank: no action follows the last state
        actions = actions[:-1]
    check_finite(actions, action_names, row_namer(str(path), table.line_of))
    return Recording(states, times, actions, notes)


def _with_times(path: Path, table: Table) -> tuple[Table, str]:
    """Return a table with the column `t` as well, and the name of that column in the file.

    Where there is no column `t`, another column whose name says time is taken for it if its numbers
    strictly increase. Times of several recordings are taken too, so that the file is refused.
    """
    name = None if "t" in table.names else time_column(table.unread)
    if name is None:
        return table, "t"
    try:
        times = read_table(path, [name]).values[:, 0]
    except ValueError:  # dates, or blank cells
        return table, "t"
    unread = tuple(other for other in table.unread if other != name)
    is_time = can_be_seconds(times) and (
        bool((np.diff(times) > 0.0).all())
        or _begin_alike(times)
        or _telling_column(path, unread, times, table.names[0]) != ""
    )
    if not is_time:
        return table, "t"
    joined = np.column_stack([table.values, times])
    return table._replace(names=[*table.names, "t"], values=joined, unread=unread), name


def _begin_alike(times: np.ndarray) -> bool:
    """Return whether times [L] are of recordings below one another that begin at about one time."""
    pieces = np.split(times, np.flatnonzero(np.diff(times) <= 0.0) + 1)
    shortest = min(piece[-1] - piece[0] for piece in pieces)
    starts = [piece[0] for piece in pieces]
    spread = max(starts) - min(starts)
    return min(map(len, pieces)) >= LEAST_ROWS and bool(spread <= SAME_START * shortest)


def _check_recording(
    path: Path,
    table: Table,
    states: np.ndarray,
    times: np.ndarray | None,
    time_name: str,
    space: StateSpace,
) -> tuple[str, ...]:
    """Check states and times; where they are of several recordings, name what tells them apart.

    Returns:
      Notes on columns that may tell recordings apart, in words that follow the name of the file.
    """
    named = shown(time_name)
    try:
        check_path(states, times, space, str(path), line_of=table.line_of, time_name=named)
    except SeveralRecordingsError as error:
        name = "" if times is None else _telling_column(path, table.unread, times, space.names[0])
        if not name:
            raise
        raise ValueError(f"{error}. The column {shown(name)} tells them apart") from error
    notes = _check_alone(path, table.unread, states, times, space)
    check_states(states, times, space, str(path), line_of=table.line_of, time_name=named)
    return notes


def _check_alone(
    path: Path,
    names: Sequence[str],
    states: np.ndarray,
    times: np.ndarray | None,
    space: StateSpace,
) -> tuple[str, ...]:
    """Raise ValueError where a column numbers the recordings in a file, and there are several.

    A column with another value in each row, or in nearly each, numbers the rows.

    Args:
      path: the file.
      names: columns that may number recordings.
      states: [L, n] states.
      times: [L] times that strictly increase, or None.
      space: the state space.

    Returns:
      Notes on columns that may, and need not, number recordings.
    """
    notes = []
    for name in filter(names_recordings, names):
        found, group = _values(path, name, space.names[0])
        if not 1 < len(found) <= (len(group) + 1) / 2:
            continue
        told = some_names([cut(shown(text), MAX_VALUE) for text in found])
        if times is None or _are_apart(group, states, times, space):
            raise ValueError(
                f"{path}: column {shown(name)} has {len(found)} values ({told}), so there are "
                "several recordings in one file: split it, one file for each value. If the column "
                "says something else, leave it out or rename it"
            )
        if not {"0", "1"}.issuperset(found):
            notes.append(
                f"has {len(found)} values in column {shown(name)} ({told}): if these are several "
                "recordings, split the file, one file for each value"
            )
    return tuple(notes)


def _are_apart(group: np.ndarray, states: np.ndarray, times: np.ndarray, space: StateSpace) -> bool:
    """Return whether states [L, n] or times [L] jump where the group [L] of the rows changes.

    One jump will do where each group is one block of rows. Where groups come back, the label of one
    recording changes again and again, and most changes have to be jumps.
    """
    order = np.argsort(group, kind="stable")
    is_same = np.diff(group[order]) == 0
    before, after = order[:-1][is_same], order[1:][is_same]
    last = np.flatnonzero(np.diff(group))
    with np.errstate(invalid="ignore", over="ignore"):  # states are checked later
        within = space.relative_distance(states[before], states[after])
        across = space.relative_distance(states[last], states[last + 1])
    jumps = across > FAR_BACK * _large(within) + JITTER
    if len(last) > group.max():
        return bool(jumps.mean() > MIXED)
    gaps = times[last + 1] - times[last] > FAR_BACK * _large(times[after] - times[before])
    return bool((jumps | gaps).any())


def _large(steps: np.ndarray) -> float:
    return float(np.sort(steps)[int(LARGE_STEP * (len(steps) - 1))])


def _values(path: Path, name: str, state: str) -> tuple[list[str], np.ndarray]:
    """Return the values of a column, each once, and the number [L] of the value in each row.

    A blank cell repeats the value above it. There are no values where the column says yes or no.

    Args:
      path: the file.
      name: the column.
      state: name of a state: a table has a column of numbers.
    """
    try:
        numbers = read_table(path, [state], optional=[name]).columns([name])[:, 0]
    except ValueError:  # texts, or blank cells
        pass
    else:
        each = np.unique(numbers[~np.isnan(numbers)])
        group = np.where(np.isnan(numbers), -1, np.searchsorted(each, numbers))
        return [f"{value:.15g}" for value in each], _filled(group)
    try:
        texts = read_table(path, [state], label=name).labels
    except ValueError:  # yes or no
        return [], np.zeros(0, int)
    index: dict[str, int] = {}
    group = np.array([index.setdefault(text, len(index)) if text else -1 for text in texts], int)
    is_flag = FLAGS.issuperset(text.casefold() for text in index)
    return [] if is_flag else list(index), _filled(group)


def _filled(group: np.ndarray) -> np.ndarray:
    """Return numbers [L] in which each -1 is replaced by the number before it, or the first one."""
    known = np.flatnonzero(group >= 0)
    if not len(known):
        return group
    return group[known][np.maximum(np.searchsorted(known, np.arange(len(group)), "right") - 1, 0)]


def _telling_column(path: Path, names: Sequence[str], times: np.ndarray, state: str) -> str:
    """Return the column within whose values times strictly increase; '' if none does.

    Args:
      path: the file.
      names: columns that may tell recordings apart.
      times: [L] times of the rows.
      state: name of a state: a table has a column of numbers.
    """
    for name in filter(tells_recordings, names):
        found, group = _values(path, name, state)
        if not 1 < len(found) <= len(times) / 2:
            continue
        order = np.argsort(group, kind="stable")
        is_same = np.diff(group[order]) == 0
        if (np.diff(times[order])[is_same] > 0.0).all():
            return name
    return ""
