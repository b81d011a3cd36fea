"""Published results as files: figures as PNG and SVG, their numbers as CSV, tables as Markdown."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swerve.base.files import write_bytes, write_text
from swerve.demonstrations.csv_format import csv_text

WIDTH = 3.5  # in: width of a column of a paper
SIZE, SMALL = 8.0, 7.0  # pt: font sizes of titles and axis labels, and of ticks and legends


class Part(NamedTuple):
    """A figure and its numbers.

    Attributes:
      name: name of the files, without a suffix.
      figure: the picture.
      rows: rows of the numbers in the picture, the first of titles.
    """

    name: str
    figure: Figure
    rows: list[list[str]]


def column(height: float) -> Figure:
    """Return an empty figure as wide as a column, with a height [in]."""
    figure = Figure((WIDTH, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def write(folder: Path, parts: Sequence[Part], tables: Mapping[str, str]) -> list[Path]:
    """Write figures as PNG and SVG, the rows of their numbers as CSV, and tables as Markdown.

    Args:
      folder: created where it does not exist.
      parts: the figures.
      tables: Markdown by the name of its file; the documentation shows these files unchanged.

    Returns:
      The paths of the files.

    Raises:
      OSError: if a file cannot be written; a file is replaced only when complete.
    """
    written = []
    for name, figure, rows in parts:
        assert len({len(row) for row in rows}) == 1, name  # each row has a cell under each title
        path = folder / name
        write_text(path.with_suffix(".csv"), csv_text(rows))
        write_bytes(path.with_suffix(".svg"), _rendered(figure, "svg"))
        write_bytes(path.with_suffix(".png"), _rendered(figure, "png"))
        written += [path.with_suffix(suffix) for suffix in (".png", ".svg", ".csv")]
    for name, text in tables.items():
        written.append(folder / f"{name}.md")
        write_text(written[-1], text)
    return written


def markdown(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def time_table(seconds: dict[str, float]) -> str:
    """Return a table of wall times [s] by name, as Markdown."""
    rows = [[name, f"{value:.0f} s"] for name, value in seconds.items()]
    return markdown(["what", "wall time"], rows)


def _rendered(figure: Figure, form: str) -> bytes:
    """Return the bytes of a picture, without date or random ids, equal for equal figures."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if form == "svg" else None
    with mpl.rc_context({"svg.hashsalt": "swerve"}):
        figure.savefig(buffer, format=form, dpi=300, metadata=metadata)
    return buffer.getvalue()
