"""Tables of numbers in CSV and Parquet files; errors name the cell at fault.

CSV is read with NumPy; polars is imported for Parquet alone.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Table(NamedTuple):
    """Some columns of a file.

    Attributes:
      names: of the columns of numbers, as far as the file has them.
      values: [rows, len(names)].
      labels: the column of text; empty where none is wanted.
      line_of: maps a row, counted from 0, to its line in the file; None for Parquet.
    """

    names: list[str]
    values: np.ndarray
    labels: list[str]
    line_of: Callable[[int], int] | None

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Return the columns of some names [rows, len(names)]."""
        return np.ascontiguousarray(self.values[:, [self.names.index(name) for name in names]])


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), label: str | None = None
) -> Table:
    """Read columns of numbers, and one column of text, from a CSV or Parquet file.

    Args:
      path: the file; its suffix is that of the format.
      required: columns of numbers that must be there.
      optional: columns of numbers that may be there.
      label: a column of text that must be there, or None.

    Raises:
      ValueError: naming the file, row and column at fault.
      OSError: if there is no such file.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; name the files in it: {path}/*.csv")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: expected a file ending in .csv or .parquet")
    table = readers[path.suffix.lower()](path, required, optional, label)
    if not len(table.values):
        raise ValueError(f"{path}: a header and no rows; expected one row for each state or task")
    return table


def _select(
    path: Path,
    found: list[str],
    required: Sequence[str],
    optional: Sequence[str],
    label: str | None,
) -> list[str]:
    """Return the names of the columns of numbers to read, after checking the columns found."""
    needed = [*([] if label is None else [label]), *required]
    missing = [name for name in needed if name not in found]
    if missing:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; expected {', '.join(needed)} in a first "
            f"line of names separated by commas, found {', '.join(found)}"
        )
    twice = [name for name, count in Counter(found).items() if name and count > 1]
    if twice:
        raise ValueError(f"{path}: more than one column is named {', '.join(twice)}; rename them")
    return [name for name in dict.fromkeys((*required, *optional)) if name in found]


def _read_csv(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from error
    _, header = next(_csv_rows(path, text), (0, None))
    if header is None:
        raise ValueError(f"{path}: the file is empty; expected a header and rows of numbers")
    found = [cell.strip() for cell in header]
    names = _select(path, found, required, optional, label)
    values, labels = None, []
    if label is None:
        values = _parse_fast(text, [found.index(name) for name in names])
    if values is None:
        values, labels = _parse_cells(path, text, found, names, label, optional)
    return Table(names, values, labels, lambda row: list(_csv_rows(path, text))[row + 1][0])


def _csv_rows(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of every row that is not blank, the header first."""
    reader = csv.reader(io.StringIO(text))
    try:
        for cells in reader:
            if len(cells) > 1 or "".join(cells).strip():
                yield reader.line_num, cells
    except csv.Error as error:
        raise ValueError(f"{path}: line {reader.line_num}: {error}; is a quote open?") from error


def _parse_fast(text: str, indices: list[int]) -> np.ndarray | None:
    """Return the columns as numbers, or None where each cell must be read on its own."""
    header, *rows = text.rstrip().split("\n")
    if '"' in text or {row.count(",") for row in rows} != {header.count(",")}:
        return None  # quoted, ragged or empty
    try:
        return np.loadtxt(rows, delimiter=",", usecols=indices, comments=None, ndmin=2)
    except ValueError:
        return None


def _parse_cells(
    path: Path,
    text: str,
    found: list[str],
    names: list[str],
    label: str | None,
    optional: Sequence[str],
) -> tuple[np.ndarray, list[str]]:
    """Return numbers and labels; raise ValueError naming the first cell that is no number.

    In the last row optional columns may be blank: no action follows the last state.
    """
    rows = list(_csv_rows(path, text))[1:]
    values, labels = np.empty((len(rows), len(names))), []
    for row, (line, cells) in enumerate(rows):
        at = f"{path}: row {row + 1} (line {line})"
        if len(cells) != len(found):
            raise ValueError(f"{at}: expected {len(found)} cells as the header, got {len(cells)}")
        if label is not None:
            labels.append(cells[found.index(label)].strip())
        for column, name in enumerate(names):
            cell = cells[found.index(name)]
            if name in optional and row == len(rows) - 1 and not cell.strip():
                cell = "nan"
            try:
                values[row, column] = float(cell)
            except ValueError:
                raise ValueError(f"{at}, column {name}: expected a number, got {cell!r}") from None
    return values, labels


def _read_parquet(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    import polars as pl  # takes longer to load than everything else together

    try:
        schema = pl.read_parquet_schema(path)
        names = _select(path, list(schema), required, optional, label)
        frame = pl.read_parquet(path, columns=names if label is None else [label, *names])
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"{path}: cannot be read as Parquet: {error}") from error
    for name in names:
        if not schema[name].is_numeric():
            raise ValueError(f"{path}: column {name}: expected numbers, got {schema[name]} values")
        if name in required and frame[name].null_count():
            row = frame[name].is_null().arg_true()[0]
            raise ValueError(f"{path}: row {row + 1}, column {name}: expected a number, got null")
    numbers = frame.select(pl.col(names).cast(pl.Float64).fill_null(float("nan")))
    labels = [] if label is None else frame[label].cast(pl.String).to_list()
    return Table(names, numbers.to_numpy(), labels, None)


def csv_text(rows: list[list[str]]) -> str:
    """Return rows of cells as CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
