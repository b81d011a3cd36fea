"""Figures, tables and files of the pendulum result; nothing is computed but means and errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swerve.figures import FAINT, INK, open_sides
from swerve.reproduce import files
from swerve.reproduce.files import SIZE, SMALL, column, markdown
from swerve.reproduce.pendulum import (
    CONSTRAINTS,
    DISCRETE,
    FOLLOWED,
    GRID,
    PPO,
    REAL,
    SOFT_VALUE,
    Answer,
    Exact,
    Result,
)
from swerve.reproduce.ranks import Curve
from swerve.shading import COLOURS

EXACT = "exact files"
STYLES: dict[str, dict[str, Any]] = {
    SOFT_VALUE: {"color": COLOURS(1.0), "ls": "-", "marker": "o", "ms": 3.2},
    GRID: {"color": INK, "ls": "--", "marker": "x", "ms": 3.6},
    PPO: {"color": COLOURS(0.62), "ls": "-.", "marker": "s", "ms": 2.8},
    DISCRETE: {"color": FAINT, "ls": ":", "marker": "^", "ms": 3.2},
    EXACT: {"color": INK, "ls": "none", "marker": "o", "ms": 6.0, "mfc": "none"},
}
LABELS = {GRID: "grid, exact", PPO: "PPO, plain average"}
TITLES = {
    "C1": "C1, near hanging",
    "C2": "C2, where it falls",
    REAL: "C1, the authors' demonstrations",
}
SHOWN = (1, 3, 5, 10, 20, 30, 65)  # sizes in the table


def write(result: Result, folder: Path) -> list[Path]:
    """Write the figures as PNG and SVG, the numbers in them as CSV, tables as Markdown.

    Returns:
      The files, in a folder that is created if need be.

    Raises:
      OSError: if one cannot be written; files are replaced when complete.
    """
    parts = []
    for max_torque in result.scale.max_torques:
        panels = [(name, max_torque) for name in CONSTRAINTS]
        name = f"pendulum_rank_torque{max_torque:g}"
        parts.append((name, draw(result, panels), rank_rows(result, panels)))
    if REAL in result.demonstrations:
        panels = [(REAL, max_torque) for max_torque in result.scale.max_torques]
        parts.append(("pendulum_rank_real", draw(result, panels), rank_rows(result, panels)))
    return files.write(folder, "pendulum", parts, summary(result))


def curves(result: Result, source: str, max_torque: float) -> list[tuple[str, Curve]]:
    """Return the name and the curve of each way for one panel, exact files last."""
    found = [(one.way.name, one.curve) for one in _of(result.answers, source, max_torque)]
    if source == REAL:
        found += [(EXACT, one.curve) for one in result.exact if one.max_torque == max_torque]
    return found


def rank_rows(result: Result, panels: Sequence[tuple[str, float]]) -> list[list[str]]:
    """Return the rows of a table of what panels show."""
    rows = [["demonstrations", "max_torque", "way", "num_demonstrations", "average_rank",
             "interval_low", "interval_high", "first_share"]]  # fmt: skip
    for source, max_torque in panels:
        for name, curve in curves(result, source, max_torque):
            columns = (curve.rank, *curve.interval, curve.first)
            for size, *values in zip(curve.sizes, *columns, strict=True):
                cells = [f"{value:.4g}" for value in values]
                rows.append([source, f"{max_torque:g}", name, str(size), *cells])
    return rows


def draw(result: Result, panels: Sequence[tuple[str, float]]) -> Figure:
    """Draw the average rank of the truth against the number of demonstrations."""
    figure = column(0.6 + 2.0 * len(panels))
    every = figure.subplots(len(panels), squeeze=False)[:, 0]
    for axes, (source, max_torque) in zip(every, panels, strict=True):
        for name, curve in curves(result, source, max_torque):
            label = LABELS.get(name, name)
            axes.plot(curve.sizes, curve.rank, lw=1.1, label=label, zorder=3, **STYLES[name])
            if name != EXACT:
                colour = STYLES[name]["color"]
                axes.fill_between(curve.sizes, *curve.interval, color=colour, alpha=0.18, lw=0)
        title = f"{TITLES[source]}; torques to {max_torque:g}"
        axes.set_title(title, fontsize=SIZE, loc="left", fontweight="bold")
        _scales(axes, max(result.answers[0].curve.sizes))
    every[-1].set_xlabel("demonstrations", fontsize=SIZE)
    handles, labels = every[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=SMALL,
                  frameon=False, handlelength=3.2)  # fmt: skip
    return figure


def _scales(axes: Axes, most: int) -> None:
    """Give both axes plain numbers on a logarithmic scale."""
    axes.set(xscale="log", yscale="log", ylim=(0.9, 60.0), xlim=(0.9, 1.1 * most))
    axes.set_ylabel("average rank of the truth", fontsize=SIZE)
    sizes = [size for size in (1, 2, 5, 10, 20, 50) if size <= most]
    axes.set_xticks(sizes, labels=[str(size) for size in sizes])
    ranks = (1, 2, 5, 10, 20, 50)
    axes.set_yticks(ranks, labels=[str(rank) for rank in ranks])
    axes.minorticks_off()
    axes.grid(axis="y", color=FAINT, alpha=0.25, lw=0.5)
    open_sides(axes, SMALL)


def summary(result: Result) -> str:
    """Return the tables as Markdown."""
    return _rank_table(result) + _nats_table(result) + _time_table(result)


def _rank_table(result: Result) -> str:
    most = max(max(answer.curve.sizes) for answer in result.answers)
    shown = [size for size in SHOWN if size <= most]
    rows = []
    for max_torque in result.scale.max_torques:
        for source in result.demonstrations:
            for name, curve in curves(result, source, max_torque):
                fixed = [source, f"{max_torque:g}", _name(result, name, source, max_torque)]
                rows.append([*fixed, *(_cell(curve, size) for size in shown)])
    titles = ["demonstrations", "torques to", "way", *(str(size) for size in shown)]
    return markdown(titles, rows)


def _cell(curve: Curve, size: int) -> str:
    """Return average rank and half the width of its interval."""
    if size not in curve.sizes:
        return ""
    place = curve.sizes.index(size)
    low, high = (ends[place] for ends in curve.interval)
    return f"{curve.rank[place]:.1f} ({low:.1f} to {high:.1f})"


def _name(result: Result, name: str, source: str, max_torque: float) -> str:
    """Return what a way is called, with the settings of the best table."""
    if name != DISCRETE:
        return LABELS.get(name, name)
    (answer,) = [one for one in _of(result.answers, source, max_torque) if one.way.name == name]
    _, _, settings = answer.way.solver.partition("?")
    cells, hold = (part.partition("=")[2] for part in settings.split("&"))
    return f"{name}, {cells} x {cells} cells, {hold} steps"


def _nats_table(result: Result) -> str:
    """Return nats and errors on the demonstrations of a folder; nothing without one."""
    rows = []
    for exact in result.exact:
        nats = [f"{exact.nats[cell]:.2f}" for cell in FOLLOWED]
        rows.append([f"{exact.max_torque:g}", EXACT, *nats, "", ""])
        answers = _of(result.answers, REAL, exact.max_torque)
        rows += [[f"{exact.max_torque:g}", *_nats_row(result, one, exact)] for one in answers]
    cells = [f"cell {cell} [nats]" for cell in FOLLOWED]
    titles = ["torques to", "way", *cells, "error, median task", "error, worst task"]
    return markdown(titles, rows) if rows else ""


def _nats_row(result: Result, answer: Answer, exact: Exact) -> list[str]:
    found, error = answer.result, np.abs(answer.violation - exact.violation).max(axis=1)
    nats = [
        "struck out"
        if found.struck_out[cell]
        else f"{found.log_likelihood[cell]:.2f}"
        + (f" ± {found.standard_error[cell]:.2f}" if answer.way.name != DISCRETE else "")
        for cell in FOLLOWED
    ]
    name = _name(result, answer.way.name, REAL, answer.max_torque)
    return [name, *nats, f"{np.median(error):.3f}", f"{error.max():.3f}"]


def _time_table(result: Result) -> str:
    """Return how long what took."""
    rows = [[name, f"{seconds:.0f} s"] for name, seconds in result.seconds.items()]
    return markdown(["what", "wall time"], rows)


def table(result: Result) -> str:
    """Return what the terminal shows: the average ranks."""
    lines = [f"{'demonstrations':<16}{'torques':>8}  {'way':<20}{'average rank of the truth'}"]
    for max_torque in result.scale.max_torques:
        for source in result.demonstrations:
            for name, curve in curves(result, source, max_torque):
                ranks = ", ".join(
                    f"{size}: {rank:.1f}"
                    for size, rank in zip(curve.sizes, curve.rank, strict=True)
                    if size in SHOWN
                )
                lines.append(f"{source:<16}{max_torque:>8g}  {name:<20}{ranks}")
    return "\n".join(lines)


def _of(answers: Sequence[Answer], source: str, max_torque: float) -> list[Answer]:
    return [one for one in answers if one.source == source and one.max_torque == max_torque]
