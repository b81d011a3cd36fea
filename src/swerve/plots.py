"""Pictures of an inference: drawn from what it holds, nothing is computed anew.

    colour = score of a hypothesis,    hatch = a demonstration enters it,    outline = first rank

over two states, or one state and time (see `plane`). matplotlib is used through its objects alone,
so neither a window nor the global state of pyplot is touched.

Shapes: H hypotheses, R rectangles, n states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Normal, Stroke

from swerve import plane as planes
from swerve import wording
from swerve.boxes import Box
from swerve.figures import ALARM, FAINT, INK, WIDTH, headed, written
from swerve.hypotheses import GridHypotheses, HypothesisSet
from swerve.inference import Inference
from swerve.plane import Plane
from swerve.problem import ProblemRecord
from swerve.sliding import WindowHypotheses

NUM_LINES = 100  # nominal trajectories drawn, of all tasks together
NUM_BARS = 12
NUM_OUTLINED = 100  # hypotheses of the first rank that are outlined
MAX_RULED = 40  # cells a side up to which the lines of a grid are drawn
MAX_WARNING = 300  # characters of a warning; the report has all of them
NARROW = 6.0  # in; below it the colour bar goes under the picture
DASHES = {"dash_offset": 0, "dash_list": [3, 3]}

STRUCK_OUT, HATCH, KNOWN = "#f3f3f3", "#b4b4b4", "#3c3c3c"
DEMONSTRATION, NOMINAL = "#0072b2", "#555555"
LEADER_BAR, OTHER_BAR = "#5b1a78", "#bcaec4"


def _colour_map() -> LinearSegmentedColormap:
    """Return magma from light to dark, with the yellow of its light end bleached: 0 is quiet."""
    share = np.linspace(0.0, 1.0, 256)[:, None]
    bleach = 0.9 * np.clip(1.0 - share / 0.3, 0.0, 1.0)
    magma = mpl.colormaps["magma_r"](0.85 * share[:, 0])[:, :3]
    colours = bleach * 0.98 + (1.0 - bleach) * magma
    return LinearSegmentedColormap.from_list("swerve", list(map(tuple, colours)))


COLOURS = _colour_map()


class Shading(NamedTuple):
    """What a picture shows of hypotheses.

    Attributes:
      values: [H] what they are shaded by; -inf where struck out.
      norm: of the colours.
      label: of the colour bar.
      outlined: hypotheses with an outline, the first one heavily.
      labels: of the first one, and of the others.
      text: says the value of a hypothesis.
      is_set: whether those outlined are one answer together.
    """

    values: np.ndarray
    norm: Normalize
    label: str
    outlined: np.ndarray
    labels: tuple[str, str]
    text: Callable[[int], str]
    is_set: bool


def plot_inference(
    inference: Inference,
    path: str | Path | None = None,
    *,
    width: float = WIDTH,
    has_header: bool = True,
) -> Figure:
    """Draw hypotheses shaded by score, nominal trajectories and demonstrations.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in]; text keeps its size, and below 6 in the layout is for a phone.
      has_header: whether to write the answer, the warnings and the settings above it.

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    header = _header(inference, wording.title(inference)) if has_header else []
    return written(picture(inference, _by_score(inference), header, width), path)


