"""Compute the geometry of polygons: points inside, distances to edges, lines that cut edges.

A polygon encloses a point (x, y) where a ray from the point to the right crosses an odd number of
edges. The ray crosses the edge from (x1, y1) to (x2, y2) where

    (y1 > y) != (y2 > y)    and    x < x1 + (x2 - x1) (y - y1) / (y2 - y1).

Functions of points work alike on NumPy and JAX arrays. They try all edges at once; with NumPy they
try only points that may lie inside, see `where_near`.

Shapes: V vertices and as many edges, C lines and circles, M points, ... any batch dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import numbers

FLAT = 1e-12  # share of the squared extent: smaller areas can be rounding errors, and count as 0
PRECISION = 0.01  # relative error of the depth of the deepest point
BEYOND = 0.01  # share of an edge's length: cuts so near beyond an end count, against rounding
AT_ONCE = 1 << 15  # pairs of a point and an edge judged at once: intermediate results fit the cache


def checked_vertices(vertices: Any) -> np.ndarray:
    """Return vertices [V, 2] after checking that they make a polygon.

    Raises:
      ValueError: if there are fewer than 3 vertices, a vertex is repeated or not finite, all
        vertices lie on a line, or the polygon crosses itself.
    """
    corners = _as_array(vertices)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ValueError(
            "Polygon: expected at least 3 vertices, each a pair of numbers, got an array of shape "
            f"{corners.shape}"
        )
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise ValueError(f"Polygon: vertex {bad} is not finite: {corners[bad].tolist()}")
    for i, corner in enumerate(corners):
        same = np.flatnonzero((corners[i + 1 :] == corner).all(axis=1))
        if same.size:
            raise ValueError(
                f"Polygon: vertices {i} and {i + 1 + same[0]} are the same, {corner.tolist()}: "
                "name each once; the last edge leads back to the first vertex"
            )
    extent = float(np.ptp(corners, axis=0).max())
    if np.abs(_turn(corners[0], corners[1], corners[2:])).max() <= FLAT * extent**2:
        raise ValueError("Polygon: expected an area, but all vertices lie on one line")
    _check_simple(corners)
    return corners


def _as_array(vertices: Any) -> np.ndarray:
    """Return vertices as an array; raise ValueError naming the first vertex that is not a pair."""
    try:
        corners = np.asarray(vertices)
        if corners.dtype.kind in "iuf":
            return corners.astype(float)
    except ValueError:
        pass  # rows of different lengths
    listed = list(vertices) if isinstance(vertices, Sequence) else []
    bad = [
        k for k, vertex in enumerate(listed) if not np.isfinite(numbers(vertex, 2) or np.nan).all()
    ]
    got = f"vertex {bad[0]} is {listed[bad[0]]!r}" if bad else f"got {vertices!r}"
    raise ValueError(
        f"Polygon: expected at least 3 vertices, each a pair of numbers, but {got}: give them as "
        "in [(0.0, 0.0), (2.0, 0.0), (1.0, 1.0)]"
    )


def where_near(judge: Callable[..., Any], near: Any, values: Sequence[Any], num_edges: int) -> Any:
    """Return [...] True where a point is near and judged True.

    With NumPy only the points that are near are judged. JAX judges all, since its shapes are fixed.

    Args:
      judge: maps values [M] to booleans [M]; the work grows with M and with the edges.
      near: [...] False where the answer is False without judging.
      values: each [...], the arguments of `judge`.
      num_edges: V.
    """
    if not isinstance(near, np.ndarray | np.bool_):
        return near & judge(*values)
    found, rows = np.zeros(near.size, bool), np.flatnonzero(near)
    if rows.size:
        picked = [np.reshape(value, -1)[rows] for value in values]
        found[rows] = blockwise(judge, picked, num_edges)
    return found.reshape(near.shape)


def blockwise(function: Callable[..., Any], values: Sequence[Any], num_edges: int) -> np.ndarray:
    """Compute a function of values, each [M], block by block to save memory."""
    size = max(1, AT_ONCE // num_edges)
    blocks = range(0, max(1, len(values[0])), size)
    return np.concatenate([function(*(v[k : k + size] for v in values)) for k in blocks])


def encloses(vertices: np.ndarray, x: Any, y: Any) -> Any:
    """Return [...] True where points lie inside a polygon, by the number of crossings."""
    (x1, y1), (x2, y2) = _edges(vertices, np.ndim(x))
    slope = (x2 - x1) / np.where(y1 == y2, 1.0, y2 - y1)
    crossed = ((y1 > y) != (y2 > y)) & (x < x1 + slope * (y - y1))
    return x.__array_namespace__().logical_xor.reduce(crossed, axis=0)


def square_to_edge(vertices: np.ndarray, x: Any, y: Any) -> Any:
    """Return the square of the distance [...] of points to the nearest edge."""
    return _squares_to_edges(vertices, x, y).min(axis=0)


def is_farther(vertices: np.ndarray, distance: float, x: Any, y: Any) -> Any:
    """Return [...] True where points are farther than a distance from every edge."""
    return (_squares_to_edges(vertices, x, y) > distance**2).all(axis=0)


def cuts(vertices: np.ndarray, depth: float, start: Any, step: Any) -> Any:
    """Return where segments start + u * step may cross the edge of the set deeper than a depth.

    That set is the points inside that lie farther than the depth from every edge of the polygon.
    Its edge lies on lines beside the polygon's edges, and on circles around the vertices.

    Args:
      vertices: [V, 2].
      depth: distance between the two edges; 0 for the polygon itself.
      start: x and y, each [...].
      step: dx and dy, each [...].

    Returns:
      [C, ...] values of u in ascending order, which hold all crossings with 0 < u < 1; 0 where a
      line or circle is not cut. With NumPy, C is the largest number of cuts of a segment.
    """
    (x, y), (dx, dy) = start, step
    xp = x.__array_namespace__()
    (x1, y1), (x2, y2) = _edges(vertices, np.ndim(x))
    length = np.hypot(x2 - x1, y2 - y1)
    nx, ny = (y1 - y2) / length, (x2 - x1) / length
    slope, height = nx * dx + ny * dy, nx * (x - x1) + ny * (y - y1)
    divisor = xp.where(slope == 0, 1.0, slope)
    found = []
    for side in (depth, -depth) if depth else (0.0,):
        share = (side - height) / divisor
        along = (ny * (x + share * dx - x1) - nx * (y + share * dy - y1)) / length
        beside = (slope != 0) & (along > -BEYOND) & (along < 1.0 + BEYOND)
        found.append(xp.where(beside, share, 0.0))
    if depth:
        found += _circle_cuts((x - x1, y - y1), (dx, dy), depth)
    share = xp.concatenate(found)
    share = xp.sort(xp.where((share > 0.0) & (share < 1.0), share, 0.0), axis=0)
    if isinstance(share, np.ndarray):
        return share[share.reshape(len(share), -1).any(axis=1)]
    return share


def deepest(vertices: np.ndarray) -> float:
    """Return the depth of the deepest point inside, at most 1 % too small.

    The depth of a point is its distance to the nearest edge. Squares cover the polygon. A square is
    split in four while it may hold a point deeper than the deepest point found so far: no point of
    a square is deeper than the depth of the square's middle plus half a diagonal.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    half = float((high - low).min()) / 2
    count = np.ceil((high - low) / (2 * half)).astype(int)
    axes = [low[k] + half * (2 * np.arange(count[k]) + 1) for k in range(2)]
    middles = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    corners, best = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]), 0.0

    def depths(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the depth of points [M], below 0 outside."""
        to_edge = np.sqrt(square_to_edge(vertices, x, y))
        return np.where(encloses(vertices, x, y), to_edge, -to_edge)

    while len(middles):
        depth = blockwise(depths, list(middles.T), len(vertices))
        best = max(best, float(depth.max()))
        middles = middles[depth + math.sqrt(2.0) * half > best * (1.0 + PRECISION)]
        half /= 2
        middles = (middles[:, None] + half * corners).reshape(-1, 2)
    return best


def clipped(vertices: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the part of a polygon [V, 2] within limits [2, 2], (low, high) of x and of y.

    The parts beyond the limits are cut off, one limit after the other (Sutherland and Hodgman).
    Several separate parts are returned as one polygon, joined along the limit.
    """
    for axis, (low, high) in enumerate(limits.tolist()):
        for sign, limit in ((1.0, low), (-1.0, -high)):
            normal = np.zeros(2)
            normal[axis] = sign
            vertices = cut_off(vertices, normal, limit)
    return vertices


def triangles(vertices: np.ndarray) -> np.ndarray:
    """Return triangles [.., 3, 2] that make up a polygon [V, 2], with corners anticlockwise.

    Ears are cut off one after another. An ear is a corner that turns left and whose triangle holds
    no other vertex.
    """
    doubled = np.sum(_turn(vertices[0], vertices, np.roll(vertices, -1, axis=0)))
    left = list(vertices if doubled > 0 else vertices[::-1])
    found = []
    while len(left) > 3:
        ear = min(range(len(left)), key=lambda k: _is_blocked(left, k))
        found.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    cut = np.array([*found, left])
    return cut[_turn(*np.moveaxis(cut, 1, 0)) > 0]  # a vertex on an edge makes flat triangles


def _is_blocked(corners: list[np.ndarray], k: int) -> bool:
    """Return whether corner k of an anticlockwise polygon is not an ear, see `triangles`."""
    a, b, c = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
    ends = {(k - 1) % len(corners), k, (k + 1) % len(corners)}
    others = np.array([corner for j, corner in enumerate(corners) if j not in ends])
    within = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    return bool(_turn(a, b, c) < 0) or bool(within.any())


def cut_off(vertices: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Return the part of a polygon [V, 2] with normal . point >= offset; [0, 2] if none has."""
    height = vertices @ normal - offset
    kept = []
    for k in range(len(vertices)):
        a, b = height[k - 1], height[k]
        if (a >= 0) != (b >= 0):
            kept.append(vertices[k - 1] + a / (a - b) * (vertices[k] - vertices[k - 1]))
        if b >= 0:
            kept.append(vertices[k])
    return np.array(kept).reshape(-1, 2)


def _squares_to_edges(vertices: np.ndarray, x: Any, y: Any) -> Any:
    """Return the square of the distance [V, ...] of points [...] to each edge."""
    xp = x.__array_namespace__()
    (x1, y1), (x2, y2) = _edges(vertices, np.ndim(x))
    dx, dy = x2 - x1, y2 - y1
    share = xp.clip(((x - x1) * dx + (y - y1) * dy) / (dx**2 + dy**2), 0.0, 1.0)
    return (x - x1 - share * dx) ** 2 + (y - y1 - share * dy) ** 2


def _circle_cuts(start: Any, step: Any, radius: float) -> list[Any]:
    """Return the two u [...] where start + u * step meets a circle around 0; 0 if it never does."""
    (x, y), (dx, dy) = start, step
    xp = x.__array_namespace__()
    square, dot = dx**2 + dy**2, x * dx + y * dy
    inner = dot**2 - square * (x**2 + y**2 - radius**2)
    meets = (inner > 0) & (square > 0)
    root, divisor = xp.sqrt(xp.where(meets, inner, 0.0)), xp.where(meets, square, 1.0)
    return [xp.where(meets, (-dot + sign * root) / divisor, 0.0) for sign in (1.0, -1.0)]


def _check_simple(corners: np.ndarray) -> None:
    """Raise ValueError where two edges meet at a point other than a shared vertex."""
    others = np.roll(corners, -1, axis=0)
    for i in range(len(corners) - 1):
        a, b, c, d = corners[i], others[i], corners[i + 1 :], others[i + 1 :]
        meet = _meet(a, b, c, d)
        meet[0] = _folds_back(b, a, d[0])
        if i == 0:
            meet[-1] = _folds_back(a, b, c[-1])
        if meet.any():
            k = int(meet.argmax())
            raise ValueError(
                f"Polygon: edge {i}, from {a.tolist()} to {b.tolist()}, meets edge {i + 1 + k}, "
                f"from {c[k].tolist()} to {d[k].tolist()}: give the vertices in order, so that "
                "the polygon does not cross itself"
            )


def _folds_back(shared: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two edges leave the vertex that both share in the same direction."""
    return bool(_turn(shared, one, other) == 0) and float((one - shared) @ (other - shared)) > 0


def _meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return [M] True where the segment from a to b [2] meets a segment from c to d [M, 2]."""
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    sides = [_turn(p, q, r) for p, q, r in ends]
    meet = (sides[0] * sides[1] < 0) & (sides[2] * sides[3] < 0)
    for side, (p, q, r) in zip(sides, ends, strict=True):
        within = (np.minimum(p, q) <= r) & (r <= np.maximum(p, q))
        meet |= (side == 0) & within.all(axis=-1)
    return meet


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return [...] twice the area of triangles a, b, c [..., 2]; above 0 if anticlockwise."""
    (ux, uy), (vx, vy) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
    return ux * vy - uy * vx


def _edges(vertices: np.ndarray, num_dims: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where edges begin and end, each [2, V, 1, ...] to broadcast with points [...]."""
    begin = vertices.T.reshape(2, -1, *[1] * num_dims)
    return begin, np.roll(begin, -1, axis=1)
