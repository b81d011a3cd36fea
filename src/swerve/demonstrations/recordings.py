"""Read the recording in a file: states, times and actions, and what is odd about its columns.

Files of robots and of pedestrians often hold several recordings, below one another or mixed, with a
column that tells them apart. Such a file is refused, and that column is named.

Shapes: L samples, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.base.phrases import shown
from swerve.base.space import StateSpace
from swerve.demonstrations.checks import check_finite, check_states, row_namer
from swerve.demonstrations.formats import read_table, with_times
from swerve.demonstrations.headers import notes_on_columns
from swerve.demonstrations.tables import Table


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
    table = with_times(path, read_table(path, space.names, optional=("t", *action_names)))
    states = table.columns(space.names)
    times = table.columns(["t"])[:, 0] if "t" in table.names else None
    _check_recording(path, table, states, times, space)
    absent = [name for name in ("t", *action_names) if name not in table.names]
    notes = notes_on_columns(table.unread, absent)
    missing = [name for name in absent if name != "t"]
    if len(missing) == len(action_names):
        return Recording(states, times, None, notes)
    if missing:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; expected all of the actions "
            f"{', '.join(action_names)}, or none"
        )
    actions = table.columns(action_names)
    if np.isnan(actions[-1]).all():  # blank: no action follows the last state
        actions = actions[:-1]
    check_finite(actions, action_names, row_namer(str(path), table.line_of))
    return Recording(states, times, actions, notes)


def _check_recording(
    path: Path, table: Table, states: np.ndarray, times: np.ndarray | None, space: StateSpace
) -> None:
    """Check states and times; where they are of several recordings, name what tells them apart."""
    try:
        check_states(states, times, space, str(path), line_of=table.line_of)
    except ValueError as error:
        if times is None or "several recordings" not in str(error):
            raise
        name = _telling_column(path, table.unread, times)
        if not name:
            raise
        raise ValueError(f"{error}. The column {shown(name)} tells them apart") from error


def _telling_column(path: Path, names: Sequence[str], times: np.ndarray) -> str:
    """Return the column of numbers within whose values times strictly increase; '' if none does.

    Args:
      path: the file.
      names: columns that may tell recordings apart.
      times: [L] times of the rows.
    """
    for name in names:
        try:
            values = read_table(path, [name]).values[:, 0]
        except ValueError:  # no numbers
            continue
        groups = [times[values == value] for value in np.unique(values)]
        if 1 < len(groups) <= len(times) / 2 and all((np.diff(g) > 0.0).all() for g in groups):
            return name
    return ""
