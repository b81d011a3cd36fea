"""Figures and tables of ranks against the number of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from swerve.base.figure_style import FAINT, INK, open_sides
from swerve.presentation.shading import COLOURS
from swerve.reproduce.files import SIZE, SMALL, column, markdown
from swerve.reproduce.ranks import Curve
from swerve.reproduce.ways import DISCRETE, GRID, PPO, SOFT_VALUE, Answer

EXACT = "exact files"
STYLES: dict[str, dict[str, Any]] = {
    SOFT_VALUE: {"color": COLOURS(1.0), "ls": "-", "marker": "o", "ms": 3.2},
    GRID: {"color": INK, "ls": "--", "marker": "x", "ms": 3.6},
    PPO: {"color": COLOURS(0.62), "ls": "-.", "marker": "s", "ms": 2.8},
    DISCRETE: {"color": FAINT, "ls": ":", "marker": "^", "ms": 3.2},
    EXACT: {"color": INK, "ls": "none", "marker": "o", "ms": 6.0, "mfc": "none"},
}
LABELS = {GRID: "grid, exact", PPO: "PPO, plain average"}
SHOWN = (1, 3, 5, 10, 20, 30, 65)  # numbers of demonstrations in the table


class Line(NamedTuple):
    """One curve of a panel.

    Attributes:
      way: name of the way, which sets line style and legend.
      name: name in tables.
      curve: the ranks.
    """

    way: str
    name: str
    curve: Curve


class Panel(NamedTuple):
    """Curves of one set of demonstrations by one model.

    Attributes:
      source: name of the demonstrations.
      model: the problem, as the command line names it.
      title: title above the panel.
      lines: the curves.
    """

    source: str
    model: str
    title: str
    lines: list[Line]


def lines_of(answers: Sequence[Answer]) -> list[Line]:
    """Return the curve of each answer, named."""
    return [Line(one.way.name, way_name(one), one.curve) for one in answers]


def way_name(answer: Answer) -> str:
    """Return the name of a way, for a table with its settings."""
    name = answer.way.name
    if name != DISCRETE:
        return LABELS.get(name, name)
    settings = dict(part.split("=") for part in answer.way.solver.partition("?")[2].split("&"))
    part = " of a part" if "low" in settings else ""
    return f"{name}, {settings['num_cells']} cells an axis{part}, {settings['hold']} steps"


def rank_rows(panels: Sequence[Panel]) -> list[list[str]]:
    """Return the numbers of panels as rows of a table."""
    rows = [["demonstrations", "model", "way", "num_demonstrations", "average_rank",
             "interval_low", "interval_high", "first_share"]]  # fmt: skip
    for panel in panels:
        for line in panel.lines:
            columns = (line.curve.rank, *line.curve.interval, line.curve.first)
            for size, *values in zip(line.curve.sizes, *columns, strict=True):
                cells = [f"{value:.4g}" for value in values]
                rows.append([panel.source, panel.model, line.name, str(size), *cells])
    return rows


def draw_ranks(panels: Sequence[Panel]) -> Figure:
    """Draw the average rank of the truth against the number of demonstrations."""
    figure = column(0.6 + 2.0 * len(panels))
    every = figure.subplots(len(panels), squeeze=False)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        for line in panel.lines:
            label, style = LABELS.get(line.way, line.way), STYLES[line.way]
            sizes, curve = line.curve.sizes, line.curve
            axes.plot(sizes, curve.rank, lw=1.1, label=label, zorder=3, **style)
            axes.fill_between(sizes, *curve.interval, color=style["color"], alpha=0.14, lw=0)
        axes.set_title(panel.title, fontsize=SIZE, loc="left", fontweight="bold")
        highest = max(line.curve.interval[1].max() for line in panel.lines)
        _scales(axes, max(panel.lines[0].curve.sizes), highest)
    every[-1].set_xlabel("demonstrations", fontsize=SIZE)
    named = dict(
        pair[::-1] for axes in every for pair in zip(*axes.get_legend_handles_labels(), strict=True)
    )
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=2,
                  fontsize=SMALL, frameon=False, handlelength=3.2)  # fmt: skip
    return figure


def _scales(axes: Axes, most: int, highest: float) -> None:
    """Set both axes to logarithmic scales with plain numbers."""
    size_scale(axes, most)
    axes.set(yscale="log", ylim=(0.9, max(60.0, 1.1 * highest)))
    axes.set_ylabel("average rank of the truth", fontsize=SIZE)
    ranks = [rank for rank in (1, 2, 5, 10, 20, 50, 100) if rank <= axes.get_ylim()[1]]
    axes.set_yticks(ranks, labels=[str(rank) for rank in ranks])
    axes.yaxis.set_minor_locator(NullLocator())


def size_scale(axes: Axes, most: int) -> None:
    """Set the x axis, numbers of demonstrations, to a logarithmic scale with plain numbers."""
    axes.set(xscale="log", xlim=(0.9, 1.1 * most))
    sizes = [size for size in (1, 2, 5, 10, 20, 50) if size <= most]
    axes.set_xticks(sizes, labels=[str(size) for size in sizes])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(axis="y", color=FAINT, alpha=0.25, lw=0.5)
    open_sides(axes, SMALL)


def rank_table(panels: Sequence[Panel]) -> str:
    """Return average ranks and their intervals as Markdown."""
    most = max(max(line.curve.sizes) for panel in panels for line in panel.lines)
    shown = [size for size in SHOWN if size <= most]
    rows = [
        [panel.title, line.name, *(_cell(line.curve, size) for size in shown)]
        for panel in panels
        for line in panel.lines
    ]
    return markdown(["demonstrations and model", "way", *(str(size) for size in shown)], rows)


def _cell(curve: Curve, size: int) -> str:
    """Return the average rank and its interval as text; "" where there is none."""
    if size not in curve.sizes:
        return ""
    place = curve.sizes.index(size)
    low, high = (ends[place] for ends in curve.interval)
    return f"{curve.rank[place]:.1f} ({low:.1f} to {high:.1f})"


def rank_text(panels: Sequence[Panel]) -> str:
    """Return the average ranks as text for the terminal."""
    lines = ["average rank of the truth by the number of demonstrations"]
    for panel in panels:
        lines.append(panel.title)
        for line in panel.lines:
            ranks = ", ".join(
                f"{size}: {rank:.1f}"
                for size, rank in zip(line.curve.sizes, line.curve.rank, strict=True)
                if size in SHOWN
            )
            lines.append(f"  {line.name:<44} {ranks}")
    return "\n".join(lines)
