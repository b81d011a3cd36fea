"""Choose the plane that a picture shows, two states or one state against time, and map onto it.

An angle is drawn over one turn, [turn, turn + 2 pi). A path across the edge of the turn leaves the
picture at one side and comes back at the other; a box across that edge is two rectangles.
Constraints become polygons, or rectangles (x low, x high, y low, y high).

Shapes: L points of a path, R rectangles, H hypotheses, n states.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints import polygon_geometry
from swerve.constraints.base import Constraint, Union
from swerve.constraints.boxes import Box
from swerve.constraints.polygons import Polygon
from swerve.constraints.shapes import Ball, HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import GridHypotheses
from swerve.hypotheses.windows import WindowHypotheses
from swerve.inference.ranking import Ranking
from swerve.problem.record import ProblemRecord

TIME = ""  # the name of the time axis, since no state has an empty name
RASTER = 360  # points a side at which constraints without an outline are evaluated
NEAR = 0.08  # share of a state's bounds: an axis that ends this near to a bound is drawn up to it
MARGIN = 0.02  # share of the range that is left free beyond paths that leave the hypotheses
ROUNDING = 1e-9  # rad, and share of an axis: differences below it come from rounding
ROUND = 120  # corners of the polygon that a ball is drawn as
CORNERS = [[0, 2], [1, 2], [1, 3], [0, 3]]  # columns of a rectangle's x and y, corner by corner
MAX_IMAGES = 4  # rectangles that a box becomes where the edges of two angles cut it
LABEL_ROOM = 1.3  # half extents of a label, from its centre to the edge of its constraint
DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)])
EVERYTHING = (-math.inf, math.inf)


class Path(NamedTuple):
    """States [L, n] and their times [L] in seconds; None where the times are not known."""

    states: np.ndarray
    times: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Plane:
    """The two axes of a picture.

    Attributes:
      space: the state space.
      names: the state on each axis; TIME for time.
      has_times: whether time is in seconds; else time is the share of a path, from 0 to 1.
      turns: [2] where the drawn turn of an angle begins [rad]; NaN for an axis without an angle.
      limits: [2, 2] the drawn range of each axis.
    """

    space: StateSpace
    names: tuple[str, str]
    has_times: bool
    turns: np.ndarray
    limits: np.ndarray

    @property
    def labels(self) -> tuple[str, str]:
        """Labels of the axes, with their units where these are known."""
        time = "time [s]" if self.has_times else "share of the trajectory"
        first, second = (
            f"{name} [rad]" if name in self.space.angles else name or time for name in self.names
        )
        return first, second

    @property
    def is_map(self) -> bool:
        """Whether the axes are the positions x and y, with ranges that one scale can show."""
        x, y = self.limits[:, 1] - self.limits[:, 0]
        return set(self.names) == {"x", "y"} and bool(1 / 4 <= x / y <= 4)

    def line(self, path: Path) -> np.ndarray:
        """Return a path as points [L, 2] without jumps, so angles may leave the drawn turn."""
        return _points(path, self.space, self.names, self.has_times)

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Return points [..., 2] with angles moved into the drawn turn."""
        return np.where(np.isnan(self.turns), points, _wrap(points, self.turns))

    def pieces(self, path: Path) -> np.ndarray:
        """Return a path inside the drawn turn as points [P, 2], with NaN where the line breaks.

        Each piece has one more point beyond the edge of the turn: its line then reaches the edge.
        """
        points = self.line(path)
        turn = np.nan_to_num(np.floor((points - self.turns) / TWO_PI))
        pieces = []
        for number in itertools.product(*(np.unique(column) for column in turn.T)):
            shown = np.pad((turn == number).all(axis=1), 1)
            shown = shown[:-2] | shown[1:-1] | shown[2:]
            piece = np.where(shown[:, None], points - TWO_PI * np.array(number), np.nan)
            pieces += [piece, np.full((1, 2), np.nan)]
        return np.concatenate(pieces[:-1])

    def outlines(self, constraint: Constraint) -> list[np.ndarray]:
        """Return polygons, each [V, 2], that show a constraint within the limits.

        Balls, polygons and half-spaces have their own outlines; `rectangles` outlines all others. A
        constraint on actions in some states is shown as these states.
        """
        if isinstance(constraint, StateAction):
            return self.outlines(constraint.states)
        if isinstance(constraint, Union):
            return [outline for part in constraint.parts for outline in self.outlines(part)]
        shown = self._shape(constraint)
        if shown is None:
            return list(corners(self.rectangles(constraint)))
        images = [(-TWO_PI, 0.0, TWO_PI) if wraps else (0.0,) for wraps in ~np.isnan(self.turns)]
        moved = (self.wrapped(shown.mean(axis=0)) - shown.mean(axis=0)) + shown
        parts = [
            polygon_geometry.clipped(moved + k, self.limits) for k in itertools.product(*images)
        ]
        return [part for part in parts if len(part) > 2]

    def _shape(self, constraint: Constraint) -> np.ndarray | None:
        """Return the outline [V, 2] of a shape, not yet clipped; None where it has no outline."""
        drawn = [name for name in self.names if name in constraint.spans]
        if isinstance(constraint, Ball) and len(drawn) == 2:
            angle = np.linspace(0.0, TWO_PI, ROUND, endpoint=False)
            circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            return (
                np.array([constraint.centre[name] for name in drawn]) + constraint.radius * circle
            )
        if isinstance(constraint, Polygon) and len(drawn) == 2 and not constraint.depth:
            return constraint.vertices[:, [constraint.names.index(name) for name in drawn]]
        if isinstance(constraint, HalfSpace) and 0 < len(drawn) == len(constraint.normal):
            normal = np.array([constraint.normal.get(name, 0.0) for name in self.names])
            picture = corners(self.limits.reshape(1, 4))[0]
            return polygon_geometry.cut_off(picture, normal, constraint.offset)
        return None

    def rectangles(self, constraint: Constraint) -> np.ndarray:
        """Return [R, 4] rectangles (x low, x high, y low, y high) that show a constraint.

        A box is projected on the plane. Other constraints are shown as the section where each state
        that is not drawn is in the middle of its bounds. There are no rectangles (R = 0) where the
        constraint is outside the picture or is about other states, nor for a predicate whose code
        is missing.
        """
        if isinstance(constraint, Union):
            return np.concatenate([self.rectangles(part) for part in constraint.parts])
        if isinstance(constraint, StateAction):
            return self.rectangles(constraint.states)
        if (
            isinstance(constraint, Ball | Polygon)
            and len(set(self.names) & set(constraint.spans)) < 2
        ):
            return self.rectangles(Box(**constraint.spans))
        if not isinstance(constraint, Box):
            return self._raster(constraint)
        if not set(self.names) & set(constraint.intervals):
            return np.zeros((0, 4))
        box = np.array([constraint.intervals.get(name, EVERYTHING) for name in self.names])
        wraps = ~np.isnan(self.turns) & np.isfinite(box).all(axis=1)
        low = np.where(wraps, box[:, 0], 0.0)
        shift = np.where(wraps, _wrap(low, self.turns) - low, 0.0)
        images = itertools.product(*((0.0, TWO_PI) if wrap else (0.0,) for wrap in wraps))
        parts = np.array([box + (shift - image)[:, None] for image in images])
        parts = np.clip(parts, self.limits[:, :1], self.limits[:, 1:])
        least = ROUNDING * (self.limits[:, 1] - self.limits[:, 0])
        return parts[(parts[..., 1] - parts[..., 0] > least).all(axis=1)].reshape(-1, 4)

    def place(self, shown: np.ndarray, busy: np.ndarray, label: np.ndarray) -> np.ndarray:
        """Return where to put a label beside a constraint, and where its line meets the constraint.

        Args:
          shown: [R, 4] rectangles that show the constraint.
          busy: [P, 2] points that the label should not hide; NaN is ignored.
          label: [2] half extents of the label, as shares of the axes.

        Returns:
          [2, 2] centre of the label and end of the line, as shares of the axes.
        """
        low, extent = self.limits[:, :1], self.limits[:, 1:] - self.limits[:, :1]
        parts = (shown.reshape(-1, 2, 2) - low) / extent
        box = parts[np.diff(parts).prod(axis=1).argmax()]
        if len(parts) > MAX_IMAGES:  # the constraint is a raster: take the box around it
            box = np.stack([parts[..., 0].min(axis=0), parts[..., 1].max(axis=0)], axis=1)
        middle, half = box.mean(axis=1), np.diff(box)[:, 0] / 2
        places = np.clip(middle + DIRECTIONS * (half + LABEL_ROOM * label), label, 1 - label)
        points = (busy - low.T) / extent.T
        cost = (np.abs(points[:, None] - places) < label).all(axis=2).sum(axis=0).astype(float)
        cost += 1e9 * (np.abs(places - middle) < half + label).all(axis=1)
        best = places[cost.argmin()]
        return np.stack([best, np.clip(best, middle - half, middle + half)])

    def _raster(self, constraint: Constraint) -> np.ndarray:
        """Return [R, 4] rectangles of the raster's cells whose centres are in a constraint."""
        edges = [np.linspace(low, high, RASTER + 1) for low, high in self.limits]
        states = np.tile(self.space.bounds.mean(axis=1), (RASTER, RASTER, 1))
        middles = np.meshgrid(*(0.5 * (edge[1:] + edge[:-1]) for edge in edges))
        for name, values in zip(self.names, middles, strict=True):
            if name != TIME:
                states[..., self.space.column(name)] = values
        try:
            return runs(np.asarray(constraint.contains(states, self.space)), *edges)
        except ValueError:  # a predicate read from a file, which holds no code
            return np.zeros((0, 4))


