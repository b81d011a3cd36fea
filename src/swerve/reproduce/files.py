"""Figures of published results as files: PNG, SVG, and the numbers in them as CSV."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swerve import store
from swerve.tables import csv_text

WIDTH = 3.5  # in, a column of a paper
SIZE, SMALL = 8.0, 7.0  # pt


def column(height: float) -> Figure:
    """Return a figure as wide as a column, of some height [in]."""
    figure = Figure((WIDTH, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def write(folder: Path, parts: Sequence[tuple[str, Figure, list[list[str]]]]) -> list[Path]:
    """Write figures as PNG and SVG, and the rows of their numbers as CSV.

    Args:
      folder: created if need be.
      parts: the name of the files, the figure and the rows of each.

    Raises:
      OSError: if one cannot be written; files are replaced when complete.
    """
    written = []
    for name, figure, rows in parts:
        path = folder / name
        store.write_text(path.with_suffix(".csv"), csv_text(rows))
        store.write_bytes(path.with_suffix(".svg"), _rendered(figure, "svg"))
        store.write_bytes(path.with_suffix(".png"), _rendered(figure, "png"))
        written += [path.with_suffix(suffix) for suffix in (".png", ".svg", ".csv")]
    return written


def _rendered(figure: Figure, form: str) -> bytes:
    """Return a picture whose bytes depend on nothing but what it shows."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if form == "svg" else None
    with mpl.rc_context({"svg.hashsalt": "swerve"}):
        figure.savefig(buffer, format=form, dpi=300, metadata=metadata)
    return buffer.getvalue()
