"""Define constraints that are polygons over two of the states.

    x lies inside    where a ray from x crosses the edges an odd number of times;

with a depth d, where x is also farther than d from every edge. `polygon_geometry` computes both.

Shapes: V vertices, n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from swerve.base.arguments import number_or_nan, two_names
from swerve.base.space import StateSpace, single, wide
from swerve.constraints import polygon_geometry
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import short
from swerve.constraints.edges import depth
from swerve.constraints.shapes import check_no_angles


class Polygon(Constraint):
    """The states inside a polygon over two of the states; the polygon need not be convex.

    A state on the edge, but for the resolution of the states (`constraints.edges`), is outside.

    Args:
      vertices: [V, 2] the corners in order, either way round.
      names: the two states, no angles.
      depth: states inside lie farther than this from every edge, in the states' unit.

    Raises:
      ValueError: if there are fewer than 3 vertices, a vertex is repeated or not finite, all
        vertices lie on a line, the polygon crosses itself, the depth leaves nothing, or there are
        not two names.
    """

    def __init__(
        self, vertices: Any, names: Sequence[str] = ("x", "y"), depth: float = 0.0
    ) -> None:
        self.names = two_names(names, "Polygon: names")
        self.vertices = polygon_geometry.checked_vertices(vertices)
        self.depth = number_or_nan(depth)
        if not 0.0 <= self.depth < math.inf:
            raise ValueError(f"Polygon: expected a finite depth >= 0, got {depth!r}")
        if self.depth and not self.depth < polygon_geometry.deepest(self.vertices):
            raise ValueError(
                f"Polygon: a depth of {self.depth:g} leaves nothing: expected less than "
                f"{polygon_geometry.deepest(self.vertices):.3g}"
            )
        low, high = self.vertices.min(axis=0) + self.depth, self.vertices.max(axis=0) - self.depth
        self._limits = np.stack([low, high], axis=1).tolist()

    def __repr__(self) -> str:
        """Return Python code that makes this polygon again, to the last digit."""
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
        """From the least to the greatest coordinate of the vertices."""
        low, high = self.vertices.min(axis=0).tolist(), self.vertices.max(axis=0).tolist()
        return {name: (low[k], high[k]) for k, name in enumerate(self.names)}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is not that of a state, or is that of an angle."""
        check_no_angles("Polygon", self.names, space)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies inside, deeper than `depth`."""
        x, y = self._points(states, space)
        near = self._is_near((x, x), (y, y))
        holds = partial(self._holds, self._deep(space))
        return polygon_geometry.where_near(holds, near, (x, y), len(self.vertices))

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment meets the polygon.

        A segment can enter or leave the polygon only where the segment cuts one of the lines and
        circles on which the edge lies. Between two such cuts the segment is all inside or all
        outside, so its middle is tried: a segment along an edge, or through a corner that it only
        touches, does not enter.
        """
        xp = starts.__array_namespace__()
        (x, y), (end_x, end_y) = self._points(starts, space), self._points(ends, space)
        spans = [(xp.minimum(a, b), xp.maximum(a, b)) for a, b in ((x, end_x), (y, end_y))]
        near = self._is_near(*spans)
        meets = partial(self._meets, self._deep(space))
        return polygon_geometry.where_near(meets, near, (x, y, end_x, end_y), len(self.vertices))

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n], over the two named states.

        Raises:
          ValueError: if the polygon has a depth: distances to such a set are not computed.
        """
        if self.depth:
            raise ValueError(f"{self.name}: expected a Polygon without depth to measure distances")
        x, y = self._points(np.asarray(states, float), space)

        def outside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            square = polygon_geometry.square_to_edge(self.vertices, x, y)
            return np.where(self._holds(self.depth, x, y), 0.0, np.sqrt(square))

        flat = [np.reshape(value, -1) for value in (x, y)]
        return polygon_geometry.blockwise(outside, flat, len(self.vertices)).reshape(np.shape(x))

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Polygon:
        """Return the polygon with its depth greater by the larger margin of its two states."""
        name = max(self.names, key=lambda name: margin.get(name, 0.0))
        width = margin.get(name, 0.0)
        room = polygon_geometry.deepest(self.vertices) - self.depth
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
        states = wide(single(states))
        first, second = (states[..., space.column(name)] for name in self.names)
        return first, second

    def _deep(self, space: StateSpace) -> float:
        """Return how far from every edge a state must lie: the depth and the resolution."""
        resolution = max(space.resolution[[*map(space.column, self.names)]])
        width = min(high - low for low, high in self._limits)
        size = float(np.abs(self.vertices).max())
        return self.depth + depth(resolution, width, size)

    def _is_near(self, x: tuple[Any, Any], y: tuple[Any, Any]) -> Any:
        """Return [...] True where ranges (least, greatest) of x, y meet the polygon's rectangle."""
        (low_x, high_x), (low_y, high_y) = self._limits
        in_x = (x[1] >= low_x) & (x[0] <= high_x)
        return in_x & (y[1] >= low_y) & (y[0] <= high_y)

    def _meets(self, deep: float, x: Any, y: Any, end_x: Any, end_y: Any) -> Any:
        """Return [...] True where a segment has a point inside, both ends included."""
        hit = self._holds(deep, x, y) | self._holds(deep, end_x, end_y)
        passes, points = partial(self._passes, deep), (x, y, end_x, end_y)
        return hit | polygon_geometry.where_near(passes, ~hit, points, len(self.vertices))

    def _passes(self, deep: float, x: Any, y: Any, end_x: Any, end_y: Any) -> Any:
        """Return [...] True where a segment has a part inside, which need not include an end."""
        xp = x.__array_namespace__()
        dx, dy = end_x - x, end_y - y
        share = polygon_geometry.cuts(self.vertices, self.depth, (x, y), (dx, dy))
        bounds = xp.zeros_like(x)[None], share, xp.ones_like(x)[None]
        share = xp.concatenate(bounds)
        middle = 0.5 * (share[1:] + share[:-1])
        is_piece = share[1:] > share[:-1]
        points = x + middle * dx, y + middle * dy
        holds = partial(self._holds, deep)
        return polygon_geometry.where_near(holds, is_piece, points, len(self.vertices)).any(axis=0)

    def _holds(self, deep: float, x: Any, y: Any) -> Any:
        """Return [...] True where points lie inside, farther than a distance from every edge."""
        inside = polygon_geometry.encloses(self.vertices, x, y)
        is_farther = partial(polygon_geometry.is_farther, self.vertices, deep)
        return polygon_geometry.where_near(is_farther, inside, (x, y), len(self.vertices))
