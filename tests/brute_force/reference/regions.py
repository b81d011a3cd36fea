"""Forbidden sets as plain data, and who enters them.

A region knows the signed depth of points (see `geometry`), its distance, and itself less a margin.
A step enters a region where its segment meets the set, or by its end alone where states alone are
judged; and where its action is forbidden in the state in which the step begins.

Shapes: N points, S steps, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from brute_force.reference.geometry import (
    NEAR,
    TURN,
    Axes,
    is_inside,
    meets,
    polygon_depth,
    rectangles_gap,
    wrapped,
)


class Steps(NamedTuple):
    """Steps of trajectories: starts and ends [S, n], and actions [S, m] by name."""

    starts: np.ndarray
    ends: np.ndarray
    actions: np.ndarray
    action_names: tuple[str, ...]


class NothingLeftError(Exception):
    """A margin leaves nothing of a region, or the region has no shape."""


class Region:
    """A set of states."""

    @property
    def about_actions(self) -> bool:
        """Whether the region forbids actions."""
        return False

    @property
    def has_shape(self) -> bool:
        """Whether margins and distances have a meaning."""
        return True

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        """Return the signed depth [N] of points [N, n]."""
        raise NotImplementedError

    def less(self, margin: Mapping[str, float]) -> Region:
        """Return the set less a margin."""
        raise NothingLeftError

    def holds(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        """Return [N] True where a point lies in the set."""
        return is_inside(self.depth(points, axes))

    def gap(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        """Return the distance [N] of points to the set, 0 inside."""
        return np.maximum(0.0, -self.depth(points, axes))

    def entered(self, steps: Steps, axes: Axes, between: bool) -> np.ndarray:
        """Return [S] True where a step enters the set."""
        if not between:
            return self.holds(steps.ends, axes)
        along = axes.steps(steps.starts, steps.ends)
        return meets(lambda points: self.depth(points, axes), steps.starts, along)

    def entered_at_start(self, start: np.ndarray, axes: Axes) -> bool:
        """Return whether a trajectory enters the set by its first state [n]."""
        return bool(self.holds(start[None], axes)[0])


@dataclass(frozen=True)
class BoxRegion(Region):
    """Intervals of some states; an interval of an angle may lie anywhere."""

    intervals: dict[str, tuple[float, float]]

    def _depths(self, points: np.ndarray, axes: Axes) -> list[np.ndarray]:
        depths = []
        for name, (low, high) in self.intervals.items():
            x = points[:, axes.column(name)]
            if name in axes.angles:
                if high - low > TURN - 1e-9:
                    depths.append(np.full(len(points), np.inf))
                else:
                    half = 0.5 * (high - low)
                    depths.append(half - np.abs(wrapped(x - low - half)))
            else:
                depths.append(np.minimum(x - low, high - x))
        return depths

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.min(self._depths(points, axes), axis=0)

    def gap(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        outside = [np.maximum(0.0, -depth) for depth in self._depths(points, axes)]
        return np.asarray(np.linalg.norm(outside, axis=0))

    def less(self, margin: Mapping[str, float]) -> Region:
        left = {}
        for name, (low, high) in self.intervals.items():
            width = margin.get(name, 0.0)
            if high - low <= 2.0 * width + 10 * NEAR:
                raise NothingLeftError
            left[name] = (low + width, high - width)
        return BoxRegion(left)


@dataclass(frozen=True)
class BallRegion(Region):
    """What is nearer to a centre than a radius."""

    radius: float
    centre: dict[str, float]

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        square = np.zeros(len(points))
        for name, middle in self.centre.items():
            off = points[:, axes.column(name)] - middle
            square += (wrapped(off) if name in axes.angles else off) ** 2
        return self.radius - np.sqrt(square)

    def less(self, margin: Mapping[str, float]) -> Region:
        width = max(margin.get(name, 0.0) for name in self.centre)
        if self.radius <= width + 10 * NEAR:
            raise NothingLeftError
        return replace(self, radius=self.radius - width)


@dataclass(frozen=True)
class HalfSpaceRegion(Region):
    """What lies on one side of a hyperplane."""

    offset: float
    normal: dict[str, float]

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        columns = [axes.column(name) for name in self.normal]
        factors = np.array(list(self.normal.values()))
        return (points[:, columns] @ factors - self.offset) / np.linalg.norm(factors)

    def less(self, margin: Mapping[str, float]) -> Region:
        more = sum(abs(f) * margin.get(name, 0.0) for name, f in self.normal.items())
        return replace(self, offset=self.offset + more)


@dataclass(frozen=True)
class PolygonRegion(Region):
    """What lies inside a polygon over two states, deeper than `deep`."""

    vertices: tuple[tuple[float, float], ...]
    names: tuple[str, str]
    deep: float = 0.0

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        flat = points[:, [axes.column(name) for name in self.names]]
        return polygon_depth(np.array(self.vertices), flat) - self.deep

    def less(self, margin: Mapping[str, float]) -> Region:
        deep = self.deep + max(margin.get(name, 0.0) for name in self.names)
        low, high = np.min(self.vertices, axis=0), np.max(self.vertices, axis=0)
        x, y = (np.linspace(*ends, 40) for ends in zip(low, high, strict=True))
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if polygon_depth(np.array(self.vertices), places).max() < deep + 10 * NEAR:
            raise NothingLeftError
        return replace(self, deep=deep)


@dataclass(frozen=True)
class MapRegion(Region):
    """The blocked cells of a map over two states, and everything beyond the map."""

    blocked: tuple[tuple[bool, ...], ...]
    corner: tuple[float, float]
    cell: float
    names: tuple[str, str]

    @property
    def has_shape(self) -> bool:
        return False

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        flat = points[:, [axes.column(name) for name in self.names]]
        to_blocked = np.minimum(self._gap_to(flat, True), self._gap_beyond(flat))
        return np.where(to_blocked > 0.0, -to_blocked, self._gap_to(flat, False))

    def _gap_to(self, points: np.ndarray, kind: bool) -> np.ndarray:
        rows, columns = np.nonzero(np.array(self.blocked) == kind)
        x0, y0 = self.corner[0] + columns * self.cell, self.corner[1] + rows * self.cell
        corners = np.stack([x0, x0 + self.cell, y0, y0 + self.cell], axis=1)
        return rectangles_gap(corners, points)

    def _gap_beyond(self, points: np.ndarray) -> np.ndarray:
        x, y = (points - self.corner).T
        rows, columns = np.shape(self.blocked)
        inner = np.min([x, columns * self.cell - x, y, rows * self.cell - y], axis=0)
        return np.maximum(0.0, inner)


@dataclass(frozen=True)
class PredicateRegion(Region):
    """What a function of states calls forbidden; segments are tried at evenly spaced points."""

    name: str
    function: Callable[[Any], Any]
    num_points: int

    @property
    def has_shape(self) -> bool:
        return False

    def depth(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return self.function(points)

    def entered(self, steps: Steps, axes: Axes, between: bool) -> np.ndarray:
        if not between:
            return self.holds(steps.ends, axes)
        along = axes.steps(steps.starts, steps.ends)
        tried = [
            self.depth(steps.starts + k / self.num_points * along, axes)
            for k in range(self.num_points + 1)
        ]
        return is_inside(np.max(tried, axis=0))


@dataclass(frozen=True)
class UnionRegion(Region):
    """What at least one of several regions forbids."""

    name: str
    parts: tuple[Region, ...]

    @property
    def about_actions(self) -> bool:
        return any(part.about_actions for part in self.parts)

    @property
    def has_shape(self) -> bool:
        return all(part.has_shape for part in self.parts)

    def holds(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.any([part.holds(points, axes) for part in self.parts], axis=0)

    def gap(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.min([part.gap(points, axes) for part in self.parts], axis=0)

    def entered(self, steps: Steps, axes: Axes, between: bool) -> np.ndarray:
        return np.any([part.entered(steps, axes, between) for part in self.parts], axis=0)

    def less(self, margin: Mapping[str, float]) -> Region:
        return replace(self, parts=tuple(part.less(margin) for part in self.parts))


@dataclass(frozen=True)
class ActionRegion(Region):
    """Intervals of some components of actions, forbidden in every state."""

    intervals: dict[str, tuple[float, float]]

    @property
    def about_actions(self) -> bool:
        return True

    def forbids(self, actions: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
        """Return [S] True where an action [S, m] lies in the intervals."""
        inside = np.ones(len(actions), bool)
        for name, (low, high) in self.intervals.items():
            value = actions[:, names.index(name)]
            inside &= is_inside(np.minimum(value - low, high - value))
        return inside

    def holds(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.zeros(len(points), bool)

    def gap(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.full(len(points), np.inf)

    def entered(self, steps: Steps, axes: Axes, between: bool) -> np.ndarray:
        return self.forbids(steps.actions, steps.action_names)

    def less(self, margin: Mapping[str, float]) -> Region:
        return self


@dataclass(frozen=True)
class StateActionRegion(Region):
    """Some actions, forbidden where they begin in some states."""

    states: Region
    actions: ActionRegion

    @property
    def about_actions(self) -> bool:
        return True

    def holds(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return np.zeros(len(points), bool)

    def gap(self, points: np.ndarray, axes: Axes) -> np.ndarray:
        return self.states.gap(points, axes)

    def entered(self, steps: Steps, axes: Axes, between: bool) -> np.ndarray:
        begins = self.states.holds(steps.starts, axes)
        return begins & self.actions.forbids(steps.actions, steps.action_names)

    def less(self, margin: Mapping[str, float]) -> Region:
        return replace(self, states=self.states.less(margin))
