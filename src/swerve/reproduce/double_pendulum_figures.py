"""Figures, tables and files of the double pendulum."""

from __future__ import annotations

from pathlib import Path

from swerve.reproduce import files
from swerve.reproduce.double_pendulum import MODEL, Result
from swerve.reproduce.rank_figures import (
    Panel,
    draw_ranks,
    lines_of,
    rank_rows,
    rank_table,
    rank_text,
    time_table,
)


def write(result: Result, folder: Path) -> list[Path]:
    """Write the figure as PNG and SVG, the numbers in it as CSV, tables as Markdown.

    Returns:
      The files, in a folder that is created if need be.

    Raises:
      OSError: if one cannot be written; files are replaced when complete.
    """
    shown = [panel(result)]
    parts = [("double_pendulum_rank", draw_ranks(shown), rank_rows(shown))]
    tables = {
        "double_pendulum_ranks": rank_table(shown),
        "double_pendulum_times": time_table(result.seconds),
    }
    return files.write(folder, parts, tables)


def panel(result: Result) -> Panel:
    """Return what is to be shown."""
    return Panel(result.source.name, MODEL, result.source.name, lines_of(result.answers))


def table(result: Result) -> str:
    """Return what the terminal shows."""
    return rank_text([panel(result)])
