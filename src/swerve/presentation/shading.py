"""Shade each hypothesis by one number, on a plane of two states, or of one state and time.

    colour = value of a hypothesis,    hatch = struck out,    outline = a chosen few

Hypotheses of a grid are shaded cell by cell; where the grid has more than two states, each place
shows the best of the cells behind it. Constraints of a list are drawn one over another, the best on
top. Where only some actions are forbidden in states, these states are crossed, not filled: being
there is allowed.

Shapes: H hypotheses, F cells of a grid, V corners of a polygon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Normal, Stroke

from swerve.base import phrases
from swerve.base.figure_style import INK
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.grid import GridHypotheses
from swerve.hypotheses.windows import WindowHypotheses
from swerve.presentation import plane as planes
from swerve.presentation.plane import Plane

NUM_OUTLINED = 100  # hypotheses outlined at most: more would hide the picture
MAX_RULED = 40  # cells a side up to which a grid has lines between its cells
DASHES = {"dash_offset": 0, "dash_list": [3, 3]}  # pt

MAX_ACTIONS = 3  # sets of forbidden actions up to which the legend names each of them
# marks of the colour bar of probabilities, about evenly spaced on the scale of `of_probability`
PROBABILITIES = {0.0: "0", 1e-3: "0.1 %", 0.01: "1 %", 0.1: "10 %", 0.3: "30 %", 1.0: "100 %"}

STRUCK_OUT, HATCH = "#f3f3f3", "#b4b4b4"


def _colour_map() -> LinearSegmentedColormap:
    """Return magma from light to dark; its yellow end is bleached, so that 0 is faint."""
    share = np.linspace(0.0, 1.0, 256)[:, None]
    bleach = 0.9 * np.clip(1.0 - share / 0.3, 0.0, 1.0)
    magma = mpl.colormaps["magma_r"](0.85 * share[:, 0])[:, :3]
    colours = bleach * 0.98 + (1.0 - bleach) * magma
    return LinearSegmentedColormap.from_list("swerve", list(map(tuple, colours)))


COLOURS = _colour_map()


def of_probability() -> PowerNorm:
    """Return the colour scale of probabilities: p^(1/3) from 0 to 1.

    The scale never adapts to the highest probability, so a colour means the same in every picture
    and only certainty is darkest. The root keeps the colours of probabilities below 1 % apart.
    """
    return PowerNorm(1.0 / 3.0, 0.0, 1.0)


class Shading(NamedTuple):
    """What a picture shows of the hypotheses.

    Attributes:
      values: [H] the numbers that the hypotheses are shaded by; -inf where struck out.
      norm: scale from values to colours.
      label: label of the colour bar.
      outlined: indices of the hypotheses with an outline; the first has a heavy one.
      labels: legend of the first outlined hypothesis, and of the others.
      text: returns the value of a hypothesis in words.
      is_set: whether the outlined hypotheses are one answer together.
      none: value of no constraint and its legend; None to leave no constraint out of the legend.
    """

    values: np.ndarray
    norm: Normalize
    label: str
    outlined: np.ndarray
    labels: tuple[str, str]
    text: Callable[[int], str]
    is_set: bool
    none: tuple[float, str] | None = None


def draw_values(axes: Axes, hypotheses: HypothesisSet, shading: Shading, plane: Plane) -> list[str]:
    """Shade the hypotheses left, hatch those struck out, and return notes for the reader."""
    cells = _cells(hypotheses, shading.values)
    if cells is not None:
        struck_out, notes = _draw_grid(axes, *cells, shading, plane)
        if isinstance(hypotheses, WindowHypotheses):
            notes.append("Each point shows the best of the windows around it.")
    else:
        struck_out, notes = _draw_list(axes, hypotheses, shading, plane)
    if len(struck_out):
        label = f"struck out by a demonstration ({np.isneginf(shading.values).sum()})"
        patch = patch_of(
            struck_out, facecolor=STRUCK_OUT, edgecolor=HATCH, hatch="////", label=label
        )
        patch.set(linewidth=0, hatch_linewidth=0.6, zorder=0.9)  # below the hypotheses left
        axes.add_patch(patch)
    return notes


def draw_outlined(
    axes: Axes, hypotheses: HypothesisSet, shading: Shading, plane: Plane
) -> list[str]:
    """Outline the chosen hypotheses, the best heavily and on top, and return notes for the reader.

    Windows, which overlap, and cells that are one answer together have one outline around them all.
    """
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
        constraint = hypotheses.constraint(index)
        outlines = plane.outlines(constraint)
        if not outlines:
            continue
        is_crossed = any(isinstance(part, StateAction) for part in constraint.parts)
        colour = "none" if is_crossed else COLOURS(shading.norm(shading.values[index]))
        patch = patch_of(outlines, facecolor=colour, clip_on=False, zorder=1.6 + 0.1 * is_best)
        weight = 5.0 if is_best else 2.4
        edge = [Stroke(linewidth=weight + 2, foreground="white"), Stroke(linewidth=weight)]
        top = Normal() if is_best else Stroke(linewidth=1.0, foreground="white", dashes=DASHES)
        patch.set(path_effects=[*edge, top])
        patch.set(edgecolor=INK, linewidth=0, label=shading.labels[not is_best])
        axes.add_patch(patch)
    more = 0 if is_region else len(shading.outlined) - len(shown)
    return [f"{more} more are {shading.labels[1]} and not outlined."] if more else []


def _draw_region(axes: Axes, image: np.ndarray, x: np.ndarray, y: np.ndarray, label: str) -> None:
    """Outline the cells of an image that are not -inf, along the edge of the region they form."""
    inside = np.pad(np.isfinite(image), 1)
    row, column = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    upright = [[(x[c], y[r]), (x[c], y[r + 1])] for r, c in zip(row, column, strict=True)]
    row, column = np.nonzero(inside[1:, 1:-1] != inside[:-1, 1:-1])
    level = [[(x[c], y[r]), (x[c + 1], y[r])] for r, c in zip(row, column, strict=True)]
    lines = LineCollection([*upright, *level], color=INK, linewidth=1.8, label=label)
    lines.set(path_effects=[Stroke(linewidth=3.6, foreground="white"), Normal()])
    lines.set(capstyle="projecting", clip_on=False, zorder=1.5)
    axes.add_collection(lines, autolim=False)


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
    note = f"Each place shows the best of the cells along {others}; hatched where no cell is left."
    return list(planes.corners(planes.runs(is_out, x, y))), [note] if others else []


def _draw_list(
    axes: Axes, hypotheses: HypothesisSet, shading: Shading, plane: Plane
) -> tuple[list[np.ndarray], list[str]]:
    """Shade constraints, the best on top; return the outlines struck out and notes."""
    struck_out, left, shades, crossed, skipped = [], [], [], [], 0
    for index in np.argsort(shading.values, kind="stable").tolist():
        parts = [(p, plane.outlines(p)) for p in hypotheses.constraint(index).parts]
        skipped += not any(outlines for _, outlines in parts)
        for part, outlines in parts:
            if np.isneginf(shading.values[index]):
                struck_out += outlines
            elif isinstance(part, StateAction) and outlines:
                colour = COLOURS(shading.norm(shading.values[index]))
                crossed.append((part.actions.name, outlines, colour))
            else:
                left += outlines
                shades += [shading.values[index]] * len(outlines)
    polygons = PolyCollection(left, cmap=COLOURS, norm=shading.norm)
    polygons.set(array=np.array(shades), edgecolor="face", linewidth=0.3)
    axes.add_collection(polygons, autolim=False)
    _draw_crossed(axes, crossed)
    num = phrases.counted(skipped, "hypothesis")
    note = f"Not drawn: {num} outside this picture or about other states."
    return struck_out, [note] if skipped else []


def _draw_crossed(axes: Axes, crossed: list[tuple[str, list[np.ndarray], Any]]) -> None:
    """Cross states where actions are forbidden, the last on top.

    Args:
      axes: to draw on.
      crossed: (name of the forbidden actions, outlines of the states, colour).
    """
    is_short = len({actions for actions, _, _ in crossed}) <= MAX_ACTIONS
    for actions, outlines, colour in crossed:
        label = phrases.cut(actions, 30) if is_short else "some actions"
        patch = patch_of(outlines, facecolor="none", label=f"{label} forbidden here")
        patch.set(edgecolor=colour, linewidth=1.2, hatch="xx", hatch_linewidth=2.0, zorder=1.1)
        patch.set(path_effects=[Stroke(linewidth=2.6, foreground=INK), Normal()])
        axes.add_patch(patch)


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
    """Return the best of the values [F] at each place, and the x and y of the lines between."""
    score = values.reshape(grid.shape)
    image = score.max(axis=tuple(range(2, score.ndim))).T if score.ndim > 1 else score[:, None]
    edges = [np.linspace(low, high, count + 1) for low, high, count in grid.axes.values()][:2]
    x, y = edges if len(edges) > 1 else (plane.limits[0], *edges)
    return image, x, y


def draw_colour_bar(axes: Axes, shading: Shading, location: str) -> None:
    """Draw the colour bar of a shading at a side of the axes: "right" or "bottom"."""
    colours = ScalarMappable(shading.norm, COLOURS)
    bar = cast(Figure, axes.figure).colorbar(
        colours, ax=axes, location=location, aspect=35, pad=0.02
    )
    if isinstance(shading.norm, PowerNorm):
        bar.set_ticks(list(PROBABILITIES), labels=list(PROBABILITIES.values()))
    bar.set_label(shading.label, fontsize=8.5)
    bar.ax.tick_params(labelsize=8)


def patch_of(outlines: Sequence[np.ndarray], **style: Any) -> PathPatch:
    """Return polygons, each [V, 2], as one patch."""
    closed = [Outline(np.append(outline, outline[:1], axis=0), closed=True) for outline in outlines]
    return PathPatch(Outline.make_compound_path(*closed), **style)
