"""Read and write CSV; errors name the cell at fault."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from swerve.demonstrations.tables import Table, select_columns


def read_csv(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    """Read columns of a CSV file; see `formats.read_table`."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from error
    _, header = next(_csv_rows(path, text), (0, None))
    if header is None:
        raise ValueError(f"{path}: the file is empty; expected a header and rows of numbers")
    found = [cell.strip() for cell in header]
    names = select_columns(path, found, required, optional, label)
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
    """Return the columns as numbers; None if the cells must be read one by one."""
    header, *rows = text.rstrip().split("\n")
    if '"' in text or {row.count(",") for row in rows} != {header.count(",")}:
        return None  # cells are quoted or empty, or rows differ in length
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
    """Return numbers and labels; raise ValueError naming the first cell that is not a number.

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


def csv_text(rows: list[list[str]]) -> str:
    """Return rows of cells as CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
