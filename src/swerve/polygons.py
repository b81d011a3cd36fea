"""Polygons: what they enclose, how far their edges are, and where a line can cross them.

A point is enclosed where a ray from it to the right crosses an odd number of edges; an edge from
(x1, y1) to (x2, y2) is crossed at height y where

    (y1 > y) != (y2 > y)    and    x < x1 + (x2 - x1) (y - y1) / (y2 - y1).

What is called with points works alike on NumPy and JAX arrays.

Shapes: V vertices, C cells of a search, ... any batch dimensions.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

FLAT = 1e-12  # of the square of the extent: less area than this is none
PRECISION = 0.01  # to which the deepest point is looked for


def checked_vertices(vertices: Any) -> np.ndarray:
    """Return vertices [V, 2] after checking that they make a polygon.

    Raises:
      ValueError: if there are fewer than 3 vertices, one is repeated or not finite, they lie on a
        line, or the polygon crosses itself.
    """
    corners = np.array(vertices, float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ValueError(
            "Polygon: expected at least 3 vertices, each a pair of numbers, got an array of shape "
            f"{corners.shape}"
        )
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise ValueError(f"Polygon: vertex {bad} is not finite: {corners[bad].tolist()}")
    for i, j in itertools.combinations(range(len(corners)), 2):
        if (corners[i] == corners[j]).all():
            raise ValueError(
                f"Polygon: vertices {i} and {j} are the same, {corners[i].tolist()}: name each "
                "once; the last edge leads back to the first vertex"
            )
    extent = float(np.ptp(corners, axis=0).max())
    turns = [_turn(corners[0], corners[1], corner) for corner in corners[2:]]
    if np.abs(turns).max() <= FLAT * extent**2:
        raise ValueError("Polygon: expected an area, but all vertices lie on one line")
    _check_simple(corners)
    return corners


def encloses(vertices: np.ndarray, x: Any, y: Any) -> Any:
    """Return [...] True where points lie inside a polygon, by the number of crossings."""
    inside = x.__array_namespace__().zeros_like(x, dtype=bool)
    for (x1, y1), (x2, y2) in _edges(vertices):
        if y1 != y2:
            at = x1 + (x2 - x1) / (y2 - y1) * (y - y1)
            inside = inside ^ (((y1 > y) != (y2 > y)) & (x < at))
    return inside


def square_to_edge(vertices: np.ndarray, x: Any, y: Any) -> Any:
    """Return the square of the distance [...] of points to the nearest edge."""
    xp = x.__array_namespace__()
    least = None
    for (x1, y1), (x2, y2) in _edges(vertices):
        dx, dy = x2 - x1, y2 - y1
        share = xp.clip(((x - x1) * dx + (y - y1) * dy) / (dx**2 + dy**2), 0.0, 1.0)
        square = (x - x1 - share * dx) ** 2 + (y - y1 - share * dy) ** 2
        least = square if least is None else xp.minimum(least, square)
    return least


def cuts(vertices: np.ndarray, depth: float, start: Any, step: Any) -> list[Any]:
    """Return where lines start + u * step may cross what is deeper in a polygon than a depth.

    Its edge lies on lines beside the polygon's edges, and on circles around its vertices.

    Args:
      vertices: [V, 2].
      depth: 0 for the polygon itself.
      start: x and y, each [...].
      step: likewise.

    Returns:
      Values [...] of u; 0 where a line cuts nothing.
    """
    (x, y), (dx, dy) = start, step
    xp = x.__array_namespace__()
    found = []
    for (x1, y1), (x2, y2) in _edges(vertices):
        length = math.hypot(x2 - x1, y2 - y1)
        nx, ny = (y1 - y2) / length, (x2 - x1) / length
        slope, height = nx * dx + ny * dy, nx * (x - x1) + ny * (y - y1)
        level = slope == 0
        divisor = xp.where(level, 1.0, slope)
        sides = (depth, -depth) if depth else (0.0,)
        found += [xp.where(level, 0.0, (side - height) / divisor) for side in sides]
        if depth:
            found += _circle_cuts((x - x1, y - y1), (dx, dy), depth)
    return found


def deepest(vertices: np.ndarray) -> float:
    """Return how far a point inside can be from every edge, at most 1 % too little.

    Squares that cover the polygon are split in four, as long as one may hold a point that is deeper
    than the deepest so far: no point is deeper than the middle and half the diagonal.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    half = float((high - low).min()) / 2
    count = np.ceil((high - low) / (2 * half)).astype(int)
    axes = [low[k] + half * (2 * np.arange(count[k]) + 1) for k in range(2)]
    middles = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    corners, best = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]), 0.0
    while len(middles):
        x, y = middles.T
        depth = np.sqrt(square_to_edge(vertices, x, y))
        depth = np.where(encloses(vertices, x, y), depth, -depth)
        best = max(best, float(depth.max()))
        middles = middles[depth + math.sqrt(2.0) * half > best * (1.0 + PRECISION)]
        half /= 2
        middles = (middles[:, None] + half * corners).reshape(-1, 2)
    return best


