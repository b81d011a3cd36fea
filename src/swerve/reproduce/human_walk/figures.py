"""Figures, tables and files of the human walkers' result. They compute only percentiles.

The map shows at the centre of each square its log-likelihood ratio [nats] by all tracks.

Shapes: H hypotheses, N numbers of tracks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke

from swerve.base.figure_style import FAINT, INK, open_sides
from swerve.presentation.shading import COLOURS
from swerve.reproduce.files import SIZE, SMALL, Part, column, markdown
from swerve.reproduce.human_walk.measure import (
    INTERVAL,
    WIDTH,
    Answer,
    Result,
    centre,
    elsewhere_json,
    picks_json,
    squares,
)

WALL = "#8c8c8c"
DARK, LIGHT = COLOURS(1.0), COLOURS(0.5)


def parts(result: Result) -> list[Part]:
    """Return the figures."""
    return [
        Part("human_walk_map", draw_map(result), map_rows(result)),
        Part("human_walk_belief", draw_belief(result), belief_rows(result)),
        Part("human_walk_beta", draw_beta(result), beta_rows(result)),
        Part("human_walk_sensitivity", draw_sensitivity(result), sensitivity_rows(result)),
    ]


def tables(result: Result) -> dict[str, str]:
    """Return tables as Markdown."""
    return {"human_walk_picks": summary(result)}


def summary(result: Result) -> str:
    """Return beta and, at it and about half and twice as much, the picks as Markdown."""
    rows = []
    for answer in result.sensitivity:
        for name, pick in _found(answer):
            x, y = (f"{value:.2f}" for value in pick["centre"])
            error = f" ± {pick['standard_error']:.1f}" if "standard_error" in pick else ""
            odds = f"{pick['log_odds']:.1f}" if "log_odds" in pick else ""
            rows.append([f"{answer.beta:.2f}", name, x, y, f"{pick['gain_nats']:.1f}{error}", odds])
    titles = ["beta [1/m]", "pick", "x [m]", "y [m]", "gain [nats]", "log odds of a constraint"]
    return "; ".join(_head(result)) + ".\n\n" + markdown(titles, rows)


def text(result: Result) -> str:
    """Return beta and, at it and about half and twice as much, the picks as text."""
    lines = [
        *_head(result),
        f"{'beta':>6}  {'pick':>9}  {'x [m]':>7} {'y [m]':>7}  {'nats':>6} {'+-':>5}  log odds",
    ]
    for answer in result.sensitivity:
        for name, pick in _found(answer):
            x, y = pick["centre"]
            error = f"{pick['standard_error']:>5.1f}" if "standard_error" in pick else " " * 5
            odds = f"{pick['log_odds']:>8.1f}" if "log_odds" in pick else ""
            lines.append(
                f"{answer.beta:>6.2f}  {name:>9}  {x:>7.2f} {y:>7.2f}  {pick['gain_nats']:>6.1f} "
                f"{error}  {odds}".rstrip()
            )
        if not answer.picks:
            lines.append(f"{answer.beta:>6.2f}  {'none':>9}")
    return "\n".join(lines)


def _head(result: Result) -> list[str]:
    """Return lines with the number of tracks, beta and the probability of no constraint."""
    beta, left_out = result.beta, result.tracks.left_out
    skipped = ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count)
    low, high = beta.interval
    none = result.answer.inference.posterior.none
    return [
        f"{len(result.tracks.used)} tracks" + (f"; left out: {skipped}" if skipped else ""),
        f"beta {beta.value:.3g} per metre, 95 % interval {low:.3g} to {high:.3g}, above "
        f"{beta.least:.3g}" + (", at the boundary of those tried" if beta.at_boundary else ""),
        f"probability of no constraint {none:.2g}",
    ]


def _found(answer: Answer) -> list[tuple[str, dict[str, Any]]]:
    """Return the picks and the best square apart from the first pick, each with a name."""
    found = [(str(k + 1), pick) for k, pick in enumerate(picks_json(answer))]
    apart = elsewhere_json(answer)
    return found if apart is None else [*found, ("elsewhere", apart)]


def map_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of all squares with floor in them."""
    inference = result.answer.inference
    places = squares(inference.evidence.problem.hypotheses)
    rank = {pick.hypothesis: k + 1 for k, pick in enumerate(result.answer.picks)}
    rows = [["index", "x_m", "y_m", "log_likelihood_nats", "num_entering", "posterior", "pick"]]
    entering = inference.counts.entering.sum(axis=0)
    for index in np.flatnonzero(inference.prior[1:] > 0.0).tolist():
        gain = inference.log_likelihood[index]
        rows.append(
            [
                str(index),
                *(f"{value:.4g}" for value in centre(places[index])),
                "" if np.isneginf(gain) else f"{gain:.4f}",
                f"{entering[index]:.0f}",
                f"{inference.posterior.hypotheses[index]:.4g}",
                str(rank.get(index, "")),
            ]
        )
    return rows


