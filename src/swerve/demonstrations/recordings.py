"""Read the recording in a file: states, times and actions, and what is odd about its columns.

Files of robots and of pedestrians often hold several recordings, below one another or mixed, with a
column that tells them apart. Such a file is refused, and that column is named: by its name, such as
`episode_index`, or because times increase within each of its values.

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
    _check_recording(path, table, states, times, time_name, space)
    notes = notes_on_columns(table.unread, absent)
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
        or _telling_column(path, unread, times) != ""
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
) -> None:
    """Check states and times; where they are of several recordings, name what tells them apart."""
    named = shown(time_name)
    try:
        check_path(states, times, space, str(path), line_of=table.line_of, time_name=named)
    except SeveralRecordingsError as error:
        name = "" if times is None else _telling_column(path, table.unread, times)
        if not name:
            raise
        raise ValueError(f"{error}. The column {shown(name)} tells them apart") from error
    _check_alone(path, table.unread, space.names[0])
    check_states(states, times, space, str(path), line_of=table.line_of, time_name=named)


def _check_alone(path: Path, names: Sequence[str], state: str) -> None:
    """Raise ValueError where a column numbers the recordings in a file, and there are several.

    A column with another value in each row, or in nearly each, numbers the rows.

    Args:
      path: the file.
      names: columns that may number recordings.
      state: name of a state.
    """
    for name in filter(names_recordings, names):
        found, num_rows = _values(path, name, state)
        if 1 < len(found) <= (num_rows + 1) / 2:
            texts = [x if isinstance(x, str) else f"{x:.15g}" for x in found]
            told = some_names([cut(shown(text), MAX_VALUE) for text in texts])
            raise ValueError(
                f"{path}: column {shown(name)} has {len(found)} values ({told}), so there are "
                "several recordings in one file: split it, one file for each value. If the column "
                "says something else, leave it out or rename it"
            )


def _values(path: Path, name: str, state: str) -> tuple[Sequence[str] | np.ndarray, int]:
    """Return the values of a column, each once and none for blanks, and the number of rows.

    There are no values where the column says yes or no.

    Args:
      path: the file.
      name: the column.
      state: name of a state: a table has a column of numbers.
    """
    try:
        numbers = read_table(path, [state], optional=[name]).columns([name])[:, 0]
        return np.unique(numbers[~np.isnan(numbers)]), len(numbers)
    except ValueError:  # texts, or blank cells
        pass
    try:
        texts = read_table(path, [state], label=name).labels
    except ValueError:  # yes or no
        return [], 0
    found = [text for text in dict.fromkeys(texts) if text]
    return ([] if {text.casefold() for text in found} <= {"true", "false"} else found), len(texts)


def _telling_column(path: Path, names: Sequence[str], times: np.ndarray) -> str:
    """Return the column of numbers within whose values times strictly increase; '' if none does.

    Args:
      path: the file.
      names: columns that may tell recordings apart.
      times: [L] times of the rows.
    """
    for name in filter(tells_recordings, names):
        try:
            values = read_table(path, [name]).values[:, 0]
        except ValueError:  # no numbers
            continue
        found, group = np.unique(values, return_inverse=True)
        if not 1 < len(found) <= len(times) / 2:
            continue
        order = np.argsort(group, kind="stable")
        is_same = np.diff(group[order]) == 0
        if (np.diff(times[order])[is_same] > 0.0).all():
            return name
    return ""
