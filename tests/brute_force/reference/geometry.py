"""Plane geometry of the tests' own: how deep points lie in sets, and whether segments meet sets.

Every set is described by the signed depth of a point: how far the point lies inside, negative
outside. A depth changes no faster than the point moves. So a piece of a segment whose middle lies
farther outside than half the piece is long cannot meet the set; other pieces are halved until that
is known. What lies within NEAR of an edge is refused as ambiguous: it is judged by nobody.

Shapes: N points, S segments, n state dimensions, V vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NEAR = 1e-4  # in the states' units: float32 moves an edge by a hundredth of this at most
TURN = 2.0 * np.pi
PIECES = 8  # of a segment, to begin with


class AmbiguousError(Exception):
    """A point or a segment passes an edge so closely that rounding may decide."""


class Axes(NamedTuple):
    """Names of the states, and which of them are angles."""

    names: tuple[str, ...]
    angles: tuple[str, ...] = ()

    def column(self, name: str) -> int:
        """Return the place of a state."""
        return self.names.index(name)

    def steps(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return ends - starts [..., n], along the shorter arc for angles."""
        steps = ends - starts
        for name in self.angles:
            column = self.column(name)
            steps[..., column] = wrapped(steps[..., column])
            if (np.abs(steps[..., column]) > 0.85 * np.pi).any():
                raise AmbiguousError(f"{name} turns so far in one step that both ways are close")
        return steps


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Return an angle in [-pi, pi)."""
    return (angle + np.pi) % TURN - np.pi


def is_inside(depth: np.ndarray) -> np.ndarray:
    """Return [...] True where a depth is positive.

    Raises:
      AmbiguousError: if a depth is nearer to 0 than NEAR.
    """
    if (np.abs(depth) < NEAR).any():
        raise AmbiguousError("a point lies on an edge")
    return depth > 0.0


def meets(
    depth: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Return [S] True where a segment has a point inside a set.

    Args:
      depth: maps points [N, n] to signed depths [N].
      starts: [S, n] where segments begin.
      steps: [S, n] from the starts to the ends.

    Raises:
      AmbiguousError: if a segment comes to within NEAR of the set and no farther in.
    """
    hit = depth(starts) > NEAR
    hit |= depth(starts + steps) > NEAR
    length = np.linalg.norm(steps, axis=1)
    index = np.repeat(np.flatnonzero(~hit), PIECES)
    left = np.tile(np.arange(PIECES) / PIECES, np.count_nonzero(~hit))
    width, unsure = 1.0 / PIECES, np.zeros(len(hit), bool)
    while len(index):
        middle = starts[index] + (left + 0.5 * width)[:, None] * steps[index]
        value, reach = depth(middle), 0.5 * width * length[index]
        hit[index[value > NEAR]] = True
        is_open = (value + reach > -NEAR) & ~hit[index]
        unsure[index[is_open & (reach < 0.1 * NEAR)]] = True
        is_open &= reach >= 0.1 * NEAR
        index, left, width = index[is_open], left[is_open], 0.5 * width
        index, left = np.concatenate([index, index]), np.concatenate([left, left + width])
    if (unsure & ~hit).any():
        raise AmbiguousError("a segment touches an edge")
    return hit


def polygon_depth(vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the signed depth [N] of points [N, 2] in a polygon [V, 2]."""
    inside, nearest = np.zeros(len(points), bool), np.full(len(points), np.inf)
    x, y = points.T
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        share = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
        share = np.clip(share, 0.0, 1.0)
        off = np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay))
        nearest = np.minimum(nearest, off)
        if ay != by:
            passes = (ay > y) != (by > y)
            inside ^= passes & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return np.where(inside, nearest, -nearest)


def rectangles_gap(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance [N] of points [N, 2] to the nearest of rectangles (x0, x1, y0, y1)."""
    if not len(corners):
        return np.full(len(points), np.inf)
    x, y = points[:, 0, None], points[:, 1, None]
    x0, x1, y0, y1 = corners.T
    gap_x = np.maximum(0.0, np.maximum(x0 - x, x - x1))
    gap_y = np.maximum(0.0, np.maximum(y0 - y, y - y1))
    return np.hypot(gap_x, gap_y).min(axis=1)
