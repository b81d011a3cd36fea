"""Figures, tables and files of the car's result. They compute only counts and means.

Shapes: D drives, H hypotheses.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from swerve.base.figure_style import FAINT, INK, open_sides
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.grid import GridHypotheses
from swerve.presentation.shading import COLOURS
from swerve.reproduce.car.measure import (
    EXACT,
    NEXT,
    NUM_FREE,
    OBSTACLE,
    OTHER,
    PAPER_BETA,
    SEVEN,
    TIED,
    TRUTH,
    Result,
    Single,
    verdict,
)
from swerve.reproduce.files import SIZE, SMALL, Part, column, markdown, time_table
from swerve.systems.car import GOAL_LINE, TRACK

VERDICTS = (EXACT, NEXT, OTHER, TIED)
PAPER = {EXACT: "3", NEXT: "4", OTHER: "0", TIED: ""}  # counts in the paper, of seven drives
MOST_DRAWN = 40  # largest number of drives in the picture, to keep it readable


def parts(result: Result) -> list[Part]:
    """Return the figures."""
    return [
        Part("car_track", draw_track(result), region_rows(result)),
        Part("car_early", draw_early(result), drive_rows(result)),
    ]


def tables(result: Result) -> dict[str, str]:
    """Return tables as Markdown."""
    return {
        "car_drives": _count_table(result),
        "car_facts": _fact_table(result),
        "car_regions": _region_table(result),
        "car_times": time_table(result.seconds),
    }


def corners(result: Result) -> np.ndarray:
    """Return x and y of the corners of each region [H, 4]: x low, x high, y low, y high [m]."""
    hypotheses = result.evidence.problem.hypotheses
    assert isinstance(hypotheses, GridHypotheses)
    boxes = [hypotheses.constraint(index) for index in range(len(hypotheses))]
    return np.array([[*box.intervals["x"], *box.intervals["y"]] for box in boxes])


def counts(singles: Sequence[Single]) -> dict[str, int]:
    """Return the number of drives by verdict on their first region: exact, next to it, other, tied.

    A first place that several regions share counts as tied.
    """
    found = Counter(TIED if one.tied > 1 else verdict(one.first) for one in singles)
    return {name: found[name] for name in VERDICTS}


def mean_posterior(singles: Sequence[Single]) -> np.ndarray:
    """Return the posterior [H + 1] of a single drive, averaged over the drives."""
    return np.mean([one.posterior for one in singles], axis=0)


def region_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of each region: its corners, evidence and posterior."""
    single, seven = mean_posterior(result.singles), result.seven.posterior
    rows = [["region", "x_low_m", "x_high_m", "y_low_m", "y_high_m", "log_avoid_nats",
             "is_bound", "posterior_of_one_drive", "posterior_of_seven"]]  # fmt: skip
    for index, sides in enumerate(corners(result)):
        numbers = (*sides, result.evidence.log_ratio[0, index])
        belief = (single[index], seven.hypotheses[index])
        is_bound = str(bool(result.evidence.is_floored[0, index])).lower()
        cells = [f"{value:.5g}" for value in numbers], [f"{value:.5g}" for value in belief]
        rows.append([str(index), *cells[0], is_bound, *cells[1]])
    return [*rows, ["none", *[""] * 6, f"{single[-1]:.5g}", f"{seven.none:.5g}"]]


