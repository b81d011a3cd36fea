"""Read and write CSV; errors name the cell at fault.

A cell of numbers holds one number in decimal digits (`base.decimals`), with spaces or tabs around
it, or one of the words nan and inf, which the checks of the values refuse by row and column.

A file is read in parts, so that it takes little more memory than its numbers. NumPy reads a part
whose rows are all plain: as many cells as the header, and no quotes. From the first other row on,
cells are read one by one.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
import reprlib
from array import array
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from swerve.base.decimals import DECIMAL, decimal_number
from swerve.demonstrations.tables import Table, file_content, select_columns

PART = 2**18  # characters that NumPy reads at a time; more are no faster
BLANKS = " \t"  # characters that may stand around a number
NO_NUMBER = re.compile(r"nan|[+-]?inf(inity)?", re.IGNORECASE)


def read_csv(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    """Read columns of a CSV file; see `formats.read_table`."""
    data = file_content(path)
    try:
        return _read(path, data, required, optional, label)
    except UnicodeDecodeError as error:
        at = _first_error(data)
        raise ValueError(f"{path}: not UTF-8 text ({at}); save it as CSV in UTF-8") from error


def _read(
    path: Path, data: bytes, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    text = _lines(data)
    line, header = next(_csv_rows(path, text), (0, None))
    if header is None:
        raise ValueError(f"{path}: the file is empty; expected a header and rows of numbers")
    found = [cell.strip() for cell in header]
    found[0] = found[0].lstrip("#").strip()  # NumPy writes a header as a comment
    where = " in a first line of names separated by commas"
    names = select_columns(path, found, required, optional, label, where)
    values, labels, part = array("d"), [], ""
    if label is None:
        columns, plain = [found.index(name) for name in names], _plain_rows(found, names)
        while (part := text.read(PART)) and plain.fullmatch(part := part + text.readline()):
            numbers = _parse_plain(part, columns)
            if numbers is None:
                break
            values.frombytes(numbers.tobytes())
            line += part.count("\n")
            part = ""
    rest = _csv_rows(path, itertools.chain(io.StringIO(part), text), line)
    _parse_cells(path, rest, found, names, label, optional, values, labels)
    table = np.frombuffer(values).reshape(-1, len(names))
    unread = tuple(name for name in found if name not in (*names, label))
    return Table(names, table, labels, lambda row: _line_of(path, row), unread)


def _lines(data: bytes) -> io.TextIOWrapper:
    """Return the text of a file; its lines may end in CR, LF or both."""
    return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig")


def _csv_rows(path: Path, lines: Iterable[str], line: int = 0) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of every row that is not blank, the header first.

    Args:
      path: the file, for messages.
      lines: lines of the file.
      line: number of lines before these.
    """
    reader = csv.reader(lines)
    try:
        for cells in reader:
            if len(cells) > 1 or "".join(cells).strip():
                yield line + reader.line_num, cells
    except csv.Error as error:
        at = line + reader.line_num
        raise ValueError(f"{path}: line {at}: {error}; is a quote open?") from error


def _line_of(path: Path, row: int) -> int:
    """Return the line of a row, counted from 0, for an error: the file is read once more."""
    rows = _csv_rows(path, _lines(file_content(path)))
    return next(itertools.islice(rows, row + 1, None), (row + 2,))[0]


def _plain_rows(found: list[str], names: list[str]) -> re.Pattern[str]:
    """Return what matches rows with characters of numbers in the columns `names`, and no quotes."""
    row = ",".join(rf"[-+.0-9eE{BLANKS}]++" if name in names else r'[^,"\n]*+' for name in found)
    return re.compile(rf"{row}(?:\n{row})*+\n?")


def _parse_plain(part: str, columns: list[int]) -> np.ndarray | None:
    """Return columns of plain rows; None where the characters of a cell are no finite number."""
    lines = io.StringIO(part)
    try:
        numbers = np.loadtxt(lines, delimiter=",", usecols=columns, comments=None, ndmin=2)
    except ValueError:
        return None
    return numbers if np.isfinite(numbers).all() else None


def _parse_cells(
    path: Path,
    rows: Iterable[tuple[int, list[str]]],
    found: list[str],
    names: list[str],
    label: str | None,
    optional: Sequence[str],
    values: array[float],
    labels: list[str],
) -> None:
    """Append the numbers and labels of rows; raise ValueError naming the first cell at fault.

    In the last row optional columns may be blank: no action follows the last state.

    Args:
      path: the file, for messages.
      rows: the line number and the cells of each row.
      found: names of the file's columns.
      names: columns of numbers.
      label: column of labels, or None.
      optional: columns of numbers that may be blank in the last row.
      values: numbers of the rows before these; extended.
      labels: labels; extended.
    """
    places = [(name, found.index(name)) for name in names]
    blank = ""  # the message about a blank cell, unless no further row comes
    for number, (line, cells) in enumerate(rows, len(values) // len(names) + 1):
        if blank:
            raise ValueError(blank)
        at = f"{path}: row {number} (line {line})"
        if len(cells) != len(found):
            raise ValueError(f"{at}: expected {len(found)} cells as the header, got {len(cells)}")
        if label is not None:
            labels.append(cells[found.index(label)].strip())
        for name, place in places:
            cell = cells[place].strip(BLANKS)
            value = _number(cell)
            if value is None:
                wanted = "a number that a float can hold" if DECIMAL.fullmatch(cell) else "a number"
                problem = f"{at}, column {name}: expected {wanted}, got {reprlib.repr(cell)}"
                if cell or name not in optional:
                    raise ValueError(problem)
                value, blank = math.nan, blank or problem
            values.append(value)


def _number(cell: str) -> float | None:
    """Return the number in a cell, which may be NaN or infinite; None where there is none."""
    try:
        return decimal_number(cell)
    except ValueError:
        return float(cell) if NO_NUMBER.fullmatch(cell) else None


def _first_error(data: bytes) -> str:
    """Return where data stops being UTF-8 text, and why."""
    try:
        data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return f"line {line}: {error.reason}"
    return ""


def csv_text(rows: list[list[str]]) -> str:
    """Return rows of cells as CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
