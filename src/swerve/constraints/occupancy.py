"""Define constraints by a map of blocked cells, such as the walls of a room.

    cell(x, y) = (floor((y - y_0) / w), floor((x - x_0) / w)),   forbidden where blocked[cell],

with (x_0, y_0) the lower left corner of the map and w the side of its cells. Every place beyond the
map is forbidden. A segment is tried at points at most half a cell apart, so that only a segment
across the tip of a corner can be missed.

Shapes: R rows of the map, upwards, C columns, n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from swerve.base.arguments import numbers, positive_number, two_names
from swerve.base.space import StateSpace
from swerve.constraints.base import Constraint

SPACING = 0.5  # cells, between two tried points of a segment: only the tip of a corner is missed


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
        xp = states.__array_namespace__()
        x, y = (
            xp.floor((states[..., space.column(name)] - low) / self.cell)
            for name, low in zip(self.names, self.corner, strict=True)
        )
        rows, columns = self.blocked.shape
        beyond = ~((x >= 0) & (x < columns) & (y >= 0) & (y < rows))  # True for NaN as well
        column = xp.where(beyond, 0, x).astype(xp.int32)
        row = xp.where(beyond, 0, y).astype(xp.int32)
        return beyond | xp.asarray(self.blocked)[row, column]

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where a tried point of the segment lies in the set, see SPACING."""
        xp = starts.__array_namespace__()
        steps = space.difference(starts, ends)
        longest = xp.abs(steps[..., [space.column(name) for name in self.names]]).max(initial=0.0)
        count = xp.ceil(xp.nan_to_num(longest) / (SPACING * self.cell)).astype(int)
        hit = self.contains(starts, space) | self.contains(ends, space)

        def tried(k: Any, hit: Any) -> Any:
            return hit | self.contains(starts + steps * (k / count), space)

        if isinstance(starts, np.ndarray):
            for k in range(1, int(count)):
                hit = tried(k, hit)
            return hit
        import jax  # loaded already: the caller passed JAX arrays

        return jax.lax.fori_loop(1, count, tried, hit)

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

    @cached_property
    def _packed(self) -> str:
        return base64.b64encode(zlib.compress(np.packbits(self.blocked).tobytes())).decode()

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Occupancy:
        """Rebuild a map from `to_json` data."""
        bits = np.frombuffer(zlib.decompress(base64.b64decode(data["blocked"])), np.uint8)
        rows, columns = data["shape"]
        blocked = np.unpackbits(bits, count=rows * columns).astype(bool).reshape(rows, columns)
        return cls(data["name"], blocked, data["corner"], data["cell"], data["names"])


def _as_array(blocked: Any) -> np.ndarray:
    """Return a copy as an array; of objects, refused later, where rows differ in length."""
    try:
        return np.array(blocked)
    except ValueError:
        return np.array(list(blocked), dtype=object)
