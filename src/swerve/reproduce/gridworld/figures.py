"""Figures, tables and files of the gridworld's result. They compute only means and errors.

    curve = mean over the sets,    band = its standard error, s / sqrt(E), with E - 1 in s

Shapes: K thresholds, E sets of demonstrations, L sizes, H hypotheses, R rectangles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Normal, Stroke

from swerve.base.figure_style import FAINT, INK, open_sides
from swerve.presentation.shading import COLOURS
from swerve.reproduce.files import SIZE, SMALL, Part, column, markdown
from swerve.reproduce.gridworld.measure import Curves, Result, labels
from swerve.systems.gridworld import MOVES, Gridworld

STYLES = (
    {"color": COLOURS(1.0), "ls": "-", "marker": "o", "ms": 3.0},
    {"color": COLOURS(0.62), "ls": "--", "marker": "s", "ms": 2.8},
    {"color": COLOURS(0.38), "ls": "-.", "marker": "^", "ms": 3.2},
    {"color": FAINT, "ls": ":", "marker": "v", "ms": 3.2},
)
ARROWS = dict(zip(MOVES, "←→↑↓↖↗↙↘", strict=True))
HATCHES = ("////", "\\\\\\\\", "....", "xxxx")
PROBABILITY = "probability of being entered, no constraint in force"

CURVE_COLUMNS: tuple[str, ...] = (
    "source", "threshold_nats", "num_demonstrations", "num_sets", "num_picks",
    "num_false_positives", "false_positive_rate", "false_positive_rate_error", "kl_nats",
    "kl_nats_error",
)  # fmt: skip


def parts(result: Result) -> list[Part]:
    """Return the figures."""
    return [
        Part("gridworld_curves", draw_curves(result), curve_rows(result)),
        Part("gridworld_violations", draw_violations(result), violation_rows(result)),
    ]


def tables(result: Result) -> dict[str, str]:
    """Return tables as Markdown."""
    return {"gridworld_means": summary(result)}


def sources(result: Result) -> list[tuple[str, Curves, int]]:
    """Return name, curves and index of the threshold, for each curve to show."""
    found = [("swerve", result.curves, k) for k in range(len(result.curves.thresholds))]
    return found + ([] if result.golden is None else [("golden", result.golden, 0)])


def mean_and_error(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and its standard error [L] of values [E, L]; 0 for a single set."""
    number = len(values)
    spread = values.std(axis=0, ddof=1) if number > 1 else np.zeros(values.shape[1])
    return values.mean(axis=0), spread / np.sqrt(number)


def curve_rows(result: Result) -> list[list[str]]:
    """Return the numbers of the curves as rows of a table; errors are standard errors."""
    rows = [list(CURVE_COLUMNS)]
    for name, curves, k in sources(result):
        means = (curves.num_picks[k].mean(axis=0), curves.num_false[k].mean(axis=0))
        values = (*means, *mean_and_error(curves.false_rate[k]), *mean_and_error(curves.kl[k]))
        fixed = (name, curves.thresholds[k])
        for place, size in enumerate(curves.sizes):
            numbers = (size, curves.kl.shape[1], *(float(value[place]) for value in values))
            rows.append([str(cell) for cell in (*fixed, *numbers)])
    return rows