def draw_map(result: Result) -> Figure:
    """Draw walls, tracks, log-likelihood ratios of squares, and the picks."""
    room, inference = result.room, result.answer.inference
    figure = column(4.2)
    axes = figure.subplots()
    blocked, (x, y), cell = room.picture.blocked, room.picture.corner, room.picture.cell
    extent = (x, x + cell * blocked.shape[1], y, y + cell * blocked.shape[0])
    walls = np.ma.masked_where(~blocked, blocked)
    axes.imshow(
        walls, cmap=ListedColormap([WALL]), extent=extent, origin="lower", interpolation="nearest"
    )
    hypotheses: Any = inference.evidence.problem.hypotheses
    middles = squares(hypotheses).reshape(*hypotheses.shape, 4)
    x_middle, y_middle = middles[:, 0, :2].mean(axis=1), middles[0, :, 2:].mean(axis=1)
    value = np.where(inference.struck_out | (inference.prior[1:] == 0.0), 0, inference.score)
    shown = np.ma.masked_less(value.reshape(hypotheses.shape).T, 0.5)
    image = axes.pcolormesh(x_middle, y_middle, shown, cmap=COLOURS, vmin=0.0, zorder=2)
    for number, track in enumerate(result.tracks.used):
        name = "_" if number else "a track"
        axes.plot(*track.states.T, color=INK, lw=0.3, alpha=0.45, zorder=3, label=name)
    _outline_picks(axes, result.answer)
    (x_low, x_high), (y_low, y_high) = room.floor
    axes.set(xlim=(x_low - 0.3, x_high + 0.3), ylim=(y_low - 0.3, y_high + 0.3), aspect="equal")
    axes.set_xlabel("x [m]", fontsize=SIZE)
    axes.set_ylabel("y [m]", fontsize=SIZE)
    axes.tick_params(labelsize=SMALL)
    scale = figure.colorbar(image, ax=axes, location="bottom", aspect=30, pad=0.02)
    scale.set_label("log-likelihood ratio of the square around each point [nats]", fontsize=SMALL)
    scale.ax.tick_params(labelsize=SMALL)
    _legend(figure, axes, "Grey: walls, and what is no floor", ncols=3)
    return figure


def _outline_picks(axes: Axes, answer: Answer) -> None:
    """Outline the picks and number them."""
    halo = [Stroke(linewidth=2.6, foreground="white"), Normal()]
    for k, pick in enumerate(picks_json(answer)):
        x, y = pick["centre"]
        corner = (x - WIDTH / 2, y - WIDTH / 2)
        style: dict[str, Any] = {"fill": False, "edgecolor": INK, "path_effects": halo}
        style["ls"] = "-" if k == 0 else "--"
        style["label"] = ("first pick", "picks after it", "_")[min(k, 2)]
        axes.add_patch(Rectangle(corner, WIDTH, WIDTH, lw=1.4, zorder=4, **style))
        place = {"xytext": (x + 0.55, y + 0.55), "fontsize": SIZE, "fontweight": "bold"}
        axes.annotate(str(k + 1), (x, y), color=INK, path_effects=halo, zorder=5, **place)


def belief_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of the posterior by subsets of the tracks."""
    low, high = INTERVAL
    names = ("median", f"percentile_{low:g}", f"percentile_{high:g}")
    rows = [["num_tracks", "num_subsets", *(f"{part}_{name}" for part in
             ("near_first_pick", "none", "gain_nats") for name in names)]]  # fmt: skip
    for size, *values in zip(*result.belief, strict=True):
        numbers = [np.percentile(value, (50.0, low, high)) for value in values]
        cells = [f"{number:.5g}" for number in np.concatenate(numbers)]
        rows.append([str(size), str(len(values[0])), *cells])
    return rows


def draw_belief(result: Result) -> Figure:
    """Draw the posterior against the number of tracks."""
    belief, figure = result.belief, column(2.5)
    axes = figure.subplots()
    for values, colour, style, label in (
        (belief.near, DARK, "-", "a constraint that overlaps the first pick"),
        (belief.none, LIGHT, "--", "no constraint"),
    ):
        low, middle, high = np.percentile(values, (INTERVAL[0], 50.0, INTERVAL[1]), axis=1)
        axes.fill_between(belief.sizes, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(belief.sizes, middle, color=colour, ls=style, marker="o", ms=3, label=label)
    axes.set_xlabel("number of tracks", fontsize=SIZE)
    axes.set_ylabel("probability", fontsize=SIZE)
    axes.set(ylim=(-0.02, 1.02))
    _tidy(axes)
    title = f"Random subsets: median and {INTERVAL[1] - INTERVAL[0]:.0f} % of them"
    _legend(figure, axes, title)
    return figure


def beta_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of the betas that were tried."""
    beta = result.beta
    rows = [["beta_per_m", "log_probability_per_square_nats", "is_chosen"]]
    means = beta.score.mean(axis=1)
    return rows + [
        [f"{value:.6g}", f"{mean:.6g}", str(int(value == beta.value))]
        for value, mean in zip(beta.tried, means, strict=True)
    ]


