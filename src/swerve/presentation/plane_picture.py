"""Draw a plane: shaded hypotheses, known constraints, nominal trajectories and demonstrations.

The plane is of two states, or of one state and time (see `plane`). Each hypothesis is shaded by one
number (see `shading`).

Shapes: R rectangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke

from swerve.base import phrases
from swerve.base.figure_style import FAINT, INK, headed, plain
from swerve.constraints import polygon_geometry
from swerve.constraints.boxes import Box
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.inference.ranking import Ranking
from swerve.presentation import plane as planes
from swerve.presentation import sentences
from swerve.presentation.plane import Plane
from swerve.presentation.shading import (
    COLOURS,
    NUM_OUTLINED,
    Shading,
    draw_colour_bar,
    draw_outlined,
    draw_values,
    patch_of,
)
from swerve.problem.record import ProblemRecord

NUM_LINES = 100  # nominal trajectories drawn, all tasks together
MAX_DRAWN = 200  # demonstrations drawn: with more, lines hide one another and drawing takes long
LABEL_RASTER = 40  # points a side of the raster on which a label is kept off hypotheses
NARROW = 6.0  # in: in a picture less wide than this, the colour bar goes below the axes
TIE_WEIGHT = 20  # hiding a tied hypothesis is as bad for a label as hiding so many points

Item = TypeVar("Item")
KNOWN, DEMONSTRATION, NOMINAL = "#3c3c3c", "#0072b2", "#555555"


def picture(
    inference: Ranking,
    shading: Shading,
    header: list[tuple[str, float, str]],
    width: float,
    also: Sequence[planes.Path] = (),
) -> Figure:
    """Return a picture of the plane: shaded hypotheses, known constraints and trajectories.

    Args:
      inference: the ranking to draw.
      shading: the numbers that the hypotheses are shaded by, and their colours.
      header: lines above the picture, as text, size [pt] and colour.
      width: width of the picture [in].
      also: paths that are not drawn, but must fit into the range of the axes.
    """
    is_wide = width >= NARROW
    drawn = evenly(inference.demonstrations, MAX_DRAWN)
    demonstrations = [planes.Path(d.states, d.times) for d in drawn]
    nominal = planes.nominal_paths(inference, NUM_LINES)
    problem = inference.evidence.problem
    plane = planes.plane_of(problem, [*demonstrations, *nominal, *also])
    header = [*header[:1], *_undrawn(inference, shading, plane), *header[1:]]
    figure = headed(header, width, *_size(plane, width))
    axes = figure.add_subplot()
    notes = draw_values(axes, problem.hypotheses, shading, plane)
    notes += draw_outlined(axes, problem.hypotheses, shading, plane)
    _draw_known(axes, problem, plane)
    _draw_nominal(axes, nominal, plane)
    _draw_demonstrations(axes, demonstrations, len(inference.demonstrations), plane)
    _annotate(axes, inference, shading, demonstrations, plane)
    _finish(axes, plane, phrases.wrapped(" ".join(notes), width - 1.5, 7.5))
    if len(inference.ranking):
        draw_colour_bar(axes, shading, "right" if is_wide else "bottom")
    _legend(figure, axes, shading, is_wide)
    return figure


def _undrawn(inference: Ranking, shading: Shading, plane: Plane) -> list[tuple[str, float, str]]:
    """Return a line that names the best hypothesis where it has no place on the plane."""
    for best in shading.outlined[:1].tolist():
        if not plane.outlines(inference.evidence.problem.hypotheses.constraint(best)):
            what = f"{sentences.short_hypothesis(inference, best)}, {shading.text(best)}"
            label = shading.labels[0].capitalize()
            return [(f"{label}, but it has no place on these axes: {what}", 9.0, INK)]
    return []


def _size(plane: Plane, width: float) -> tuple[float, float]:
    """Return height and width [in] of the axes together with labels, legend and colour bar."""
    is_wide = width >= NARROW
    beside, below = (1.6, 1.0) if is_wide else (0.6, 1.9)
    shape = 0.6 if is_wide else 0.9
    if not plane.is_map:
        return (width - beside) * shape + below, width
    x, y = plane.limits[:, 1] - plane.limits[:, 0]
    height = (width - beside) * min(y / x, shape + 0.3)
    return height + below, height * x / y + beside


def _draw_known(axes: Axes, problem: ProblemRecord, plane: Plane) -> None:
    """Darken the known constraints, and the walls of a lattice.

    Where only some actions are forbidden in states, these states are crossed instead.
    """
    known = [part for constraint in problem.known for part in constraint.parts]
    on_actions = [part for part in known if isinstance(part, StateAction)]
    filled = {"facecolor": KNOWN, "linewidth": 0}
    crossed = {"facecolor": "none", "edgecolor": KNOWN, "hatch": "xx"}
    for label, constraints, style in (
        ("known constraint", [part for part in known if part not in on_actions], filled),
        ("known constraint on actions", on_actions, crossed),
        ("wall", _walls(problem), filled),
    ):
        outlines = [part for constraint in constraints for part in plane.outlines(constraint)]
        if outlines:
            axes.add_patch(patch_of(outlines, label=label, **style))


def _walls(problem: ProblemRecord) -> list[Box]:
    """Return the walls of a lattice, states that no action enters or leaves, as squares."""
    if problem.transitions is None:
        return []
    names = problem.space.names
    return [
        Box(**{name: (x - 0.5, x + 0.5) for name, x in zip(names, state, strict=True)})
        for state in problem.transitions.isolated.tolist()
    ]


def _draw_nominal(axes: Axes, paths: list[planes.Path], plane: Plane) -> None:
    """Draw nominal trajectories as thin lines."""
    if paths:
        lines = LineCollection([plane.pieces(path) for path in paths], rasterized=True)
        lines.set(color=NOMINAL, linewidth=0.4, alpha=0.3, label="nominal trajectories")
        axes.add_collection(lines, autolim=False)


def evenly(items: Sequence[Item], most: int) -> Sequence[Item]:
    """Return at most `most` items, spread evenly from the first to the last."""
    if len(items) <= most:
        return items
    return [items[k] for k in np.linspace(0, len(items) - 1, most).round().astype(int).tolist()]


def _draw_demonstrations(axes: Axes, paths: list[planes.Path], num_all: int, plane: Plane) -> None:
    """Draw demonstrations as lines, thinner the more there are, and mark their starts and ends."""
    if not paths:
        return
    weight = 1.7 if len(paths) <= 10 else 1.0 if len(paths) <= 100 else 0.5
    halo = [Stroke(linewidth=weight + 1.6, foreground="white"), Normal()]
    count = f"{num_all}" if num_all == len(paths) else f"{len(paths)} of {num_all:,} are drawn"
    for k, path in enumerate(paths):
        label = None if k else f"demonstrations ({count})"
        x, y = plane.pieces(path).T
        axes.plot(x, y, color=DEMONSTRATION, lw=weight, path_effects=halo, label=label)
    ends = plane.wrapped(np.array([plane.line(path)[[0, -1]] for path in paths]))
    style = {"color": DEMONSTRATION, "ls": "none", "ms": 3.5 + weight, "zorder": 3}
    for end, marker, fill in ((0, "o", "white"), (1, "s", DEMONSTRATION)):
        x, y = ends[:, end].T
        axes.plot(x, y, marker, mfc=fill, label=("start", "end")[end], clip_on=False, **style)


def _annotate(
    axes: Axes,
    inference: Ranking,
    shading: Shading,
    demonstrations: list[planes.Path],
    plane: Plane,
) -> None:
    """Write index and value beside the best hypothesis, where the text hides least."""
    if not len(shading.outlined):
        return
    leaders = shading.outlined[:NUM_OUTLINED].tolist()
    best, constraint = leaders[0], inference.evidence.problem.hypotheses.constraint
    rectangles = plane.rectangles(constraint(best))
    if not len(rectangles):
        return
    text = f"{sentences.noun(inference)} {best}\n{shading.text(best)}"
    text = text.replace("violation ", "violation\n")
    size = cast(Figure, axes.figure).get_size_inches() * (0.8, 0.6)  # roughly the size of the axes
    label = np.array([0.05 * max(map(len, text.split("\n"))), 0.11 * (1 + text.count("\n"))]) / size
    ties = [plane.rectangles(constraint(k)).reshape(-1, 2, 2).mean(axis=2) for k in leaders]
    busy = [*TIE_WEIGHT * ties, *(plane.pieces(path) for path in demonstrations)]
    busy.append(_inside_of_list(inference.evidence.problem.hypotheses, plane))
    place, end = plane.place(rectangles, np.concatenate(busy), label)
    axes.annotate(
        text, end, place, xycoords="axes fraction", textcoords="axes fraction",
        ha="center", va="center", in_layout=False, zorder=4, parse_math=False,
        fontsize=9, fontweight="bold", color=INK,
        bbox={"boxstyle": "round,pad=0.3", "fc": "white", "ec": INK, "lw": 0.8},
        arrowprops={"arrowstyle": "-", "color": INK, "lw": 1.2},
    )  # fmt: skip


def _inside_of_list(hypotheses: HypothesisSet, plane: Plane) -> np.ndarray:
    """Return points [P, 2] of a raster inside the constraints of a list; none for cells.

    The cells of a grid are everywhere, so a label cannot be kept off them.
    """
    if not isinstance(hypotheses, ConstraintHypotheses):
        return np.zeros((0, 2))
    axes = [np.linspace(low, high, LABEL_RASTER) for low, high in plane.limits]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    outlines = [part for c in hypotheses.constraints[:NUM_OUTLINED] for part in plane.outlines(c)]
    inside = [polygon_geometry.encloses(outline, *points.T) for outline in outlines]
    return points[np.any(inside, axis=0)] if inside else points[:0]


def _finish(axes: Axes, plane: Plane, notes: str) -> None:
    """Set range and labels of the axes, and write notes above them."""
    axes.set(xlim=plane.limits[0], ylim=plane.limits[1])
    x, y = map(phrases.shown, plane.labels)
    axes.set_xlabel(x, fontsize=9, parse_math=False)
    axes.set_ylabel(y, fontsize=9, parse_math=False)
    axes.set_title(notes, fontsize=7.5, color=FAINT, loc="left", parse_math=False)
    axes.tick_params(labelsize=8)
    axes.set_axisbelow(False)  # an outline along an edge does not hide the marks of the axes
    if plane.is_map:
        axes.set_aspect("equal")


def _legend(figure: Figure, axes: Axes, shading: Shading, is_wide: bool) -> None:
    """Write the legend below the axes, each label once."""
    unique: dict[str, Any] = {}
    if shading.none is not None:
        value, label = shading.none
        unique[label] = Patch(facecolor=COLOURS(shading.norm(value)), edgecolor=INK, linewidth=1.8)
    handles, labels = axes.get_legend_handles_labels()
    unique |= dict(zip(labels, handles, strict=True))
    style: dict[str, Any] = {"fontsize": 8 if is_wide else 7.5, "columnspacing": 1.2}
    style |= {"frameon": False, "ncols": 3 if is_wide else 2, "handlelength": 1.8}
    plain(figure.legend(unique.values(), unique.keys(), loc="outside lower left", **style))