def nominal_paths(inference: Ranking, most: int) -> list[Path]:
    """Return at most `most` nominal trajectories, equally many from each task used."""
    tasks = np.flatnonzero(inference.task_counts)
    tasks = tasks[:: math.ceil(len(tasks) / most)]
    kept = inference.evidence.samples.kept[tasks, : most // len(tasks)]
    times = np.arange(kept.shape[2]) * inference.evidence.problem.dt
    return [Path(states, times) for of_task in kept for states in of_task]


def plane_of(problem: ProblemRecord, paths: Sequence[Path]) -> Plane:
    """Choose the plane, and its range so that the hypotheses and all paths fit in.

    Args:
      problem: its hypotheses name the states to draw.
      paths: the paths that must be visible. Time is in seconds if all paths have times.
    """
    space, hypotheses = problem.space, problem.hypotheses
    drawn = hypotheses.state_names
    if not drawn or (len(drawn) < 2 and hypotheses.needs_code):
        drawn = tuple(dict.fromkeys((*drawn, *space.names)))
    first, second = (TIME, *drawn[:2])[-2:]
    names, has_times = (first, second), all(path.times is not None for path in paths)
    points = [_points(path, space, names, has_times) for path in paths]
    everywhere = np.concatenate([np.zeros((0, 2)), *points])
    axes = [_axis(hypotheses, space, name, everywhere[:, k]) for k, name in enumerate(names)]
    turns, limits = zip(*axes, strict=True)
    return Plane(space, names, has_times, np.array(turns), np.array(limits))


def corners(rectangles: np.ndarray) -> np.ndarray:
    """Return the corners [R, 4, 2] of rectangles [R, 4]."""
    return rectangles[:, CORNERS]


def runs(mask: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return [R, 4] rectangles that cover the True cells of a mask [len(y) - 1, len(x) - 1].

    Args:
      mask: cells, the first axis along y.
      x: the lines between its columns.
      y: the lines between its rows.
    """
    change = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(change == 1)
    _, stop = np.nonzero(change == -1)
    return np.stack([x[start], x[stop], y[row], y[row + 1]], axis=1)


def _points(path: Path, space: StateSpace, names: tuple[str, str], has_times: bool) -> np.ndarray:
    """Return a path as points [L, 2] of the axes `names`, angles unwrapped."""
    columns = []
    for name in names:
        if name in space.angles:
            columns.append(np.unwrap(path.states[:, space.column(name)]))
        elif name != TIME:
            columns.append(path.states[:, space.column(name)])
        elif has_times and path.times is not None:
            columns.append(path.times - path.times[0])
        else:
            columns.append(np.linspace(0.0, 1.0, len(path.states)))
    return np.stack(columns, axis=1)


def _axis(
    hypotheses: HypothesisSet, space: StateSpace, name: str, values: np.ndarray
) -> tuple[float, tuple[float, float]]:
    """Return where the drawn turn of an axis begins (NaN if it is no angle), and its range.

    Args:
      hypotheses: their intervals of the state must be visible.
      space: the state space.
      name: the state on the axis, or TIME.
      values: [P] values of all paths on the axis.
    """
    if name == TIME:
        return math.nan, (0.0, float(values.max(initial=0.0)) or 1.0)
    bounds = space.bounds[space.column(name)]
    intervals = _intervals(hypotheses, name)
    is_grid = isinstance(hypotheses, GridHypotheses | WindowHypotheses)
    if not is_grid and name not in space.angles:
        intervals = np.clip(intervals, *bounds)
    if hypotheses.needs_code or not len(intervals):
        intervals = np.concatenate([intervals, bounds[None]])
    if name not in space.angles:
        low, high = _hull(intervals, values)
        if not is_grid:
            low, high = _whole(low, high, *bounds.tolist())
        return math.nan, (low, high)
    turn = float((intervals if is_grid else bounds).mean()) - math.pi
    low = _wrap(intervals[:, 0], turn)
    moved = np.stack([low, low + intervals[:, 1] - intervals[:, 0]], axis=1)
    low, high = _hull(moved, _wrap(values, turn))
    if high > turn + TWO_PI:
        low = turn
    return turn, (max(low, turn), min(high, turn + TWO_PI))


def _intervals(hypotheses: HypothesisSet, name: str) -> np.ndarray:
    """Return [R, 2] the intervals of one state that the hypotheses name."""
    found: list[tuple[float, float]] = []
    if isinstance(hypotheses, GridHypotheses | WindowHypotheses):
        found = [hypotheses.axes[name][:2]] if name in hypotheses.axes else []
    elif isinstance(hypotheses, ConstraintHypotheses):
        parts = [part for constraint in hypotheses.constraints for part in constraint.parts]
        found = [part.spans[name] for part in parts if name in part.spans]
    return np.array(found).reshape(-1, 2)


def _hull(intervals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return the range of intervals [R, 2] and values [P], with a margin at values outside."""
    low, high = float(intervals.min()), float(intervals.max())
    least, most = float(values.min(initial=low)), float(values.max(initial=high))
    margin = MARGIN * (most - least)
    return least - margin * (least < low), most + margin * (most > high)


def _whole(low: float, high: float, least: float, most: float) -> tuple[float, float]:
    """Return a range, widened to a bound that it nearly reaches: else it would look cropped."""
    near = NEAR * (most - least)
    low = least if least < low < least + near else low
    return low, most if most - near < high < most else high


def _wrap(values: np.ndarray, turn: float | np.ndarray) -> np.ndarray:
    """Return angles [rad] moved into [turn, turn + 2 pi); rounding below the turn is left."""
    return turn + (values - turn + ROUNDING) % TWO_PI - ROUNDING
