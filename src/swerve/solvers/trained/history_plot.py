"""Draw a training: distance from pi_0, evenness of the weights, consistency of the soft value.

    KL [nats],  ESS / N [%],  residual [nats]   against   time and environment steps

Shapes: C chunks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from swerve.base.figure_style import FAINT, INK, WIDTH, headed, open_sides, written
from swerve.solvers.base import Nominal
from swerve.solvers.trained.probe import Progress, Reading

HEIGHT = 5.8  # in, of the three panels
LEAST = 1e-3  # nats: smaller values, and estimates below 0, are drawn here on the log scale
LONG = 180.0  # s: a training at least this long is drawn in minutes
MEDIAN = {"color": "#0072b2", "ls": "-", "marker": "o", "ms": 3.5, "lw": 1.6}
WORST = {"color": "#d55e00", "ls": "--", "marker": "s", "ms": 3.5, "lw": 1.4, "mfc": "white"}
NOTE = "The KL uses log Z of the sampled trajectories: an alarm, too small where they miss modes"
FORBIDDEN = "; not drawn where all sampled trajectories enter a known constraint"


class WithHistory(Nominal, Protocol):
    """A trained nominal distribution that keeps the history of its training."""

    @property
    def history(self) -> np.ndarray:
        """[C, 6] how training went, a `Progress` each row."""
        ...


def plot_training(nominal: WithHistory, path: str | Path | None = None) -> Figure:
    """Draw KL, ESS and residual against the time and the steps of training.

    Args:
      nominal: the trained nominal distribution.
      path: a file to write, whose suffix tells the format, or None.

    Raises:
      ValueError: if matplotlib knows no such format.
    """
    history = dict(zip(Progress._fields, nominal.history.T, strict=True))
    unit, seconds = time_unit(history["seconds"][-1])
    time = history["seconds"] / seconds
    figure = headed(_header(nominal, time[-1], unit), WIDTH, HEIGHT, WIDTH)
    kl, share, residual = figure.subplots(3, sharex=True, height_ratios=(1.4, 1.0, 1.0))
    for axes, values, style, label in (
        (kl, history["worst_kl"], WORST, "worst task"),
        (kl, history["kl"], MEDIAN, "median"),
        (residual, history["residual"], MEDIAN, None),
    ):
        axes.plot(time, np.maximum(values, LEAST), label=label, **style)
    share.plot(time, 100.0 * history["effective_share"], **MEDIAN)
    for axes in (kl, residual):
        log_scale(axes)
    labels = ("KL [nats]", "ESS / N [%]", "residual [nats]")
    for axes, label in zip((kl, share, residual), labels, strict=True):
        finish(axes, label)
    share.set_ylim(-4.0, 104.0)
    residual.set_xlim(0.0, 1.03 * time[-1])
    residual.set_xlabel(f"time [{unit}]", fontsize=9)
    _mark_steps(kl, time, history["num_steps"])
    figure.legend(loc="outside lower left", ncols=2, frameon=False, fontsize=8, reverse=True)
    return written(figure, path)


def time_unit(end: float) -> tuple[str, float]:
    """Return the unit in which to show times up to `end` [s], and the seconds in that unit."""
    return ("min", 60.0) if end >= LONG else ("s", 1.0)


def log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with plain numbers, at least three of them."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low = min(low, high / 10.0)  # a decade has three numbers at least
    axes.set_ylim(low, high)
    is_short = high < 1000.0 * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def finish(axes: Axes, label: str) -> None:
    """Label the vertical axis and draw horizontal grid lines."""
    axes.set_ylabel(label, fontsize=9)
    open_sides(axes)
    axes.grid(axis="y", color="#dddddd", lw=0.6)


def _header(nominal: WithHistory, end: float, unit: str) -> list[tuple[str, float, str]]:
    """Return the lines above the picture: solver, length and last reading of the training."""
    last = Progress(*nominal.history[-1])
    num_steps = f"{last.num_steps / 1e6:.3g} million"
    reading = str(Reading(last.kl, last.worst_kl, last.effective_share)).replace("  ", ", ")
    note = NOTE + ("" if np.isfinite(nominal.history).all() else FORBIDDEN)
    return [
        (f"{nominal.solver.name} after {end:.3g} {unit}, {num_steps} steps: {reading}", 11.5, INK),
        (f"{nominal.problem.record.summary}. {note}.", 7.5, FAINT),
    ]


def _mark_steps(axes: Axes, time: np.ndarray, num_steps: np.ndarray) -> None:
    """Write numbers of environment steps above the axes, at the times when they were reached."""
    steps = MaxNLocator(6).tick_values(num_steps[0], num_steps[-1])
    steps = steps[(steps >= num_steps[0]) & (steps <= num_steps[-1])]
    if len(num_steps) == 1:
        steps = num_steps
    top = axes.secondary_xaxis("top")
    top.set_xticks(np.interp(steps, num_steps, time), [f"{x / 1e6:.3g}" for x in steps])
    top.set_xlabel("environment steps [millions]", fontsize=9)
    top.tick_params(labelsize=8)
