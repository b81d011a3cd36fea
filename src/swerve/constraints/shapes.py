"""Constraints with a shape that is no box: balls, half-spaces and polygons.

    ball         |x - c| < r                 (angles by the shorter arc)
    half-space   sum_i n_i x_i >= offset
    polygon      a ray from x crosses its edges an odd number of times

Each names some of the states; those that it does not name are free.

Shapes: n state dimensions, V vertices, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import number_or_nan, two_names
from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints import polygons
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import call, short


class Ball(Constraint):
    """The states nearer to a centre than a radius: an open Euclidean ball.

    The distance is over the states that the centre names, in their own units, angles by the shorter
    arc.

    Args:
      radius: in the unit of the states.
      **centre: for each named state where the centre is.

    Raises:
      ValueError: if the radius is not above 0, or the centre names no state or is not finite.
    """

    def __init__(self, radius: float, /, **centre: float) -> None:
        self.radius = number_or_nan(radius)
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(
                f"Ball: expected a finite radius > 0, got {radius!r}: give it first, in the unit "
                "of the states, as in Ball(0.5, x=1.0, y=2.0)"
            )
        self.centre = _checked_axes("Ball", "a centre, as in Ball(0.5, x=1.0, y=2.0)", centre)

    def __repr__(self) -> str:
        """Return Python that makes this ball again, to the last digit."""
        return call("Ball", [repr(self.radius)], {k: repr(v) for k, v in self.centre.items()})

    @property
    def name(self) -> str:
        """For example 'ball of radius 0.5 at x 1, y 2'."""
        centre = ", ".join(f"{name} {short(value)}" for name, value in self.centre.items())
        return f"ball of radius {short(self.radius)} at {centre}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """From the centre less the radius to the centre plus the radius."""
        return {name: (x - self.radius, x + self.radius) for name, x in self.centre.items()}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is that of no state."""
        for name in self.centre:
            space.column(name)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] is nearer to the centre than the radius."""
        square = functools.reduce(operator.add, [d**2 for d in self._offsets(states, space)])
        return square < self.radius**2

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the nearest point of the segment is in the ball, or an image."""
        xp = starts.__array_namespace__()
        steps = space.difference(starts, ends)
        along = [steps[..., space.column(name)] for name in self.centre]
        length = functools.reduce(operator.add, [step**2 for step in along])
        hit = self.contains(starts, space) | self.contains(ends, space)
        images = [(-TWO_PI, 0.0, TWO_PI) if k in space.angles else (0.0,) for k in self.centre]
        for shifts in itertools.product(*images):
            offsets = [d + s for d, s in zip(self._offsets(starts, space), shifts, strict=True)]
            dots = (d * step for d, step in zip(offsets, along, strict=True))
            share = -functools.reduce(operator.add, dots) / xp.where(length > 0, length, 1.0)
            share = xp.clip(share, 0.0, 1.0)
            nearest = [(d + share * step) ** 2 for d, step in zip(offsets, along, strict=True)]
            hit = hit | (functools.reduce(operator.add, nearest) < self.radius**2)
        return hit

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n] over the states that it names."""
        to_centre = np.linalg.norm(self._offsets(np.asarray(states, float), space), axis=0)
        return np.maximum(0.0, to_centre - self.radius)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Ball:
        """Return the ball whose radius is less by the largest margin of the states it names.

        One that names angles alone and reaches round all of them has no edge: it stays as it is.
        """
        if set(self.centre) <= set(space.angles) and self.radius > math.pi * math.sqrt(
            len(self.centre)
        ):
            return self
        name = max(self.centre, key=lambda name: margin.get(name, 0.0))
        width = margin.get(name, 0.0)
        if not width < self.radius:
            raise ValueError(
                f"margin: {width:g} for {name!r} leaves nothing of {self.name}: expected less than "
                f"its radius, {self.radius:.6g}"
            )
        return Ball(self.radius - width, **self.centre)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "ball", "radius": self.radius, "centre": self.centre}

    def _offsets(self, states: Any, space: StateSpace) -> list[Any]:
        """Return for each named state where a state [..., n] lies from the centre, each [...]."""
        xp = states.__array_namespace__()
        offsets = []
        for name, centre in self.centre.items():
            offset = states[..., space.column(name)] - centre
            if name in space.angles:
                offset = offset - TWO_PI * xp.round(offset / TWO_PI)
            offsets.append(offset)
        return offsets


class HalfSpace(Constraint):
    """The states with sum_i n_i x_i >= offset, on one side of a line, a plane and so on.

    Args:
      offset: what the sum must reach.
      **normal: for each named state its factor n_i; no angles, which have no sides. A factor of 0
        leaves its state free, as if it were not named.

    Raises:
      ValueError: if no state is named, the normal is zero, or a number is not finite.
    """

    def __init__(self, offset: float, /, **normal: float) -> None:
        self.offset = number_or_nan(offset)
        if not math.isfinite(self.offset):
            raise ValueError(
                f"HalfSpace: expected a finite offset, got {offset!r}: give it first, as in "
                "HalfSpace(1.0, x=1.0) for x >= 1"
            )
        factors = _checked_axes("HalfSpace", "a normal, as in HalfSpace(1.0, x=1.0)", normal)
        self.normal = {name: factor for name, factor in factors.items() if factor != 0.0}
        if not self.normal:
            raise ValueError(
                f"HalfSpace: expected a normal that is not zero, got {factors}, which says nothing "
                "of any state: give at least one of them another factor"
            )

    def __repr__(self) -> str:
        """Return Python that makes this half-space again, to the last digit."""
        return call("HalfSpace", [repr(self.offset)], {k: repr(v) for k, v in self.normal.items()})

    @property
    def name(self) -> str:
        """For example 'x - 2 y >= 3'."""
        text = ""
        for name, factor in self.normal.items():
            sign = "-" if factor < 0 else "+" if text else ""
            size = "" if abs(factor) == 1.0 else f"{short(abs(factor))} "
            text += f" {sign} {size}{name}" if text else f"{sign}{size}{name}"
        return f"{text} >= {short(self.offset)}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Everything, unless it names one state alone."""
        if len(self.normal) > 1:
            return dict.fromkeys(self.normal, (-math.inf, math.inf))
        ((name, factor),) = self.normal.items()
        limit = self.offset / factor
        return {name: (limit, math.inf) if factor > 0 else (-math.inf, limit)}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is that of no state or of an angle."""
        _check_no_angles("HalfSpace", self.normal, space)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] is on the forbidden side, or on its edge."""
        return self._sum(states, space) >= self.offset

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where an end of the segment is in it: a sum is largest at an end."""
        return self.contains(starts, space) | self.contains(ends, space)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n] over the states that it names."""
        missing = self.offset - self._sum(np.asarray(states, float), space)
        return np.maximum(0.0, missing) / math.hypot(*self.normal.values())

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> HalfSpace:
        """Return the half-space offset by the sum of |n_i| times the margins."""
        widths = (abs(factor) * margin.get(name, 0.0) for name, factor in self.normal.items())
        return HalfSpace(self.offset + sum(widths), **self.normal)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "half_space", "offset": self.offset, "normal": self.normal}

    def _sum(self, states: Any, space: StateSpace) -> Any:
        parts = [factor * states[..., space.column(k)] for k, factor in self.normal.items()]
        return functools.reduce(operator.add, parts)