def drive_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of each drive: its first region, and when a monitor knew."""
    rows = [["drive", "first", "is", "tied", "bounds", "y_exact_m", "y_near_m", "paper_beta_first",
             "paper_beta_tied"]]  # fmt: skip
    every = zip(result.drives, result.singles, result.early, result.paper, strict=True)
    for drive, single, early, paper in every:
        found = verdict(single.first)
        known = (f"{early.exact:.4g}", f"{early.near:.4g}")
        cells = (single.first, found, single.tied, single.bounds, *known, paper.first, paper.tied)
        rows.append([drive.name, *(str(cell) for cell in cells)])
    return rows


def draw_track(result: Result) -> Figure:
    """Draw the drives, and the posterior of each region after one drive and after seven."""
    figure = column(4.4)
    left, right = figure.subplots(1, 2, sharey=True)
    seven = result.seven.posterior.hypotheses
    for axes, values, title in (
        (left, mean_posterior(result.singles)[:-1], "after one drive"),
        (right, seven, f"after {SEVEN} drives"),
    ):
        for sides, value in zip(corners(result), values, strict=True):
            _shade(axes, sides, float(value))
        axes.set_title(title, fontsize=SIZE, loc="left", fontweight="bold")
        axes.set(xlim=TRACK, ylim=(0.0, GOAL_LINE))
        axes.set_xlabel("x [m]", fontsize=SIZE)
        axes.tick_params(labelsize=SMALL)
        _outline(axes)
    for number, drive in enumerate(result.drives[:MOST_DRAWN]):
        label = "_" if number else "a drive"
        left.plot(*drive.states[:, :2].T, color=INK, lw=0.4, alpha=0.5, label=label, zorder=3)
    left.set_ylabel("y, along the track [m]", fontsize=SIZE)
    shades = ScalarMappable(Normalize(0.0, 1.0), COLOURS)
    scale = figure.colorbar(shades, ax=(left, right), location="bottom", aspect=30, pad=0.02)
    scale.set_label("posterior probability of the region", fontsize=SMALL)
    scale.ax.tick_params(labelsize=SMALL)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2,
                  fontsize=SMALL, frameon=False)  # fmt: skip
    return figure


def _shade(axes: Axes, sides: np.ndarray, value: float) -> None:
    """Draw a region in the colour of its posterior, with the number where it is 0.05 or more."""
    x_low, x_high, y_low, y_high = sides
    size = (x_high - x_low, y_high - y_low)
    colour = COLOURS(value)
    style = {"facecolor": colour, "edgecolor": FAINT, "lw": 0.4}
    axes.add_patch(Rectangle((x_low, y_low), *size, **style))
    if value >= 0.05:
        ink = "white" if value > 0.5 else INK
        middle = (0.5 * (x_low + x_high), 0.5 * (y_low + y_high))
        style = {"fontsize": SMALL, "color": ink, "zorder": 5}
        axes.text(*middle, f"{value:.2f}", ha="center", va="center", **style)


def _outline(axes: Axes) -> None:
    """Draw the obstacle as a hatched rectangle."""
    (x_low, x_high), (y_low, y_high) = OBSTACLE.intervals["x"], OBSTACLE.intervals["y"]
    size = (x_high - x_low, y_high - y_low)
    style = {"fill": False, "edgecolor": INK, "lw": 1.6, "hatch": "////", "alpha": 0.8}
    axes.add_patch(Rectangle((x_low, y_low), *size, label="the obstacle", zorder=4, **style))


def draw_early(result: Result) -> Figure:
    """Draw the share of drives for which a monitor knows, against how far the car has come."""
    figure = column(2.6)
    axes = figure.subplots()
    front, back = OBSTACLE.intervals["y"]
    axes.axvspan(front, back, color=FAINT, alpha=0.25, lw=0, label="beside the obstacle")
    y = np.linspace(0.0, GOAL_LINE, 400)
    for name, style, field in (
        ("believes in the region or one next to it", "-", "near"),
        ("believes in the true region", "--", "exact"),
    ):
        known = np.array([getattr(one, field) for one in result.early])
        share = (known <= y[:, None]).mean(axis=1)
        axes.plot(y, share, ls=style, color=COLOURS(1.0), lw=1.3, label=name)
    axes.set(xlim=(3.0, GOAL_LINE), ylim=(-0.02, 1.02))
    axes.set_xlabel("y of the car [m]", fontsize=SIZE)
    axes.set_ylabel("share of the drives", fontsize=SIZE)
    open_sides(axes, SMALL)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=1,
                  fontsize=SMALL, frameon=False)  # fmt: skip
    return figure


def _count_table(result: Result) -> str:
    """Return a table of how often the first region is the true one, as Markdown."""
    beta, num = result.evidence.problem.beta, len(result.drives)
    theirs = [PAPER[name] for name in VERDICTS]
    rows = [[f"the paper, beta {PAPER_BETA:g}", str(SEVEN), *theirs, "", ""]]
    effective = _share(result.paper_evidence)
    for name, singles in (
        (f"Swerve, beta {beta:.3g}", result.singles),
        (f"samples brought to beta {PAPER_BETA:g}, effective {effective}", result.paper),
    ):
        found, tied = counts(singles), np.mean([one.tied for one in singles])
        shares = [f"{count} ({count / num:.0%})" for count in found.values()]
        bounds = sum(one.bounds > 0 for one in singles)
        rows.append([name, str(num), *shares, f"{tied:.1f}", str(bounds)])
    titles = ["single drives", "number", *VERDICTS, "regions tied for the first, mean",
              "drives that leave out a region with a bound alone"]  # fmt: skip
    return markdown(titles, rows)


def _fact_table(result: Result) -> str:
    """Return a table of single measurements, as Markdown."""
    fit, front = result.fit, OBSTACLE.intervals["y"][0]
    near, exact = (
        np.array([getattr(one, field) for one in result.early]) for field in ("near", "exact")
    )
    low, high = fit.interval
    seven = result.seven.posterior
    true, paper = seven.hypotheses[TRUTH], result.paper_evidence
    first = verdict(int(result.seven.ranking[0]))
    off, late = _ends(result)
    rows = [
        ["beta of drives with nothing in the way", f"{fit.beta:.3g} ({low:.3g} to {high:.3g})"],
        ["drives with nothing in the way", str(NUM_FREE)],
        [f"nominal trajectories that leave the track, of {NUM_KEPT}", f"{off:.0%}"],
        [f"nominal trajectories that never arrive, of {NUM_KEPT}", f"{late:.0%}"],
        ["effective sample size", _share(result.evidence)],
        [f"the same of samples brought to beta {PAPER_BETA:g}", _share(paper)],
        ["first after seven drives", first],
        ["posterior of the true region after seven", f"{true:.3f}"],
        ["posterior of no constraint after seven", f"{seven.none:.2g}"],
        ["random sets of seven with the truth first", f"{result.seven_share:.0%}"],
        ["monitor believes in it or a neighbour from y [m] on, median", _median(near)],
        ["drives in which it does before the obstacle", f"{np.mean(near < front):.0%}"],
        ["monitor believes in the true region from y [m] on, median", _median(exact)],
    ]
    return markdown(["what", "figure"], rows)


def _share(evidence: Evidence) -> str:
    """Return the effective sample size and the number of trajectories as text."""
    return f"{evidence.effective_sample_size[0]:.0f} of {evidence.num_trajectories}"


def _median(values: np.ndarray) -> str:
    """Return the median as text; drives of which a monitor never knows count as the largest."""
    middle = float(np.median(np.where(np.isnan(values), math.inf, values)))
    return f"{middle:.2f}" if math.isfinite(middle) else "never"


def _ends(result: Result) -> tuple[float, float]:
    """Return the shares of nominal trajectories that leave the track and that never arrive."""
    last = result.evidence.samples.kept[0, :, -1]
    off = (last[:, 0] < TRACK[0]) | (last[:, 0] > TRACK[1])
    return float(off.mean()), float((~off & (last[:, 1] < GOAL_LINE)).mean())


def _region_table(result: Result) -> str:
    """Return a table of the probability of avoiding each region of the right lane, as Markdown."""
    evidence = result.evidence
    rows = []
    for index, (x_low, _, low, high) in enumerate(corners(result)):
        if x_low > TRACK[0]:
            value = f"{evidence.log_ratio[0, index]:.1f}"
            error = f" ± {evidence.standard_error[0, index]:.1f}"
            is_bound = evidence.is_floored[0, index]
            shown = f"< {value}" if is_bound else value + error
            rows.append([f"{low:.2f} to {high:.2f}", shown])
    return markdown(["right lane, y [m]", "log probability of avoiding it [nats]"], rows)


def text(result: Result) -> str:
    """Return the main measurements as text for the terminal."""
    num, found = len(result.drives), counts(result.singles)
    belief = result.seven.posterior
    true = belief.hypotheses[TRUTH]
    return (
        f"beta of drives with nothing in the way: {result.fit}\n"
        f"single drives, first region: {found[EXACT]} of {num} exact, {found[NEXT]} next to it, "
        f"{found[OTHER]} other, {found[TIED]} tied (the paper: 3, 4, 0 of {SEVEN})\n"
        f"after {SEVEN} drives the true region has {true:.3f}, no constraint {belief.none:.2g}"
    )
