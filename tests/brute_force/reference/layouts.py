"""Random hypotheses of every kind, placed where trajectories pass.

Shapes: P places, n state dimensions, A actions, m components of one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from brute_force.reference.geometry import TURN
from brute_force.reference.regions import (
    ActionRegion,
    BallRegion,
    BoxRegion,
    HalfSpaceRegion,
    MapRegion,
    PolygonRegion,
    PredicateRegion,
    Region,
    StateActionRegion,
    UnionRegion,
)
from brute_force.reference.worlds import SmoothWorld, TableWorld

MOST_CELLS = 12  # of a grid
Axis = tuple[float, float, float]


@dataclass(frozen=True)
class Layout:
    """Hypotheses, as the library is told of them and one by one.

    Attributes:
      kind: "list", "grid" or "windows".
      regions: the hypotheses, one by one.
      axes: low, high and the number of cells or the width of a window, by state.
      overlap: strides in the width of a window.
    """

    kind: str
    regions: tuple[Region, ...]
    axes: Mapping[str, Axis]
    overlap: int = 1


@dataclass(frozen=True)
class Stripe:
    """A stripe across the states, as a function of NumPy and JAX arrays: positive inside."""

    factors: tuple[float, ...]
    angles: tuple[bool, ...]
    middle: float
    half: float

    def __call__(self, states: Any) -> Any:
        xp = states.__array_namespace__()
        total = -self.middle
        for k, (factor, is_angle) in enumerate(zip(self.factors, self.angles, strict=True)):
            x = states[..., k]
            total = total + factor * (xp.cos(x) if is_angle else x)
        return self.half - xp.abs(total)


Place = Callable[[], np.ndarray]
"""Returns a state [n] near which trajectories pass."""


@dataclass(frozen=True)
class Maker:
    """Makes random regions of a world.

    Attributes:
      place: returns a state [n] near which trajectories pass.
    """

    generator: np.random.Generator
    world: SmoothWorld | TableWorld
    place: Place

    @property
    def straight(self) -> list[str]:
        """The states that are no angles."""
        axes = self.world.axes
        return [name for name in axes.names if name not in axes.angles]

    def some(self, names: list[str] | tuple[str, ...], num: int | None = None) -> list[str]:
        """Return some of the names, in any order."""
        num = int(self.generator.integers(1, len(names) + 1)) if num is None else num
        return [names[k] for k in self.generator.permutation(len(names))[:num]]

    def at(self, place: np.ndarray, name: str) -> float:
        """Return one coordinate of a place."""
        return float(place[self.world.axes.column(name)])

    def region(self) -> Region:
        """Return a region of a random kind."""
        kinds = ["box", "box", "ball", "predicate", "union", "action", "state_action"]
        if self.straight:
            kinds.append("half_space")
        if len(self.straight) > 1:
            kinds += ["polygon", "map"]
        return self.of_kind(str(self.generator.choice(kinds)))

    def of_kind(self, kind: str) -> Region:
        """Return a random region of a kind."""
        return getattr(self, f"_{kind}")()

    def _box(self) -> Region:
        place, sides = self.place(), {}
        for name in self.some(self.world.axes.names):
            below, above = self.generator.uniform(0.1, 0.7, 2)
            low, high = self.at(place, name) - below, self.at(place, name) + above
            if name not in self.world.axes.angles and self.generator.random() < 0.2:
                low, high = ((-np.inf, high), (low, np.inf))[int(self.generator.integers(2))]
            elif name in self.world.axes.angles:
                turns = TURN * int(self.generator.integers(-1, 2))
                low, high = low + turns, high + turns
            sides[name] = (float(low), float(high))
        return BoxRegion(sides)

    def _ball(self) -> Region:
        place, names = self.place(), self.some(self.world.axes.names)
        centre = {name: self.at(place, name) for name in names}
        return BallRegion(float(self.generator.uniform(0.2, 0.8)), centre)

    def _half_space(self) -> Region:
        place, names = self.place(), self.some(self.straight)
        factors = self.generator.uniform(0.3, 2.0, len(names))
        factors *= self.generator.choice([-1.0, 1.0], len(names))
        normal = {name: float(f) for name, f in zip(names, factors, strict=True)}
        shift = self.generator.uniform(-0.3, 0.3)
        offset = sum(f * (self.at(place, name) + shift) for name, f in normal.items())
        return HalfSpaceRegion(float(offset), normal)

    def _polygon(self) -> Region:
        place, (first, second) = self.place(), self.some(self.straight, 2)
        num = int(self.generator.integers(3, 7))
        turn = np.sort(self.generator.uniform(0.0, 0.7, num) + np.arange(num)) * TURN / num
        radius = self.generator.uniform(0.3, 0.9, num)
        x = self.at(place, first) + radius * np.cos(turn)
        y = self.at(place, second) + radius * np.sin(turn)
        if self.generator.random() < 0.5:
            x, y = x[::-1], y[::-1]
        return PolygonRegion(tuple(zip(x.tolist(), y.tolist(), strict=True)), (first, second))

    def _map(self) -> Region:
        (first, second), places = self.some(self.straight, 2), [self.place() for _ in range(12)]
        cell = float(self.generator.uniform(0.3, 0.7))
        flat = np.array([[self.at(p, first), self.at(p, second)] for p in places])
        low, high = flat.min(axis=0) - 0.6, flat.max(axis=0) + 0.6
        columns, rows = np.ceil((high - low) / cell).astype(int)
        blocked = self.generator.random((rows, columns)) < 0.25
        corner = (float(low[0]), float(low[1]))
        return MapRegion(tuple(map(tuple, blocked.tolist())), corner, cell, (first, second))

    def _predicate(self) -> Region:
        axes, place = self.world.axes, self.place()
        angles = tuple(name in axes.angles for name in axes.names)
        factors = self.generator.uniform(-1.0, 1.0, len(axes.names))
        values = np.where(angles, np.cos(place), place)
        stripe = Stripe(
            tuple(factors.tolist()),
            angles,
            float(factors @ values),
            float(self.generator.uniform(0.1, 0.4)),
        )
        name = f"stripe {self.generator.integers(1_000_000)}"
        return PredicateRegion(name, stripe, int(self.generator.integers(1, 10)))

    def _union(self) -> Region:
        kinds = ["box", "ball", "action", "state_action"]
        parts = [self.of_kind(str(self.generator.choice(kinds))) for _ in range(2)]
        return UnionRegion(f"union {self.generator.integers(1_000_000)}", tuple(parts))

    def _action(self) -> ActionRegion:
        column = int(self.generator.integers(len(self.world.action_names)))
        values = np.unique(self.world.actions[:, column])
        middles = np.r_[-np.inf, 0.5 * (values[1:] + values[:-1]), np.inf]
        first = int(self.generator.integers(len(values)))
        interval = (float(middles[first]), float(middles[first + 1]))
        return ActionRegion({self.world.action_names[column]: interval})

    def _state_action(self) -> Region:
        return StateActionRegion(self.of_kind("box"), self._action())


def random_axes(maker: Maker) -> tuple[dict[str, tuple[float, float, int]], list[str]]:
    """Return low, high and a number of cells for one state or two, and the full turns of them."""
    generator, axes, turns = maker.generator, {}, []
    names = maker.some(maker.world.axes.names)[:2]
    places = np.array([maker.place() for _ in range(20)])
    for name in names:
        column = places[:, maker.world.axes.column(name)]
        low, high = column.min() - generator.uniform(0, 0.3), column.max() + generator.uniform(0, 1)
        high = max(high, low + 0.8)
        if name in maker.world.axes.angles:
            low = float(generator.uniform(-4.0, 4.0))
            if generator.random() < 0.5:
                high = low + TURN
                turns.append(name)
            else:
                high = low + float(generator.uniform(2.0, 6.0))
        most = MOST_CELLS if len(names) == 1 else 4
        axes[name] = (float(low), float(high), int(generator.integers(2, most + 1)))
    return axes, turns


def random_grid(maker: Maker) -> Layout:
    """Return the cells of a regular grid, the last axis fastest."""
    axes, _ = random_axes(maker)
    sides = []
    for name, (low, high, num) in axes.items():
        width = (high - low) / num
        sides.append([(name, (low + k * width, low + (k + 1) * width)) for k in range(num)])
    regions = tuple(BoxRegion(dict(cell)) for cell in itertools.product(*sides))
    return Layout("grid", regions, axes)


def random_windows(maker: Maker) -> Layout:
    """Return windows of one size, slid along one axis or two, the last axis fastest."""
    cells, turns = random_axes(maker)
    overlap = int(maker.generator.integers(1, 4))
    axes, sides = {}, []
    for name, (low, high, few) in cells.items():
        num = max(few, overlap + 1)
        stride = (high - low) / num
        axes[name] = (low, high, overlap * stride)
        first = range(num if name in turns else num - overlap + 1)
        ends = [(low + k * stride, low + (k + overlap) * stride) for k in first]
        sides.append([(name, end) for end in ends])
    regions = tuple(BoxRegion(dict(window)) for window in itertools.product(*sides))
    return Layout("windows", regions, axes, overlap)