def clipped(vertices: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return what is left of a polygon [V, 2] within limits [2, 2], (low, high) of x and of y.

    One side after the other is cut off (Sutherland and Hodgman); what falls into several parts
    stays one, joined along the side.
    """
    for axis, (low, high) in enumerate(limits.tolist()):
        for sign, limit in ((1.0, low), (-1.0, -high)):
            normal = np.zeros(2)
            normal[axis] = sign
            vertices = cut_off(vertices, normal, limit)
    return vertices


def cut_off(vertices: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Return what of a polygon [V, 2] has normal . point >= offset, no vertex if nothing has."""
    height = vertices @ normal - offset
    kept = []
    for k in range(len(vertices)):
        a, b = height[k - 1], height[k]
        if (a >= 0) != (b >= 0):
            kept.append(vertices[k - 1] + a / (a - b) * (vertices[k] - vertices[k - 1]))
        if b >= 0:
            kept.append(vertices[k])
    return np.array(kept).reshape(-1, 2)


def _circle_cuts(start: Any, step: Any, radius: float) -> list[Any]:
    """Return the two u [...] where start + u * step is at a distance from the origin, else 0."""
    (x, y), (dx, dy) = start, step
    xp = x.__array_namespace__()
    square, dot = dx**2 + dy**2, x * dx + y * dy
    inner = dot**2 - square * (x**2 + y**2 - radius**2)
    meets = (inner > 0) & (square > 0)
    root, divisor = xp.sqrt(xp.where(meets, inner, 0.0)), xp.where(meets, square, 1.0)
    return [xp.where(meets, (-dot + sign * root) / divisor, 0.0) for sign in (1.0, -1.0)]


def _check_simple(corners: np.ndarray) -> None:
    """Raise ValueError where two edges meet elsewhere than in the vertex that they share."""
    num = len(corners)
    for i, j in itertools.combinations(range(num), 2):
        a, b, c, d = corners[i], corners[i + 1], corners[j], corners[(j + 1) % num]
        if j == i + 1:
            meet = _folds_back(b, a, d)
        elif (j + 1) % num == i:
            meet = _folds_back(a, b, c)
        else:
            meet = _meet(a, b, c, d)
        if meet:
            raise ValueError(
                f"Polygon: edge {i}, from {a.tolist()} to {b.tolist()}, meets edge {j}, from "
                f"{c.tolist()} to {d.tolist()}: give the vertices in order, so that it does not "
                "cross itself"
            )


def _folds_back(shared: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two edges leave the vertex that they share in the same direction."""
    return _turn(shared, one, other) == 0 and float((one - shared) @ (other - shared)) > 0


def _meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Return whether the segments from a to b and from c to d have a point in common."""
    sides = [_turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)]
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(
        side == 0 and bool((np.minimum(p, q) <= r).all() and (r <= np.maximum(p, q)).all())
        for side, (p, q, r) in zip(sides, ends, strict=True)
    )


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return twice the area of the triangle a, b, c, above 0 where it turns left."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _edges(vertices: np.ndarray) -> list[tuple[list[float], list[float]]]:
    corners = vertices.tolist()
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))
