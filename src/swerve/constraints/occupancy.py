"""Define constraints by a map of blocked cells, such as the walls of a room.

    cell(x, y) = (floor((y - y_0) / w), floor((x - x_0) / w)),   forbidden where blocked[cell],

with (x_0, y_0) the lower left corner of the map and w the side of its cells. Every place beyond the
map is forbidden. A segment is followed from cell to cell. The segment enters a blocked cell as it
would enter a box of the same edges; the rule of edges is that of `constraints.edges`.

Shapes: R rows of the map, upwards, C columns, n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import base64
import functools
import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import numbers, positive_number, two_names
from swerve.base.space import StateSpace, single, wide
from swerve.constraints.base import Constraint
from swerve.constraints.edges import blur, fine, part, threshold
from swerve.constraints.polygon_geometry import where_near

MOST_BYTES = 2**25  # of a stored map, a bit a cell: 16,384 x 16,384 cells


class Occupancy(Constraint):
    """The places that a map shows as blocked, and every place beyond the map.

    Args:
      name: name of the constraint, in tables.
      blocked: [R, C] True where a cell is forbidden; the first row is the lowest.
      corner: (x, y) of the lower left corner of the map, in the states' unit.
      cell: side of a cell, in the states' unit.
      names: the two states that are x and y.

    Raises:
      ValueError: if the map is not a table of booleans, the corner is not a pair of finite numbers,
        or the side of a cell is not positive.
    """

    def __init__(
        self,
        name: str,
        blocked: Any,
        corner: Sequence[float],
        cell: float,
        names: Sequence[str] = ("x", "y"),
    ) -> None:
        self._name = name
        self.blocked = _as_array(blocked)
        self.cell = positive_number(cell, f"Occupancy {name!r}: cell")
        self.names = two_names(names, f"Occupancy {name!r}: names")
        if self.blocked.ndim != 2 or self.blocked.dtype != bool or not self.blocked.size:
            raise ValueError(
                f"Occupancy {name!r}: expected a map [rows, columns] of booleans, got "
                f"{self.blocked.dtype} of shape {self.blocked.shape}"
            )
        if self.blocked.size > 8 * MOST_BYTES:
            raise ValueError(
                f"Occupancy {name!r}: expected at most {8 * MOST_BYTES:,} cells, got "
                f"{self.blocked.size:,}: make the cells larger"
            )
        place = numbers(corner, 2)
        if place is None or not all(map(math.isfinite, place)):
            raise ValueError(f"Occupancy {name!r}: expected a corner (x, y), got {corner!r}")
        self.corner = tuple(place)

    def __repr__(self) -> str:
        """Return for example "Occupancy('walls', <20 x 30 cells>, (0.0, 0.0), 0.1, ('x', 'y'))"."""
        rows, columns = self.blocked.shape
        return (
            f"Occupancy({self._name!r}, <{rows} x {columns} cells>, {self.corner}, {self.cell}, "
            f"{self.names})"
        )

    @property
    def name(self) -> str:
        """The name that the map was given."""
        return self._name

    def widened(self, distance: float) -> Occupancy:
        """Return the map with all cells blocked that are nearer than a distance to a blocked cell.

        The middle of a round body whose radius is this distance cannot come into these cells. Every
        place beyond the map counts as blocked.

        Raises:
          ValueError: if the distance is not a finite number above 0.
        """
        from scipy.ndimage import distance_transform_edt

        distance = positive_number(distance, f"Occupancy {self._name!r}: distance to widen by")
        free = np.pad(~self.blocked, 1)
        nearest = np.asarray(distance_transform_edt(free))[1:-1, 1:-1] * self.cell
        return Occupancy(self.name, nearest < distance, self.corner, self.cell, self.names)

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where one of its names is not a state, or is an angle."""
        for name in self.names:
            space.column(name)
            if name in space.angles:
                raise ValueError(f"Occupancy {self._name!r}: {name!r} is an angle, no position")

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in a blocked cell or beyond the map."""
        return self._is_blocked([axis.index(axis.values(states)) for axis in self._axes(space)])

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment enters a blocked cell, or leaves the map.

        The segment is followed from its start over each line that it crosses.
        """
        axes = self._axes(space)
        places = [[axis.values(states) for axis in axes] for states in (starts, ends)]
        first, last = ([axis.index(x) for axis, x in zip(axes, p, strict=True)] for p in places)
        hit = self._is_blocked(first) | self._is_blocked(last)
        has_between = abs(last[0] - first[0]) + abs(last[1] - first[1]) >= 2
        passes = functools.partial(self._passes, axes)
        return hit | where_near(passes, has_between & ~hit, (*places[0], *places[1]), 1)

    def _passes(self, axes: Sequence[MapAxis], x: Any, y: Any, end_x: Any, end_y: Any) -> Any:
        """Return [...] True where a segment enters a blocked cell between its ends."""
        xp = x.__array_namespace__()
        values, steps = (x, y), (end_x - x, end_y - y)
        index = [axis.index(value) for axis, value in zip(axes, values, strict=True)]
        last = [
            xp.where(axis.is_still(step), first, axis.index(end))
            for axis, step, first, end in zip(axes, steps, index, (end_x, end_y), strict=True)
        ]

        def follow(_: Any, carry: Any) -> Any:
            """Cross the next line of every segment, and judge the cell behind the line."""
            hit, index = carry
            to_x, to_y = (
                axis.share_to_line(*along)
                for axis, *along in zip(axes, values, steps, index, last, strict=True)
            )
            index = [
                k + xp.where(is_next, xp.sign(end - k), 0)
                for k, is_next, end in zip(index, (to_x <= to_y, to_x > to_y), last, strict=True)
            ]
            column, row = index
            seams = self._is_blocked([column - 1, row]), self._is_blocked([column, row - 1])
            (enter_x, leave_x), (enter_y, leave_y) = (
                axis.part(*along)
                for axis, *along in zip(axes, values, steps, index, seams, strict=True)
            )
            enter = xp.maximum(xp.maximum(enter_x, enter_y), 0.0)
            leave = xp.minimum(xp.minimum(leave_x, leave_y), 1.0)
            return hit | (self._is_blocked(index) & (leave > enter)), index

        lines = xp.abs(last[0] - index[0]) + xp.abs(last[1] - index[1])
        return _repeat(follow, (xp.zeros(x.shape, bool), index), lines.max(initial=0))

    def _axes(self, space: StateSpace) -> list[MapAxis]:
        """Return the axes of x and y."""
        rows, columns = self.blocked.shape
        columns_of = [space.column(name) for name in self.names]
        return [
            map_axis(column, space.resolution[column], low, self.cell, count)
            for column, low, count in zip(columns_of, self.corner, (columns, rows), strict=True)
        ]

    def _is_blocked(self, index: Sequence[Any]) -> Any:
        """Return [...] True where the cell of column and row [...] is blocked or off the map."""
        column, row = index
        return column.__array_namespace__().asarray(self._framed)[row + 2, column + 2]

    @functools.cached_property
    def _framed(self) -> np.ndarray:
        """[R + 4, C + 4] the map in a frame of blocked cells, which stand for what is beyond."""
        return np.pad(self.blocked, 2, constant_values=True)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data; the map is packed to bits and compressed."""
        return {
            "kind": "occupancy",
            "name": self._name,
            "shape": list(self.blocked.shape),
            "blocked": self._packed,
            "corner": list(self.corner),
            "cell": self.cell,
            "names": list(self.names),
        }

    @functools.cached_property
    def _packed(self) -> str:
        return base64.b64encode(zlib.compress(np.packbits(self.blocked).tobytes())).decode()

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Occupancy:
        """Rebuild a map from `to_json` data."""
        rows, columns = data["shape"]
        name, size = data["name"], -(-rows * columns // 8)  # bytes
        if size > MOST_BYTES:
            raise ValueError(f"Occupancy {name!r}: a map of {rows} x {columns} cells is too large")
        packed = zlib.decompressobj().decompress(base64.b64decode(data["blocked"]), size + 1)
        if len(packed) != size:
            raise ValueError(f"Occupancy {name!r}: not a map of {rows} x {columns} cells")
        bits = np.unpackbits(np.frombuffer(packed, np.uint8), count=rows * columns)
        blocked = bits.astype(bool).reshape(rows, columns)
        return cls(data["name"], blocked, data["corner"], data["cell"], data["names"])


@functools.lru_cache(64)
def map_axis(column: int, resolution: float, low: float, cell: float, count: int) -> MapAxis:
    """Return an axis of a map; those of constraints are judged again and again."""
    return MapAxis(column, resolution, low, cell, count)


class MapAxis:
    """One axis of a map: lines between cells, and the index of cells, -1 and C beyond the map."""

    def __init__(self, column: int, resolution: float, low: float, cell: float, count: int) -> None:
        self.column, self.count, self.cell = column, count, cell
        resolution = fine(resolution, cell)
        self.low = low - resolution
        lines = np.concatenate([[-np.inf], low + cell * np.arange(count + 1), [np.inf]])
        self.lines = threshold(lines, resolution)
        self.blur = float(blur(lines, resolution).max())

    def values(self, states: Any) -> Any:
        """Return one component [...] of states [..., n] as it is compared with lines."""
        return wide(single(states[..., self.column]))

    def index(self, values: Any) -> Any:
        """Return the index [...] of the cell of each number; comparisons with lines decide."""
        xp = values.__array_namespace__()
        guess = xp.clip(xp.floor((values - self.low) / self.cell), -1, self.count)
        guess = xp.nan_to_num(guess, nan=-1.0).astype(xp.int32)  # NaN is beyond the map
        lines = xp.asarray(self.lines)
        return guess - (values < lines[guess + 1]) + (values >= lines[guess + 2])

    def is_still(self, steps: Any) -> Any:
        """Return [...] True where a segment stays where it begins, along this axis."""
        return abs(steps) <= 2.0 * self.blur

    def share_to_line(self, values: Any, steps: Any, index: Any, last: Any) -> Any:
        """Return the share [...] of segments up to the next line; inf where no line is left.

        Args:
          values: [...] where the segments begin.
          steps: [...] from the starts to the ends.
          index: [...] the cell reached.
          last: [...] the cell of the end.
        """
        xp = steps.__array_namespace__()
        line = wide(xp.asarray(self.lines)[index + 1 + (last > index)])
        divisor = xp.where(last == index, 1.0, steps)
        return xp.where(last == index, math.inf, (line - values) / divisor)

    def part(self, values: Any, steps: Any, index: Any, is_seam: Any) -> tuple[Any, Any]:
        """Return the part (enter, leave) of segments that lies deep in cells, see `edges.part`.

        Args:
          values: [...] where the segments begin.
          steps: [...] from the starts to the ends.
          index: [...] the cells.
          is_seam: [...] whether the cell before is blocked as well: the line between the two is no
            edge, and a segment along the line is deep in one of the two.
        """
        xp = steps.__array_namespace__()
        low, high = (wide(xp.asarray(self.lines)[index + k]) for k in (1, 2))
        return part(values, steps, low - xp.where(is_seam, 2.0 * self.blur, 0.0), high, self.blur)


def _repeat(step: Callable[[Any, Any], Any], carry: Any, times: Any) -> Any:
    """Apply a step to (hit, index) as many times as given; return hit."""
    if isinstance(times, np.generic):
        for k in range(int(times)):
            carry = step(k, carry)
        return carry[0]
    import jax  # loaded already: the caller passed JAX arrays

    return jax.lax.fori_loop(0, times, step, carry)[0]


def _as_array(blocked: Any) -> np.ndarray:
    """Return a copy as an array; of objects, refused later, where rows differ in length."""
    try:
        return np.array(blocked)
    except ValueError:
        return np.array(list(blocked), dtype=object)
