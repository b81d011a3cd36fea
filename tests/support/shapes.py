"""Balls, half-spaces and polygons, and slow ways to judge them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swerve import Ball, HalfSpace, Polygon
from swerve.base.space import TWO_PI, StateSpace

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
SPACE = StateSpace(("theta", "x", "y"), ("theta",), np.array([[0.0, TWO_PI], [-4, 4], [-4, 4]]))
ARROW = [(0.0, 0.0), (3.0, 1.0), (0.0, 2.0), (1.0, 1.0)]  # not convex
SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
ALL = [
    Ball(1.3, x=0.5, y=-0.25),
    Ball(1.7, theta=5.9, x=1.0),
    Ball(0.9, theta=1.0),
    HalfSpace(1.0, x=1.0, y=-2.0),
    Polygon(ARROW),
    Polygon(ARROW, depth=0.2),
    Polygon(SQUARE, names=("y", "x")),
]


def by_winding(vertices: Any, points: np.ndarray) -> np.ndarray:
    """Whether points [..., 2] lie inside, by the angle that the edge turns around them."""
    to = np.asarray(vertices, float) - points[..., None, :]
    angle = np.arctan2(to[..., 1], to[..., 0])
    turns = np.diff(np.concatenate([angle, angle[..., :1]], axis=-1), axis=-1)
    return np.abs((turns - TWO_PI * np.round(turns / TWO_PI)).sum(axis=-1)) > math.pi


def to_edge(vertices: Any, points: np.ndarray) -> np.ndarray:
    """The distance of points [M, 2] to a fine sample of a polygon's edges."""
    corners = np.asarray(vertices, float)
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    edge = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    return np.linalg.norm(points[:, None] - edge, axis=-1).min(axis=1)


def star(seed: int, num: int = 7) -> np.ndarray:
    """A polygon around the origin that does not cross itself and is seldom convex."""
    generator = np.random.default_rng(seed)
    angle = np.arange(num) * TWO_PI / num + generator.uniform(0.0, 4.2 / num, num)
    radius = generator.uniform(0.4, 3.0, num)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