def draw_beta(result: Result) -> Figure:
    """Draw the score of each beta that was tried."""
    beta, figure = result.beta, column(2.2)
    axes = figure.subplots()
    axes.axvspan(*beta.interval, color=LIGHT, alpha=0.25, lw=0, label="95 % interval")
    axes.plot(beta.tried, beta.score.mean(axis=1), color=DARK, marker="o", ms=3)
    axes.axvline(beta.value, color=INK, lw=1.0, ls="--", label=f"chosen, {beta.value:.3g}")
    axes.axvline(beta.least, color=FAINT, lw=1.0, ls=":", label=f"least, {beta.least:.3g}")
    axes.set_xlabel("beta [nats/m]", fontsize=SIZE)
    axes.set_ylabel("score [nats a square]", fontsize=SIZE)
    _tidy(axes)
    _legend(figure, axes, "What each track enters, by cross-validation", ncols=3)
    return figure


def sensitivity_rows(result: Result) -> list[list[str]]:
    """Return the rows of a table of the answers at about half and twice the chosen beta."""
    rows = [["beta_per_m", "pick", "x_m", "y_m", "gain_nats", "standard_error_nats", "log_odds"]]
    for answer in result.sensitivity:
        for name, pick in _found(answer):
            optional = [
                f"{pick[key]:.4f}" if key in pick else "" for key in ("standard_error", "log_odds")
            ]
            place = [f"{value:.4g}" for value in pick["centre"]]
            rows.append([f"{answer.beta:.4g}", name, *place, f"{pick['gain_nats']:.4f}", *optional])
    return rows


def draw_sensitivity(result: Result) -> Figure:
    """Draw the gains of the picks at about half of the chosen beta, at it and at twice as much."""
    figure, answers = column(2.4), result.sensitivity
    axes = figure.subplots()
    styles = [(DARK, ""), (LIGHT, "////"), (FAINT, "...."), ("white", "")]
    groups = [_found(answer) for answer in answers]
    names = list(dict.fromkeys(name for group in groups for name, _ in group))
    for k, name in enumerate(names):
        colour, hatch = styles[k % len(styles)]
        places = [place + 0.2 * (k - 1.5) for place, group in enumerate(groups) if name in
                  dict(group)]  # fmt: skip
        found = [dict(group)[name] for group in groups if name in dict(group)]
        label = "best apart from pick 1" if name == "elsewhere" else f"pick {name}"
        style: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": INK, "lw": 0.6}
        axes.bar(places, [pick["gain_nats"] for pick in found], 0.18, label=label, **style)
        for place, pick in zip(places, found, strict=True):
            x, y = pick["centre"]
            text = f" ({x:.1f}, {y:.1f})"
            axes.text(place, pick["gain_nats"], text, rotation=90, ha="center", fontsize=5.5)
    axes.set_xticks(range(len(answers)), [f"{answer.beta:.3g}" for answer in answers])
    axes.set_xlabel("beta [nats/m]", fontsize=SIZE)
    axes.set_ylabel("gain [nats]", fontsize=SIZE)
    _tidy(axes)
    axes.margins(y=0.3)
    _legend(figure, axes, "Picks in order, and where their centres are [m]", ncols=2)
    return figure


def _tidy(axes: Axes) -> None:
    """Give axes a grid behind the data and open sides."""
    axes.grid(color="#e2e2e2", lw=0.6)
    axes.set_axisbelow(True)
    open_sides(axes, SMALL)


def _legend(figure: Figure, axes: Axes, title: str, ncols: int = 1) -> None:
    """Put the legend of axes above a figure, under a title."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside upper left", ncols=ncols, frameon=False,
        fontsize=SMALL, handlelength=2.4, title=title, title_fontsize=SMALL, alignment="left",
    )  # fmt: skip