class Polygon(Constraint):
    """The states inside a polygon over two of them; it need not be convex.

    States on its edge itself count or do not, as rounding has it.

    Args:
      vertices: [V, 2] its corners in order, either way round.
      names: the two states, no angles.
      depth: how much farther than this from every edge a state must be, in the states' unit.

    Raises:
      ValueError: if there are fewer than 3 vertices, one is repeated or not finite, they lie on a
        line, the polygon crosses itself, the depth leaves nothing, or there are not two names.
    """

    def __init__(
        self, vertices: Any, names: Sequence[str] = ("x", "y"), depth: float = 0.0
    ) -> None:
        self.names = two_names(names, "Polygon: names")
        self.vertices = polygons.checked_vertices(vertices)
        self.depth = number_or_nan(depth)
        if not 0.0 <= self.depth < math.inf:
            raise ValueError(f"Polygon: expected a finite depth >= 0, got {depth!r}")
        if self.depth and not self.depth < polygons.deepest(self.vertices):
            raise ValueError(
                f"Polygon: a depth of {self.depth:g} leaves nothing: expected less than "
                f"{polygons.deepest(self.vertices):.3g}"
            )
        low, high = self.vertices.min(axis=0) + self.depth, self.vertices.max(axis=0) - self.depth
        self._limits = np.stack([low, high], axis=1).tolist()

    def __repr__(self) -> str:
        """Return Python that makes this polygon again, to the last digit."""
        corners = ", ".join(f"({x!r}, {y!r})" for x, y in self.vertices.tolist())
        arguments = [f"[{corners}]"]
        if self.names != ("x", "y"):
            arguments.append(f"names={self.names!r}")
        if self.depth:
            arguments.append(f"depth={self.depth!r}")
        return f"Polygon({', '.join(arguments)})"

    @property
    def name(self) -> str:
        """For example 'polygon of 5 vertices in x [0, 2], y [1, 3]'."""
        extent = ", ".join(
            f"{name} [{short(low)}, {short(high)}]" for name, (low, high) in self.spans.items()
        )
        deep = f", {short(self.depth)} deep" if self.depth else ""
        return f"polygon of {len(self.vertices)} vertices in {extent}{deep}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """From the least to the greatest of its vertices."""
        low, high = self.vertices.min(axis=0).tolist(), self.vertices.max(axis=0).tolist()
        return {name: (low[k], high[k]) for k, name in enumerate(self.names)}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is that of no state or of an angle."""
        _check_no_angles("Polygon", self.names, space)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] is inside, deeper than `depth`."""
        x, y = self._points(states, space)
        near = self._is_near((x, x), (y, y))
        return polygons.where_near(self._holds, near, (x, y), len(self.vertices))

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment meets the polygon.

        It can enter or leave only where it cuts one of the lines and circles on which the edge
        lies. Between two such points all of it is inside or all outside, as the middle tells.
        """
        xp = starts.__array_namespace__()
        (x, y), (end_x, end_y) = self._points(starts, space), self._points(ends, space)
        spans = [(xp.minimum(a, b), xp.maximum(a, b)) for a, b in ((x, end_x), (y, end_y))]
        near = self._is_near(*spans)
        return polygons.where_near(self._meets, near, (x, y, end_x, end_y), len(self.vertices))

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n] over its two states.

        Raises:
          ValueError: if it has a depth, with which there is no telling.
        """
        if self.depth:
            raise ValueError(f"{self.name}: expected a Polygon without depth to tell distances to")
        x, y = self._points(np.asarray(states, float), space)

        def outside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            square = polygons.square_to_edge(self.vertices, x, y)
            return np.where(self._holds(x, y), 0.0, np.sqrt(square))

        flat = [np.reshape(value, -1) for value in (x, y)]
        return polygons.blockwise(outside, flat, len(self.vertices)).reshape(np.shape(x))

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Polygon:
        """Return what is farther from every edge than the largest margin of its two states."""
        name = max(self.names, key=lambda name: margin.get(name, 0.0))
        width = margin.get(name, 0.0)
        room = polygons.deepest(self.vertices) - self.depth
        if width and not width < room:
            raise ValueError(
                f"margin: {width:g} for {name!r} leaves nothing of {self.name}: expected less than "
                f"{room:.3g}, the distance of its deepest point from the edge"
            )
        return Polygon(self.vertices, self.names, self.depth + width)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        vertices, names = self.vertices.tolist(), list(self.names)
        return {"kind": "polygon", "vertices": vertices, "names": names, "depth": self.depth}

    def _points(self, states: Any, space: StateSpace) -> tuple[Any, Any]:
        first, second = (states[..., space.column(name)] for name in self.names)
        return first, second

    def _is_near(self, x: tuple[Any, Any], y: tuple[Any, Any]) -> Any:
        """Return [...] whether (least, greatest) x and y reach the rectangle that it fills."""
        (low_x, high_x), (low_y, high_y) = self._limits
        in_x = (x[1] >= low_x) & (x[0] <= high_x)
        return in_x & (y[1] >= low_y) & (y[0] <= high_y)

    def _meets(self, x: Any, y: Any, end_x: Any, end_y: Any) -> Any:
        """Return [...] whether segments have a point inside, both ends included."""
        hit = self._holds(x, y) | self._holds(end_x, end_y)
        points = (x, y, end_x, end_y)
        return hit | polygons.where_near(self._passes, ~hit, points, len(self.vertices))

    def _passes(self, x: Any, y: Any, end_x: Any, end_y: Any) -> Any:
        """Return [...] whether segments have a part inside, their ends not."""
        xp = x.__array_namespace__()
        dx, dy = end_x - x, end_y - y
        share = polygons.cuts(self.vertices, self.depth, (x, y), (dx, dy))
        bounds = xp.zeros_like(x)[None], share, xp.ones_like(x)[None]
        share = xp.concatenate(bounds)
        middle = 0.5 * (share[1:] + share[:-1])
        is_piece = share[1:] > share[:-1]  # a corner that is touched is none
        return (is_piece & self._holds(x + middle * dx, y + middle * dy)).any(axis=0)

    def _holds(self, x: Any, y: Any) -> Any:
        inside = polygons.encloses(self.vertices, x, y)
        if self.depth:
            inside = inside & polygons.is_farther(self.vertices, self.depth, x, y)
        return inside


def _checked_axes(kind: str, expected: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return finite numbers by state."""
    if not values:
        raise ValueError(f"{kind}: expected {expected}, got none")
    checked = {name: number_or_nan(value) for name, value in values.items()}
    for name, value in checked.items():
        if not math.isfinite(value):
            raise ValueError(f"{kind}: expected a finite number for {name!r}, got {values[name]!r}")
    return checked


def _check_no_angles(kind: str, names: Sequence[str] | Mapping[str, float], space: Any) -> None:
    for name in names:
        space.column(name)
        if name in space.angles:
            raise ValueError(
                f"{kind}: {name!r} is an angle, which goes round and has no sides: use a Box, a "
                "Ball or a Predicate"
            )
