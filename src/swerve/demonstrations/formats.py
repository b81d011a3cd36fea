"""Choose the reader of a file by its suffix, from a table with one line per file format.

A new format is one file beside this one, with a function like `csv_format.read_csv`, and one line
of READERS.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from swerve.demonstrations.csv_format import read_csv
from swerve.demonstrations.parquet_format import read_parquet
from swerve.demonstrations.tables import Table

READERS = {".csv": read_csv, ".parquet": read_parquet}


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), label: str | None = None
) -> Table:
    """Read columns of numbers, and one column of text, from a file of any format in READERS.

    Args:
      path: the file; its suffix tells the format.
      required: columns of numbers that must be there.
      optional: columns of numbers that may be there.
      label: a column of text that must be there, or None.

    Raises:
      ValueError: naming the file, row and column at fault.
      OSError: if the file does not exist.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; name the files in it: {path}/*.csv")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    if path.suffix.lower() not in READERS:
        raise ValueError(f"{path}: expected a file ending in {' or '.join(READERS)}")
    table = READERS[path.suffix.lower()](path, required, optional, label)
    if not len(table.values):
        raise ValueError(f"{path}: a header and no rows; expected one row for each state or task")
    return table