def violation_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of the probabilities of entering each hypothesis."""
    return [
        ["hypothesis", "name", "violation_probability", "is_true_constraint"],
        *(
            [str(index), label, str(float(probability)), str(int(index in result.world.truth))]
            for index, (label, probability) in enumerate(
                zip(labels(_mdp(result)), result.violation, strict=True)
            )
        ),
    ]


def summary(result: Result) -> str:
    """Return means over the sets as Markdown."""
    columns = _columns(result)
    rows = [
        [str(size), *(f"{false:.1f} / {picks:.1f}, {kl:.3f}" for false, picks, kl in means)]
        for size, means in (
            (size, _means(columns, place)) for place, size in enumerate(result.curves.sizes)
        )
    ]
    text = "Means over the sets: false positives / picks, KL in nats.\n\n"
    text += markdown(["demonstrations", *(title for title, _, _ in columns)], rows)
    return text + (f"\n{_agreed(result)}.\n" if result.agreement is not None else "")


def _columns(result: Result) -> list[tuple[str, Curves, int]]:
    """Return title, curves and index of the threshold, for each column of a table."""
    return [
        (f"{'golden, ' if name == 'golden' else ''}{_nats(curves.thresholds[k])}", curves, k)
        for name, curves, k in sources(result)
    ]


def _means(columns: list[tuple[str, Curves, int]], place: int) -> list[tuple[float, float, float]]:
    """Return mean false positives, picks and KL [nats] at one size, for each curve."""
    found = []
    for _, curves, k in columns:
        every = (curves.num_false, curves.num_picks, curves.kl)
        false, picks, kl = (float(values[k, :, place].mean()) for values in every)
        found.append((false, picks, round(kl, 3) + 0.0))
    return found


def _agreed(result: Result) -> str:
    """Return the agreement with golden picks as text."""
    agreement = result.agreement
    assert agreement is not None
    return (
        f"{agreement.same} of {agreement.number} sequences of picks are the golden ones, "
        f"largest KL difference {agreement.error:.0e} nats"
    )


def text(result: Result) -> str:
    """Return means over the sets as text: false positives, picks and KL [nats]."""
    columns = _columns(result)
    lines = [
        "means over the sets: false positives / picks, KL in nats",
        "  ".join([f"{'demonstrations':>14}", *(f"{title:>19}" for title, _, _ in columns)]),
    ]
    for place, size in enumerate(result.curves.sizes):
        means = _means(columns, place)
        cells = [f"{false:>5.1f} /{picks:>5.1f}{kl:>7.3f}" for false, picks, kl in means]
        lines.append("  ".join([f"{size:>14}", *cells]))
    if result.agreement is not None:
        lines.append(_agreed(result))
    return "\n".join(lines)


def draw_curves(result: Result) -> Figure:
    """Draw the rate of false positives and the KL against the number of demonstrations."""
    figure = column(4.6)
    upper, lower = figure.subplots(2, sharex=True)
    for name, curves, k in sources(result):
        for axes, values in ((upper, curves.false_rate[k]), (lower, curves.kl[k])):
            mean, error = mean_and_error(values)
            if name == "golden":
                label = f"golden output, {_nats(curves.thresholds[k])}"
                style: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 6.0, "mfc": "none"}
                axes.plot(
                    curves.sizes,
                    mean,
                    color=INK,
                    mew=0.9,
                    label=label,
                    clip_on=False,
                    zorder=4,
                    **style,
                )
                continue
            style = STYLES[k % len(STYLES)]
            label = f"threshold {_nats(curves.thresholds[k])}"
            axes.plot(curves.sizes, mean, lw=1.3, label=label, clip_on=False, zorder=3, **style)
            band = (np.maximum(mean - error, 0.0), mean + error)
            axes.fill_between(curves.sizes, *band, color=style["color"], alpha=0.2, lw=0)
    upper.set_ylabel("false positives, share of picks", fontsize=SIZE)
    lower.set_ylabel("KL to demonstrations [nats]", fontsize=SIZE)
    lower.set_xlabel("number of demonstrations", fontsize=SIZE)
    lower.set_xscale("log")
    ticks = [size for size in (1, 2, 5, 10, 20, 50, 100) if size <= max(result.curves.sizes)]
    lower.set_xticks(ticks, [str(size) for size in ticks])
    lower.minorticks_off()
    for axes in (upper, lower):
        axes.set_ylim(bottom=0.0)
        axes.grid(color="#e2e2e2", lw=0.6)
        open_sides(axes, SMALL)
    title = f"Mean of {len(result.world.sets)} sets; band: its standard error"
    figure.legend(
        *upper.get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False,
        fontsize=SMALL, handlelength=3.2, title=title, title_fontsize=SMALL, alignment="left",
    )  # fmt: skip
    return figure


def draw_violations(result: Result) -> Figure:
    """Draw the probability under pi_0 of entering each cell, move and feature."""
    figure, mdp = column(5.75), _mdp(result)
    num_bars = len(result.violation) - mdp.num_states
    cells, bars = figure.subplots(2, height_ratios=[mdp.height, 0.4 * num_bars])
    _draw_cells(cells, result, mdp)
    _draw_bars(bars, result, mdp)
    colours = ScalarMappable(Normalize(0.0, 1.0), COLOURS)
    scale = figure.colorbar(colours, ax=cells, location="bottom", aspect=30, pad=0.02)
    scale.set_label(PROBABILITY, fontsize=SIZE)
    scale.ax.tick_params(labelsize=SMALL)
    handles = [Patch(label="true constraint", facecolor="white", edgecolor=INK, lw=2.0)]
    for k, (name, _) in enumerate(mdp.cell_features):
        style: dict[str, Any] = {"hatch": HATCHES[k % len(HATCHES)], "edgecolor": FAINT, "lw": 0.6}
        handles.append(Patch(label=f"feature {name}", facecolor="white", **style))
    place: dict[str, Any] = {"loc": "outside upper left", "ncols": 3, "frameon": False}
    figure.legend(handles=handles, fontsize=SMALL, **place)
    return figure


def _draw_cells(axes: Axes, result: Result, mdp: Gridworld) -> None:
    """Shade cells by probability; hatch features, outline true constraints, mark start and goal."""
    first = len(mdp.cell_features)
    image = result.violation[first : first + mdp.num_states].reshape(mdp.height, mdp.width)
    x, y = (np.arange(size + 1) - 0.5 for size in mdp.shape)
    axes.pcolormesh(x, y, image, cmap=COLOURS, vmin=0, vmax=1, edgecolors="white", lw=0.5)
    for k, (_, feature) in enumerate(mdp.cell_features):
        style: dict[str, Any] = {"fill": False, "hatch": HATCHES[k % len(HATCHES)], "lw": 0}
        for cell in feature:
            corner = (cell[0] - 0.5, cell[1] - 0.5)
            axes.add_patch(Rectangle(corner, 1, 1, edgecolor=FAINT, hatch_linewidth=0.7, **style))
    regions = [*(cells for _, cells in mdp.cell_features), *([cell] for cell in mdp.states)]
    for index, cells in enumerate(regions):
        if index in result.world.truth:
            _outline(axes, np.array(cells, float))
    halo = [Stroke(linewidth=2, foreground="white"), Normal()]
    for (x, y), text in zip(result.world.task, ("S", "G"), strict=True):
        style = {"ha": "center", "va": "center", "fontweight": "bold", "color": INK}
        axes.text(x, y, text, fontsize=SIZE + 1, path_effects=halo, **style)
    axes.set(aspect="equal", xticks=range(mdp.width), yticks=range(mdp.height))
    axes.set_xlabel("x [cells]   (S start, G goal)", fontsize=SIZE)
    axes.set_ylabel("y [cells]", fontsize=SIZE)
    axes.tick_params(labelsize=SMALL, length=0)
    axes.spines[:].set_visible(False)


def _draw_bars(axes: Axes, result: Result, mdp: Gridworld) -> None:
    """Draw moves and features as bars, true constraints outlined."""
    first = len(mdp.cell_features)
    shown = [*range(first + mdp.num_states, len(result.violation)), *range(first)]
    names = labels(mdp)
    texts = [names[index] for index in shown]
    texts = [f"{text.removeprefix('move ')} {ARROWS.get(text[5:], '')}".rstrip() for text in texts]
    value = result.violation[shown]
    rows = np.arange(len(shown))
    bars = axes.barh(rows, value, 0.72, color=COLOURS(value), edgecolor=FAINT, lw=0.5)
    for index, bar, probability in zip(shown, bars, value, strict=True):
        text = "< 0.001" if 0 < probability < 0.0005 else f"{probability:.3f}"
        text += ", true" if index in result.world.truth else ""
        middle = bar.get_y() + bar.get_height() / 2
        axes.text(probability + 0.025, middle, text, va="center", fontsize=SMALL, color=INK)
    axes.set_yticks(rows, texts)
    axes.set(xlim=(0.0, 1.35), ylim=(len(shown) - 0.5, -0.5), xticks=[0, 0.25, 0.5, 0.75, 1])
    axes.set_xlabel(PROBABILITY, fontsize=SIZE)
    open_sides(axes, SMALL)
    axes.tick_params(axis="y", length=0)


def _outline(axes: Axes, cells: np.ndarray) -> None:
    """Outline cells [R, 2] together, on their inner side so that neighbours stay apart."""
    squares = cells[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2
    sides = [sorted(map(tuple, square[k : k + 2].tolist())) for square in squares for k in range(4)]
    lines = LineCollection([side for side in sides if sides.count(side) == 1])
    lines.set(color=INK, linewidth=3.6, capstyle="projecting", zorder=3)
    lines.set(path_effects=[Stroke(linewidth=5.4, foreground="white"), Normal()])
    axes.add_collection(lines, autolim=False)
    region = Outline.make_compound_path(*(Outline(square, closed=True) for square in squares))
    lines.set_clip_path(region, axes.transData)


def _mdp(result: Result) -> Gridworld:
    mdp = result.world.problem.mdp
    assert isinstance(mdp, Gridworld)
    return mdp


def _nats(threshold: float) -> str:
    return f"{threshold:g} nat{'' if threshold == 1 else 's'}"
