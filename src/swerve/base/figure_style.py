"""Give all pictures the same look: colours, a header above the axes, open sides; write the files.

Only matplotlib's objects are used, never pyplot: no window opens and no global state changes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend

from swerve.base import files
from swerve.base.phrases import wrapped

WIDTH, MIN_WIDTH = 8.4, 2.5  # in: default width of a picture, and least width allowed

INK, FAINT, ALARM = "#1a1a1a", "#5f5f5f", "#a63603"  # colours of text, side notes and warnings


def headed(
    header: list[tuple[str, float, str]], width: float, height: float, used: float
) -> Figure:
    """Return a figure with a header of text lines, and room for axes below the header.

    Args:
      header: lines as (text, size [pt], colour).
      width: width of the figure [in].
      height: height of the room below the header [in].
      used: width of the room that axes may use [in].

    Raises:
      ValueError: if the figure is too narrow for its text.
    """
    if width < MIN_WIDTH:
        raise ValueError(f"width: expected at least {MIN_WIDTH} in, got {width}")
    lines = []
    for text, size, colour in header:
        lines += [(line, size, colour) for line in wrapped(text, width - 0.3, size).split("\n")]
    top = 0.15 + sum(1.4 * size / 72 for _, size, _ in lines)
    figure = Figure((width, height + top), facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine(
        ConstrainedLayoutEngine(rect=(0, 0, used / width, height / (height + top)))
    )
    y = height + top - 0.1
    for text, size, colour in lines:
        weight = "normal" if colour == FAINT else "bold"
        style: dict[str, Any] = {"fontsize": size, "color": colour, "fontweight": weight}
        figure.text(0.12 / width, y / (height + top), text, va="top", parse_math=False, **style)
        y -= 1.4 * size / 72
    return figure


def open_sides(axes: Axes, size: float = 8.0) -> None:
    """Hide the top and right sides of axes; set the size [pt] of the numbers at the other sides."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=size)


def plain(legend: Legend) -> None:
    """Show the texts of a legend as they are: names of others may hold the signs of formulas."""
    for text in legend.get_texts():
        text.set_parse_math(False)


def written(figure: Figure, path: str | Path | None) -> Figure:
    """Write a figure to a file, if a file is named, and return the figure.

    The suffix tells the format; without a suffix the file becomes a .png.
    """
    if path is not None:
        path = Path(path) if Path(path).suffix else Path(f"{path}.png")
        form = path.suffix[1:]
        files.replace(path, lambda file: figure.savefig(file, format=form, dpi=200))
    return figure