def plot_posterior(
    inference: Inference, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw hypotheses shaded by posterior probability, the 95 % credible set outlined.

    The header tells the probability that there is no constraint.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    header = _header(inference, inference.belief)
    return written(picture(inference, _by_posterior(inference), header, width), path)


def picture(
    inference: Inference,
    shading: Shading,
    header: list[tuple[str, float, str]],
    width: float,
    also: Sequence[planes.Path] = (),
) -> Figure:
    """Return a picture of the plane: hypotheses shaded, what is known, and trajectories.

    Args:
      inference: what to draw.
      shading: by what.
      header: lines above it, as text, size [pt] and colour.
      width: of the picture [in].
      also: paths that there is to be room for, though they are not drawn.
    """
    is_wide = width >= NARROW
    demonstrations = [planes.Path(d.states, d.times) for d in inference.demonstrations]
    nominal = planes.nominal_paths(inference, NUM_LINES)
    plane = planes.plane_of(inference.evidence.problem, [*demonstrations, *nominal, *also])
    figure = headed(header, width, *_size(plane, width))
    axes = figure.add_subplot()
    notes = _draw_values(axes, inference, shading, plane)
    notes += _draw_outlined(axes, inference, shading, plane)
    _draw_known(axes, inference, plane)
    _draw_nominal(axes, nominal, plane)
    _draw_demonstrations(axes, demonstrations, plane)
    _annotate(axes, inference, shading, demonstrations, plane)
    _finish(axes, plane, wording.wrapped(" ".join(notes), width - 1.5, 7.5))
    if len(inference.ranking):
        _colour_bar(axes, shading, "right" if is_wide else "bottom")
    _legend(figure, axes, is_wide)
    return figure


def plot_ranking(
    inference: Inference, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw the first hypotheses of the ranking as bars with their standard errors.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    shown, total = inference.ranking[:NUM_BARS], len(inference.ranking)
    title = f"First {len(shown)} of {wording.counted(total, wording.noun(inference))} left"
    header = [(title if total else wording.title(inference), 11.5, INK)]
    figure = headed(header, width, 0.42 * len(shown) + 0.8, width)
    axes = figure.add_subplot()
    if not total:
        axes.set_axis_off()
        return written(figure, path)
    score, error = inference.score[shown], inference.score_error[shown]
    is_first = inference.rank[: len(shown)] == 1
    colours = [LEADER_BAR if first else OTHER_BAR for first in is_first]
    whiskers = {"ecolor": INK, "elinewidth": 1.2, "capsize": 3}
    axes.barh(np.arange(len(shown)), score, 0.4, color=colours, xerr=error, error_kw=whiskers)
    reach = float((score + error).max()) or 1.0
    style: dict[str, Any] = {"fontsize": 8, "color": INK, "parse_math": False}
    for row, index in enumerate(shown.tolist()):
        tied = " (tied)" if is_first[row] and len(inference.leaders) > 1 else ""
        text = wording.cut(wording.hypothesis(inference, index), int(width * 14) - len(tied))
        text = f"{wording.rank(inference, row)}   {text}{tied}"
        axes.text(0.005 * reach, row - 0.25, text, va="bottom", **style)
        end = score[row] + error[row] + 0.015 * reach
        axes.text(end, row, wording.number(inference, index), va="center", **style)
    axes.set(xlim=(0, reach / (1 - 0.95 / width)), ylim=(len(shown) - 0.6, -0.75), yticks=[])
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    label = f"{wording.score_label(inference)}; whiskers: standard error"
    axes.set_xlabel(wording.wrapped(label, width - 0.5, 8.5), fontsize=8.5)
    return written(figure, path)


def _header(inference: Inference, title: str) -> list[tuple[str, float, str]]:
    warnings = [f"Warning: {wording.cut(text, MAX_WARNING)}." for text in inference.warnings]
    return [
        (title, 11.5, INK),
        *((text, 8.0, ALARM) for text in warnings),
        (wording.settings(inference), 7.5, FAINT),
    ]


def _size(plane: Plane, width: float) -> tuple[float, float]:
    """Return height and width [in] of axes with labels, legend and colour bar."""
    is_wide = width >= NARROW
    beside, below = (1.6, 1.0) if is_wide else (0.6, 1.9)
    shape = 0.6 if is_wide else 0.9
    if not plane.is_map:
        return (width - beside) * shape + below, width
    x, y = plane.limits[:, 1] - plane.limits[:, 0]
    height = (width - beside) * min(y / x, shape + 0.3)
    return height + below, height * x / y + beside


def _draw_values(axes: Axes, inference: Inference, shading: Shading, plane: Plane) -> list[str]:
    """Shade the hypotheses that are left, hatch those struck out; return notes for the reader."""
    hypotheses, values = inference.evidence.problem.hypotheses, shading.values
    cells = _cells(hypotheses, values)
    if cells is not None:
        struck_out, notes = _draw_grid(axes, *cells, shading, plane)
        if isinstance(hypotheses, WindowHypotheses):
            notes.append("Each point shows the best of the windows that cover it.")
    else:
        struck_out, notes = _draw_list(axes, hypotheses, shading, plane)
    if len(struck_out):
        label = f"struck out by a demonstration ({inference.struck_out.sum()})"
        patch = _patch(struck_out, facecolor=STRUCK_OUT, edgecolor=HATCH, hatch="////", label=label)
        patch.set(linewidth=0, hatch_linewidth=0.6, zorder=0.9)  # below what is left
        axes.add_patch(patch)
    return notes


def _cells(
    hypotheses: HypothesisSet, values: np.ndarray
) -> tuple[GridHypotheses, np.ndarray] | None:
    """Return the cells of a grid or of windows and the best value of each; None for a list."""
    if isinstance(hypotheses, WindowHypotheses):
        return hypotheses.best_of_cells(values)
    return (hypotheses, values) if isinstance(hypotheses, GridHypotheses) else None


def _image(
    grid: GridHypotheses, values: np.ndarray, plane: Plane
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the best of the values [F] at each place of the plane, and the lines between."""
    score = values.reshape(grid.shape)
    image = score.max(axis=tuple(range(2, score.ndim))).T if score.ndim > 1 else score[:, None]
    edges = [np.linspace(low, high, count + 1) for low, high, count in grid.axes.values()][:2]
    x, y = edges if len(edges) > 1 else (plane.limits[0], *edges)
    return image, x, y


def _draw_grid(
    axes: Axes, grid: GridHypotheses, values: np.ndarray, shading: Shading, plane: Plane
) -> tuple[list[np.ndarray], list[str]]:
    """Shade the cells of a grid by values [F]; return the outlines struck out and notes."""
    image, x, y = _image(grid, values, plane)
    is_out = np.isneginf(image)
    few = max(image.shape) <= MAX_RULED
    ruled: dict[str, Any] = {"edgecolors": "white", "linewidth": 0.5} if few else {}
    cells = np.ma.masked_array(image, is_out)
    axes.pcolormesh(x, y, cells, cmap=COLOURS, norm=shading.norm, rasterized=not few, **ruled)
    others = ", ".join(grid.state_names[2:])
    note = f"Each cell shows the best of its cells along {others}; hatched where none is left."
    return list(planes.corners(planes.runs(is_out, x, y))), [note] if others else []


def _draw_list(
    axes: Axes, hypotheses: HypothesisSet, shading: Shading, plane: Plane
) -> tuple[list[np.ndarray], list[str]]:
    """Shade constraints, the best on top; return the outlines struck out and notes."""
    struck_out, left, shades, skipped = [], [], [], 0
    for index in np.argsort(shading.values, kind="stable").tolist():
        outlines = plane.outlines(hypotheses.constraint(index))
        skipped += not outlines
        if np.isneginf(shading.values[index]):
            struck_out += outlines
        else:
            left += outlines
            shades += [shading.values[index]] * len(outlines)
    drawn = PolyCollection(left, cmap=COLOURS, norm=shading.norm)
    drawn.set(array=np.array(shades), edgecolor="face", linewidth=0.3)
    axes.add_collection(drawn, autolim=False)
    note = f"Not drawn: {skipped} hypotheses outside this picture or not of its states."
    return struck_out, [note] if skipped else []


def _draw_outlined(axes: Axes, inference: Inference, shading: Shading, plane: Plane) -> list[str]:
    """Outline some hypotheses, the best one heavily and on top.

    Many that overlap, or that are a set rather than each its own answer, have one outline together.
    """
    hypotheses = inference.evidence.problem.hypotheses
    together = np.full(len(hypotheses), -np.inf)
    together[shading.outlined] = 0.0
    cells = _cells(hypotheses, together)
    is_region = cells is not None and len(shading.outlined) > 1
    is_region &= shading.is_set or isinstance(hypotheses, WindowHypotheses)
    if is_region and cells is not None:
        _draw_region(axes, *_image(*cells, plane), shading.labels[1])
    shown = shading.outlined[: 1 if is_region else NUM_OUTLINED].tolist()
    for index in shown:
        is_best = index == shown[0]
        outlines = plane.outlines(hypotheses.constraint(index))
        if not outlines:
            continue
        colour = COLOURS(shading.norm(shading.values[index]))
        patch = _patch(outlines, facecolor=colour, clip_on=False, zorder=1.6 + 0.1 * is_best)
        weight = 5.0 if is_best else 2.4
        edge = [Stroke(linewidth=weight + 2, foreground="white"), Stroke(linewidth=weight)]
        top = Normal() if is_best else Stroke(linewidth=1.0, foreground="white", dashes=DASHES)
        patch.set(path_effects=[*edge, top])
        patch.set(edgecolor=INK, linewidth=0, label=shading.labels[not is_best])
        axes.add_patch(patch)
    more = 0 if is_region else len(shading.outlined) - len(shown)
    return [f"{more} more are {shading.labels[1]} and not outlined."] if more else []


def _draw_region(axes: Axes, image: np.ndarray, x: np.ndarray, y: np.ndarray, label: str) -> None:
    """Outline the cells of an image that are not -inf, along their common edge."""
    inside = np.pad(np.isfinite(image), 1)
    row, column = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    upright = [[(x[c], y[r]), (x[c], y[r + 1])] for r, c in zip(row, column, strict=True)]
    row, column = np.nonzero(inside[1:, 1:-1] != inside[:-1, 1:-1])
    level = [[(x[c], y[r]), (x[c + 1], y[r])] for r, c in zip(row, column, strict=True)]
    lines = LineCollection([*upright, *level], color=INK, linewidth=1.8, label=label)
    lines.set(path_effects=[Stroke(linewidth=3.6, foreground="white"), Normal()])
    lines.set(capstyle="projecting", clip_on=False, zorder=1.5)
    axes.add_collection(lines, autolim=False)


def _draw_known(axes: Axes, inference: Inference, plane: Plane) -> None:
    """Darken the known constraints, and the states of a lattice where nobody can be."""
    problem = inference.evidence.problem
    for label, constraints in (
        ("known constraint", problem.known),
        ("wall", _walls(problem)),
    ):
        outlines = [part for constraint in constraints for part in plane.outlines(constraint)]
        if outlines:
            patch = _patch(outlines, facecolor=KNOWN, linewidth=0, label=label)
            axes.add_patch(patch)


def _walls(problem: ProblemRecord) -> list[Box]:
    """Return the states of a lattice that no action leads to or from, as squares of side 1."""
    if problem.transitions is None:
        return []
    names = problem.space.names
    return [
        Box(**{name: (x - 0.5, x + 0.5) for name, x in zip(names, state, strict=True)})
        for state in problem.transitions.isolated.tolist()
    ]


def _draw_nominal(axes: Axes, paths: list[planes.Path], plane: Plane) -> None:
    if paths:
        lines = LineCollection([plane.pieces(path) for path in paths], rasterized=True)
        lines.set(color=NOMINAL, linewidth=0.4, alpha=0.3, label="nominal trajectories")
        axes.add_collection(lines, autolim=False)


def _draw_demonstrations(axes: Axes, paths: list[planes.Path], plane: Plane) -> None:
    if not paths:
        return
    weight = 1.7 if len(paths) <= 10 else 1.0 if len(paths) <= 100 else 0.5
    halo = [Stroke(linewidth=weight + 1.6, foreground="white"), Normal()]
    for k, path in enumerate(paths):
        label = None if k else f"demonstrations ({len(paths)})"
        x, y = plane.pieces(path).T
        axes.plot(x, y, color=DEMONSTRATION, lw=weight, path_effects=halo, label=label)
    ends = plane.wrapped(np.array([plane.line(path)[[0, -1]] for path in paths]))
    style = {"color": DEMONSTRATION, "ls": "none", "ms": 3.5 + weight, "zorder": 3}
    for end, marker, fill in ((0, "o", "white"), (1, "s", DEMONSTRATION)):
        x, y = ends[:, end].T
        axes.plot(x, y, marker, mfc=fill, label=("start", "end")[end], clip_on=False, **style)


def _annotate(
    axes: Axes,
    inference: Inference,
    shading: Shading,
    demonstrations: list[planes.Path],
    plane: Plane,
) -> None:
    """Write index and value beside the best hypothesis, where the fewest demonstrations pass."""
    if not len(shading.outlined):
        return
    leaders = shading.outlined[:NUM_OUTLINED].tolist()
    best, constraint = leaders[0], inference.evidence.problem.hypotheses.constraint
    rectangles = plane.rectangles(constraint(best))
    if not len(rectangles):
        return
    text = f"{wording.noun(inference)} {best}\n{shading.text(best)}"
    text = text.replace("violation ", "violation\n")
    size = cast(Figure, axes.figure).get_size_inches() * (0.8, 0.6)  # of the axes, about
    label = np.array([0.05 * max(map(len, text.split("\n"))), 0.11 * (1 + text.count("\n"))]) / size
    ties = [plane.rectangles(constraint(k)).reshape(-1, 2, 2).mean(axis=2) for k in leaders]
    busy = [*20 * ties, *(plane.pieces(path) for path in demonstrations)]
    place, end = plane.place(rectangles, np.concatenate(busy), label)
    axes.annotate(
        text, end, place, xycoords="axes fraction", textcoords="axes fraction",
        ha="center", va="center", in_layout=False, zorder=4, parse_math=False,
        fontsize=9, fontweight="bold", color=INK,
        bbox={"boxstyle": "round,pad=0.3", "fc": "white", "ec": INK, "lw": 0.8},
        arrowprops={"arrowstyle": "-", "color": INK, "lw": 1.2},
    )  # fmt: skip


def _finish(axes: Axes, plane: Plane, notes: str) -> None:
    axes.set(xlim=plane.limits[0], ylim=plane.limits[1])
    x, y = plane.labels
    axes.set_xlabel(x, fontsize=9, parse_math=False)
    axes.set_ylabel(y, fontsize=9, parse_math=False)
    axes.set_title(notes, fontsize=7.5, color=FAINT, loc="left", parse_math=False)
    axes.tick_params(labelsize=8)
    if plane.is_map:
        axes.set_aspect("equal")


def _colour_bar(axes: Axes, shading: Shading, location: str) -> None:
    colours = ScalarMappable(shading.norm, COLOURS)
    bar = cast(Figure, axes.figure).colorbar(
        colours, ax=axes, location=location, aspect=35, pad=0.02
    )
    bar.set_label(shading.label, fontsize=8.5)
    bar.ax.tick_params(labelsize=8)


def _legend(figure: Figure, axes: Axes, is_wide: bool) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    style: dict[str, Any] = {"fontsize": 8 if is_wide else 7.5, "columnspacing": 1.2}
    style |= {"frameon": False, "ncols": 3 if is_wide else 2, "handlelength": 1.8}
    figure.legend(unique.values(), unique.keys(), loc="outside lower left", **style)


def _by_score(inference: Inference) -> Shading:
    """Return what `plot_inference` draws: scores, and the first rank outlined."""
    most = float(inference.score[inference.ranking].max(initial=0.0)) or 1.0
    return Shading(
        inference.score,
        Normalize(0.0, most),
        wording.score_label(inference),
        inference.leaders,
        ("ranked first", "tied with it"),
        partial(wording.score, inference),
        is_set=False,
    )


def _by_posterior(inference: Inference) -> Shading:
    """Return what `plot_posterior` draws: probabilities, and the credible set outlined."""
    found = inference.posterior
    values = np.where(inference.struck_out, -np.inf, found.hypotheses)

    def text(index: int) -> str:
        return wording.probability(found.hypotheses[index], found.error[index])

    return Shading(
        values,
        Normalize(0.0, float(values.max(initial=0.0)) or 1.0),
        "posterior probability",
        inference.credible_set().hypotheses,
        ("most probable", "in the 95 % credible set"),
        text,
        is_set=True,
    )


def _patch(outlines: Sequence[np.ndarray], **style: Any) -> PathPatch:
    """Return polygons, each [V, 2], as one patch."""
    closed = [Outline(np.append(outline, outline[:1], axis=0), closed=True) for outline in outlines]
    return PathPatch(Outline.make_compound_path(*closed), **style)
