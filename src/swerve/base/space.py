"""State spaces, tasks and actions as plain data: names, angles, bounds, transitions.

An angle theta stands for theta + 2 pi k, so the difference between two angles is the shorter arc,

    difference(a, b) = d - 2 pi round(d / (2 pi)),    d = b - a,

and a straight segment between two states follows that arc. Everything here works alike on NumPy
and JAX arrays, and imports no JAX.

Shapes: n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from swerve.base.arguments import real_numbers

TWO_PI = 2.0 * math.pi
LATTICE_EXTENT = 250.0  # lattice steps: largest unit of distance, see `StateSpace.unit`
MAX_HALF_EXTENTS = 10  # half widths, from the middle of the bounds: states beyond have a wrong unit
MAX_TURNS = 10  # full turns: an angle beyond is in degrees
RESOLUTION = 2.0**-20  # share of a state's extent, about a millionth: closer numbers count as equal


class Task(NamedTuple):
    """A start state and a goal; with a leading axis in both, a batch of tasks.

    Attributes:
      start: [..., n] state at t = 0.
      goal: [..., g] the goal of the reward; often a state, then g = n.
    """

    start: Any
    goal: Any

    @classmethod
    def stack(cls, tasks: list[Task]) -> Task:
        """Join single tasks into one batch with a leading axis."""
        if not tasks:
            raise ValueError("expected at least one task, got an empty list")
        for task in tasks:
            if not isinstance(task, Task):
                raise ValueError(f"expected swerve.Task(start, goal), got {task!r}")
        return cls(
            np.stack([real_numbers(task.start, "start of a task") for task in tasks]),
            np.stack([real_numbers(task.goal, "goal of a task") for task in tasks]),
        )


class Actions(NamedTuple):
    """Actions and the names of their components.

    Attributes:
      names: names of the m components.
      values: [..., m] the actions; NaN where a trajectory has ended.
    """

    names: tuple[str, ...]
    values: Any


class Transitions(NamedTuple):
    """The successor of each state and action, where there are finitely many.

    Attributes:
      shape: number of values of each component of a state; the first component varies fastest.
      successors: [S, A] the number of the next state; negative where a state does not offer the
        action.
      actions: [A, m] the actions that can be chosen.
    """

    shape: tuple[int, ...]
    successors: np.ndarray
    actions: np.ndarray

    @property
    def isolated(self) -> np.ndarray:
        """[U, n] the states, such as walls, that no action leads to and that offer no action."""
        alone = np.flatnonzero((self.successors < 0).all(axis=1))
        alone = alone[~np.isin(alone, self.successors)]
        index = np.unravel_index(alone, self.shape, order="F")
        return np.stack(index, axis=-1).astype(float)

    def number(self, states: Any) -> Any:
        """Return the number [...] of the state nearest to each point [..., n], NumPy or JAX."""
        return lattice_number(states, self.shape)

    def action_number(self, actions: Any) -> Any:
        """Return the number [...] of the action nearest to each point [..., m], NumPy or JAX."""
        return nearest(actions, self.actions)

    def fits(self, states: np.ndarray) -> np.ndarray:
        """Return [L-1, A] True where an action leads from a state of a path [L, n] to the next."""
        number = self.number(states)
        return np.asarray(self.successors[number[:-1]] == number[1:, None])

    def rests(self, states: np.ndarray) -> np.ndarray:
        """Return [L-1] True for steps, at the end of a path [L, n], that stay in its last state."""
        number = self.number(states)
        return np.logical_and.accumulate((number == number[-1])[::-1])[::-1][:-1]


def lattice_number(states: Any, shape: Sequence[int]) -> Any:
    """Return the number [...] of the lattice point nearest to each point [..., n], NumPy or JAX."""
    xp = states.__array_namespace__()
    index, stride = 0, 1
    for component, size in enumerate(shape):
        value = xp.clip(xp.round(states[..., component]), 0, size - 1)
        index = index + stride * value.astype(xp.int32)
        stride *= size
    return index


def nearest(values: Any, table: Any) -> Any:
    """Return the number [...] of the row of a table [A, m] nearest to each point [..., m]."""
    xp = values.__array_namespace__()
    return ((values[..., None, :] - xp.asarray(table)) ** 2).sum(axis=-1).argmin(axis=-1)


def single(values: Any) -> Any:
    """Return numbers [...] rounded to float32, the precision at which all are judged."""
    xp = values.__array_namespace__()
    if values.dtype == xp.float32:
        return values
    largest = float(np.finfo(np.float32).max)  # numbers beyond are beyond every finite edge, too
    return xp.clip(values, -largest, largest).astype(xp.float32)


def wide(values: Any) -> Any:
    """Return float32 numbers [...] for arithmetic: float64 with NumPy, unchanged with JAX."""
    return values.astype(np.float64) if isinstance(values, np.ndarray | np.generic) else values


def is_full_turn(low: float, high: float) -> bool:
    """Return whether an interval of an angle is a full turn, which has no ends."""
    return high - low > TWO_PI * (1 - RESOLUTION)


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Names, angles and bounds of the states of an MDP.

    Attributes:
      names: of the n states, all different; also the columns of demonstration files.
      angles: the names of states that wrap at 2 pi [rad].
      bounds: [n, 2] where states are expected, in the states' own units.
      is_lattice: whether states are whole numbers.
    """

    names: tuple[str, ...]
    angles: tuple[str, ...]
    bounds: np.ndarray
    is_lattice: bool = False

    def __post_init__(self) -> None:
        twice = [name for name in dict.fromkeys(self.names) if self.names.count(name) > 1]
        if twice:
            raise ValueError(
                f"expected a name of its own for each state, got {', '.join(map(repr, twice))} "
                f"more than once in {self.names}"
            )
        bounds = np.asarray(self.bounds, dtype=float)
        if bounds.shape != (len(self.names), 2):
            raise ValueError(
                f"bounds: expected shape ({len(self.names)}, 2), one (low, high) row for each of "
                f"{self.names}, got {bounds.shape}"
            )
        if not (np.isfinite(bounds).all() and (bounds[:, 0] < bounds[:, 1]).all()):
            raise ValueError(f"bounds: expected finite low < high in every row, got {bounds}")
        object.__setattr__(self, "bounds", bounds)
        for name in self.angles:
            self.column(name)

    @cached_property
    def is_angle(self) -> np.ndarray:
        """[n] True where a state wraps at 2 pi."""
        return np.array([name in self.angles for name in self.names])

    @cached_property
    def extent(self) -> np.ndarray:
        """[n] width of the bounds."""
        return self.bounds[:, 1] - self.bounds[:, 0]

    @cached_property
    def unit(self) -> np.ndarray:
        """[n] the unit of relative distances between states: the extent.

        On a lattice the unit is at most LATTICE_EXTENT, so that a tolerance of a thousandth is less
        than the distance between neighbours.
        """
        return np.minimum(self.extent, LATTICE_EXTENT) if self.is_lattice else self.extent

    @cached_property
    def resolution(self) -> np.ndarray:
        """[n] the distance below which two numbers of a state count as equal, in its unit.

        Far above the rounding of float32, which a simulation adds up step by step, and far below
        what anybody measures: a millionth of the extent, of a full turn for angles.
        """
        extent = np.where(self.is_angle, TWO_PI, self.extent)
        largest = np.where(self.is_angle, 0.0, np.abs(self.bounds).max(axis=1))
        return np.maximum(RESOLUTION * extent, 2.0 * np.spacing(largest.astype(np.float32)))

    @cached_property
    def believable(self) -> np.ndarray:
        """[2, n] the least and the largest believable state: numbers beyond have a wrong unit."""
        centre = np.where(self.is_angle, 0.0, self.bounds.mean(axis=1))
        reach = np.where(self.is_angle, MAX_TURNS * TWO_PI, MAX_HALF_EXTENTS * self.extent / 2)
        return np.stack([centre - reach, centre + reach])

    def column(self, name: str) -> int:
        """Return the index of a state name.

        Raises:
          ValueError: if no state has the name.
        """
        if name not in self.names:
            raise ValueError(f"no state named {name!r}; the states are {', '.join(self.names)}")
        return self.names.index(name)

    def difference(self, start: Any, end: Any) -> Any:
        """Return end - start [..., n], along the shorter arc for angles."""
        xp = start.__array_namespace__()
        delta = end - start
        wrapped = delta - TWO_PI * xp.round(delta / TWO_PI)
        return cast(Any, xp.where(self.is_angle, wrapped, delta))

    def relative_distance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the largest difference [...] between components of states, in their `unit`."""
        return (np.abs(self.difference(a, b)) / self.unit).max(axis=-1)

    def to_json(self) -> dict[str, Any]:
        """Return this space as JSON data."""
        return {
            "names": list(self.names),
            "angles": list(self.angles),
            "bounds": self.bounds.tolist(),
            "is_lattice": self.is_lattice,
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> StateSpace:
        """Rebuild a space from `to_json` data."""
        return cls(
            tuple(data["names"]),
            tuple(data["angles"]),
            np.array(data["bounds"]),
            data["is_lattice"],
        )
