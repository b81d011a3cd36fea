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
SMALLER = "[mµun]s|(?:[mµun]|milli|micro|nano)sec(?:ond)?s?|millis|micros|nanos"
OTHERS = rf"{SMALLER}|mins?|minutes?|h|hours?"
TIME = re.compile(rf"%?(?:{WORDS})(?:[ _]*[\[(]?(?:{SECONDS})[\])]?)?", re.IGNORECASE)
OTHER_TIME = re.compile(
    rf"%?(?:[^.]+\.)*(?:{WORDS}|date(?:[ _]?time)?)(?:[ _.]*[\[(]?(?:{SECONDS}|{OTHERS})[\])]?)?",
    re.IGNORECASE,
)
ALIKE = 0.75  # share of the letters that a misspelt name has in common with the name meant
LEAST_LETTERS = 3  # of a name: shorter names are like many others
MOST_SECONDS = 1e11  # since 1970 this is the year 5138: larger numbers are of another unit
RECORDING = re.compile(
    r"(?:(?:ep(?:isode)?|traj(?:ectory)?|track|agent|robot|run|demo(?:nstration)?|recording|trial"
    r"|rollout|file|seq(?=.)(?:uence)?|session|scenario|scene|subject|participant|person|human|user"
    r"|player|ped(?:estrian)?|driver|vehicle|object)"
    r"(?:s?[ _.-]*(?:ids?|idx|index|num(?:ber)?|no|nr|name))?|ids?|uuid)#?",
    re.IGNORECASE,
)
"""Names of columns that say which recording a row is of, or whose.

`seq` numbers messages, and `objects` may be a count.
"""

UNIT = re.compile(r"[\[(][^\[(\])]*[\])]")
UNIT_WORDS = {"n", "nm", "m", "mm", "mps", "ms", "kmh", "rad", "deg", "rads", "s", "v", "pct"}


def time_column(names: Sequence[str]) -> str | None:
    """Return the only name that says time in seconds; None if there is none, or several."""
    found = [name for name in names if TIME.fullmatch(name)]
    return found[0] if len(found) == 1 else None


def can_be_seconds(values: np.ndarray) -> bool:
    """Return whether values [L] are finite, and not too large for seconds."""
    return bool(np.isfinite(values).all() and np.abs(values).max(initial=0.0) <= MOST_SECONDS)


def tells_recordings(name: str) -> bool:
    """Return whether a column of this name may tell recordings apart: hours and minutes do not."""
    return not re.search(rf"(?:^|[ _.])(?:{OTHERS})$", name, re.IGNORECASE)


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
        f"{_absent(name)} and {_listed([near])} was not taken for it: rename the column"
        for name in missing
        if name != "t"
        for near in nearly(name, unread)
    ]
    return tuple(notes)


def why_absent(names: Sequence[str], notes: Sequence[str]) -> str:
    """Return the notes of a file on columns of these names, to end an error; '' if there are none.

    Args:
      names: names of columns that the file does not have.
      notes: as from `notes_on_columns`.
    """
    found = [note for note in notes if note.startswith(tuple(_absent(name) for name in names))]
    return "".join(f"; its file {note}" for note in found)


def _absent(name: str) -> str:
    """Return the words that a note on a column begins with that is not there."""
    return f"has no column {name},"


def nearly(name: str, found: Sequence[str]) -> list[str]:
    """Return the names that may be a misspelt name.

    They differ from it by case, spaces, marks or a unit alone. Where there is no such name, it is
    the most similar one, if each of its words is similar enough: `acc_x` is not `acc_z`.
    """
    others = {other: _plain(other) for other in found if other != name}
    wanted = _plain(name)
    same = [other for other, plain in others.items() if plain == wanted]
    if same or len(wanted) < LEAST_LETTERS:
        return same
    likeness = {other: _likeness(_words(name), _words(other)) for other in others}
    nearest = max(likeness, key=lambda other: likeness[other], default="")
    return [nearest] if likeness.get(nearest, 0.0) >= ALIKE else []


def _likeness(wanted: list[str], found: list[str]) -> float:
    """Return the likeness of the words that are least alike; 0 where one begins otherwise."""
    from difflib import SequenceMatcher  # here, since most files are read without it

    if len(found) == len(wanted) + 1 and found[-1] in UNIT_WORDS:
        found = found[:-1]
    if len(found) != len(wanted) or any(a[0] != b[0] for a, b in zip(wanted, found, strict=True)):
        return 0.0
    pairs = zip(wanted, found, strict=True)
    return min((SequenceMatcher(None, *pair).ratio() for pair in pairs), default=0.0)


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", UNIT.sub("", name).casefold()) if word]


def _plain(name: str) -> str:
    return re.sub(r"[\s_#\"'-]", "", UNIT.sub("", name)).casefold()


def _listed(names: Sequence[str]) -> str:
    return " or ".join(repr(shown(name)) for name in names)
