"""Columns of numbers that were read from a file, whatever its format.

A reader of a format takes the path of a file, the columns required, the columns that are optional
and the column of labels, and returns a `Table`; see `formats`.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.base.files import open_regular
from swerve.base.phrases import cut, shown
from swerve.demonstrations.headers import nearly

MAX_FOUND = 500  # characters of the column names that a message lists
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
MAX_BYTES = 2**30  # bytes of a file of demonstrations or tasks: larger files are refused unread


class Table(NamedTuple):
    """Some columns of a file.

    Attributes:
      names: names of the columns of numbers that the file has.
      values: [rows, len(names)] the numbers.
      labels: the column of text; empty where no such column was asked for.
      line_of: maps a row, counted from 0, to its line in the file; None for Parquet.
      unread: names of the other columns that the file has.
    """

    names: list[str]
    values: np.ndarray
    labels: list[str]
    line_of: Callable[[int], int] | None
    unread: tuple[str, ...] = ()

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Return the columns [rows, len(names)] with these names."""
        return np.ascontiguousarray(self.values[:, [self.names.index(name) for name in names]])


def select_columns(
    path: Path,
    found: list[str],
    required: Sequence[str],
    optional: Sequence[str],
    label: str | None,
    where: str = "",
) -> list[str]:
    """Return the names of the columns of numbers to read, after checking the columns found.

    Args:
      path: the file, for messages.
      found: names of the file's columns.
      required: columns of numbers that must be there.
      optional: columns of numbers that may be there.
      label: a column of text that must be there, or None.
      where: where a file of its format has the names, in words that follow "expected x, y".

    Raises:
      ValueError: if a column is missing, or two columns have the same name.
    """
    needed = [*([] if label is None else [label]), *required]
    missing = [name for name in needed if name not in found]
    if missing:
        others = [name for name in found if name not in (*needed, *optional)]
        hint = _separator_hint(found, needed) or rename_hint(missing, others)
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; expected {', '.join(needed)}{where}, found "
            f"{cut(', '.join(found), MAX_FOUND)}{hint}"
        )
    twice = [name for name, count in Counter(found).items() if name and count > 1]
    if twice:
        named = cut(", ".join(twice), MAX_FOUND)
        raise ValueError(f"{path}: more than one column is named {named}; rename them")
    return [name for name in dict.fromkeys((*required, *optional)) if name in found]


def rename_hint(missing: Sequence[str], others: Sequence[str]) -> str:
    """Return the end of an error about missing columns: others that may be meant; '' if none."""
    near = dict.fromkeys(other for name in missing for other in nearly(name, others))
    return f"; rename {', '.join(repr(shown(name)) for name in near)}?" if near else ""


def _separator_hint(found: Sequence[str], needed: Sequence[str]) -> str:
    """Return the end of an error about a header that other marks than commas separate, or ''."""
    for mark, word in SEPARATORS.items():
        names = [name.strip() for name in found[0].split(mark)]
        if len(found) == 1 < len(names) and set(needed) & set(names):
            return f"; these are separated by {word}: save them with commas, and points in numbers"
    return ""


def file_content(path: Path) -> bytes:
    """Return the content of a file that others may have made.

    Raises:
      OSError: if the file does not exist, or is a pipe or a device.
      ValueError: if the file is larger than MAX_BYTES.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_BYTES:
            raise ValueError(
                f"{path}: expected at most {MAX_BYTES:,} bytes, got {size:,}; split the file, or "
                "leave out columns"
            )
        return file.read(size)
