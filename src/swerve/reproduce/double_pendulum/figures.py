"""Figures, tables and files of the double pendulum."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from swerve.reproduce.double_pendulum.measure import MODEL, Result
from swerve.reproduce.files import SIZE, SMALL, Part, column, time_table
from swerve.reproduce.rank_figures import (
    STYLES,
    Panel,
    draw_ranks,
    lines_of,
    rank_rows,
    rank_table,
    rank_text,
    size_scale,
    way_name,
)
from swerve.reproduce.ways import Answer


def parts(result: Result) -> list[Part]:
    """Return the figures."""
    shown = [panel(result)]
    return [
        Part("double_pendulum_rank", draw_ranks(shown), rank_rows(shown)),
        Part("double_pendulum_time", draw_times(result), time_rows(result)),
    ]


def tables(result: Result) -> dict[str, str]:
    """Return tables as Markdown."""
    return {
        "double_pendulum_ranks": rank_table([panel(result)]),
        "double_pendulum_times": time_table(result.seconds),
    }


def panel(result: Result) -> Panel:
    """Return the panel of ranks."""
    return Panel(result.source.name, MODEL, result.source.name, lines_of(result.answers))


def wall_time(answer: Answer) -> np.ndarray:
    """Return the wall time [s] of an answer from nothing, for each size of its curve."""
    return answer.learn_seconds + answer.task_seconds * np.array(answer.curve.sizes)


def time_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of wall times."""
    rows = [["way", "num_demonstrations", "wall_time_s"]]
    for answer in result.answers:
        for size, seconds in zip(answer.curve.sizes, wall_time(answer), strict=True):
            rows.append([way_name(answer), str(size), f"{seconds:.4g}"])
    return rows


def draw_times(result: Result) -> Figure:
    """Draw the wall time from nothing to an answer against the number of demonstrations."""
    figure = column(2.5)
    axes = figure.subplots()
    for answer in result.answers:
        name, sizes = answer.way.name, answer.curve.sizes
        axes.plot(sizes, wall_time(answer), lw=1.1, label=name, **STYLES[name])
    size_scale(axes, max(result.answers[0].curve.sizes))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("demonstrations", fontsize=SIZE)
    axes.set_ylabel("wall time, learning included [s]", fontsize=SIZE)
    figure.legend(loc="outside lower center", ncols=2, fontsize=SMALL, frameon=False,
                  handlelength=3.2)  # fmt: skip
    return figure


def text(result: Result) -> str:
    """Return the average ranks as text for the terminal."""
    return rank_text([panel(result)])
