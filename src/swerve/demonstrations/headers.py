"""Understand the names of columns: which one holds the times, and which one is misspelt.

Times are read from a column `t`, in seconds. Without such a column, the only column whose name says
time, such as `time`, `T`, `t [s]` or `timestamp`, is taken for it if its numbers can be seconds: a
temperature `T`, or a `timestamp` in nanoseconds, is not. A column that is not taken is told, since
durations, rates and speeds are not checked without times.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from swerve.base.phrases import shown

WORDS = "t|times?|(?:time)?stamps?|elapsed|clock|sec|secs|seconds?"
SECONDS = "s|sec|secs|seconds?"
OTHERS = "[mµun]s|msecs?|millis|nsecs?|nanos|mins?|minutes?|h|hours?"
TIME = re.compile(rf"(?:{WORDS})(?:[ _]*[\[(]?(?:{SECONDS})[\])]?)?", re.IGNORECASE)
OTHER_TIME = re.compile(rf"(?:{WORDS})[ _]*[\[(]?(?:{OTHERS})[\])]?", re.IGNORECASE)
MOST_SECONDS = 1e11  # since 1970 this is the year 5138: larger numbers are of another unit
RECORDING = re.compile(
    r"(?:(?:episode|traj(?:ectory)?|track|agent|robot|run|demo(?:nstration)?|recording|trial|rollout"
    r"|file|sequence|session|subject|participant|person|ped(?:estrian)?|driver|vehicle)s?"
    r"(?:[ _.-]*(?:ids?|idx|index|num(?:ber)?|no|nr|name))?|ids?|uuid)#?",
    re.IGNORECASE,
)
"""Names of columns that say which recording a row is of, or whose."""

UNIT = re.compile(r"[\[(][^\])]*[\])]")


def time_column(names: Sequence[str]) -> str | None:
    """Return the only name that says time in seconds; None if there is none, or several."""
    found = [name for name in names if TIME.fullmatch(name)]
    return found[0] if len(found) == 1 else None


def can_be_seconds(values: np.ndarray) -> bool:
    """Return whether values [L] are finite, and not too large for seconds."""
    return bool(np.isfinite(values).all() and np.abs(values).max(initial=0.0) <= MOST_SECONDS)


def tells_recordings(name: str) -> bool:
    """Return whether a column of this name may tell recordings apart: hours and minutes do not."""
    return not re.fullmatch(OTHERS, name, re.IGNORECASE)


def names_recordings(name: str) -> bool:
    """Return whether a column of this name says which recording a row is of."""
    return bool(RECORDING.fullmatch(name))


def notes_on_columns(unread: Sequence[str], missing: Sequence[str]) -> tuple[str, ...]:
    """Return, in words that follow the name of a file, what is odd about columns not read.

    Args:
      unread: names of the columns that were not read.
      missing: names of the optional columns that the file does not have.
    """
    notes = []
    times = [name for name in unread if TIME.fullmatch(name) or OTHER_TIME.fullmatch(name)]
    if times and "t" in missing:
        notes.append(
            f"has no column t, and {_listed(times)} was not taken for it: expected one "
            "column of seconds that strictly increase. Durations, rates and speeds are not "
            "checked: convert the times to seconds, and name them t"
        )
    notes += [
        f"has no column {name}, and {_listed([near])} was not taken for it: rename the column"
        for name in missing
        if name != "t"
        for near in nearly(name, unread)
    ]
    return tuple(notes)


def nearly(name: str, found: Sequence[str]) -> list[str]:
    """Return the names that differ from a name by case, spaces, marks or a unit alone."""
    return [other for other in found if other != name and _plain(other) == _plain(name)]


def _plain(name: str) -> str:
    return re.sub(r"[\s_#\"'-]", "", UNIT.sub("", name)).casefold()


def _listed(names: Sequence[str]) -> str:
    return " or ".join(repr(shown(name)) for name in names)
