"""Regions of state space that a trajectory may be forbidden to enter.

A constraint c is a set of states. A trajectory violates it when one of its states lies in c, or,
unless states alone are judged, when the straight segment between two consecutive states crosses
c (along the shorter arc for angles). Both tests work alike on NumPy and JAX arrays: the same code
judges demonstrations and masks the actions of a policy.

Shapes: n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import itertools
import keyword
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from swerve.arguments import whole_number
from swerve.space import TWO_PI, StateSpace


class Constraint(ABC):
    """A forbidden set of states."""

    @property
    @abstractmethod
    def name(self) -> str:
        """What tables and pictures call it."""

    @abstractmethod
    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set."""

    @abstractmethod
    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment from start to end [..., n] meets the set."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return JSON data from which `constraint_from_json` rebuilds it."""

    def check(self, space: StateSpace) -> None:
        """Raise ValueError where the constraint does not fit the state space."""


class Box(Constraint):
    """The states whose named components lie in half-open intervals [low, high).

    Components that are not named are free. The interval of an angle may lie anywhere and may wrap:
    `Box(theta=(3.0, 3.5))` and `Box(theta=(3.0 - 2 * pi, 3.5 - 2 * pi))` are the same set.

    Args:
      **intervals: for each named state (low, high), in that state's unit; +-inf leaves a side open.

    Raises:
      ValueError: if there is no interval, or one is empty or not a pair of numbers.
    """

    def __init__(self, **intervals: tuple[float, float]) -> None:
        if not intervals:
            raise ValueError("Box: expected at least one interval, as in Box(x=(0.0, 1.0))")
        self.intervals: dict[str, tuple[float, float]] = {}
        for name, interval in intervals.items():
            if np.shape(interval) != (2,):
                raise ValueError(f"Box: expected {name}=(low, high), got {interval!r}")
            low, high = (float(value) for value in interval)
            if not low < high:
                raise ValueError(f"Box: expected low < high for {name!r}, got ({low}, {high})")
            self.intervals[name] = (low, high)

    def __repr__(self) -> str:
        """Return Python that makes this box again, to the last digit."""
        sides = {
            name: f"({', '.join(_literal(value) for value in interval)})"
            for name, interval in self.intervals.items()
        }
        if all(name.isidentifier() and not keyword.iskeyword(name) for name in sides):
            return f"Box({', '.join(f'{name}={side}' for name, side in sides.items())})"
        return f"Box(**{{{', '.join(f'{name!r}: {side}' for name, side in sides.items())}}})"

    @property
    def name(self) -> str:
        """For example 'theta [3.14, 3.77), omega [0, 1.2)'."""
        return ", ".join(
            interval_name(name, low, high) for name, (low, high) in self.intervals.items()
        )

    def check(self, space: StateSpace) -> None:
        """Raise ValueError where a name is unknown or an angle interval exceeds a full turn."""
        for name, (low, high) in self.intervals.items():
            space.column(name)
            if name in space.angles and not high - low <= TWO_PI * (1 + 1e-12):
                raise ValueError(
                    f"Box: {name!r} is an angle, so its interval may span 2 pi at most, "
                    f"got ({low}, {high}), a width of {high - low:.6g} rad"
                )

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the box."""
        inside = True
        for name, (low, high) in self.intervals.items():
            value = states[..., space.column(name)]
            if name in space.angles:
                # twice, since a tiny negative number modulo 2 pi is rounded to 2 pi itself
                inside = inside & ((value - low) % TWO_PI % TWO_PI < high - low)
            else:
                inside = inside & (low <= value) & (value < high)
        return inside

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment meets the box (the slab test, images of angles)."""
        xp = starts.__array_namespace__()
        steps = space.difference(starts, ends)
        hit = self.contains(starts, space) | self.contains(ends, space)
        slabs = [
            _slabs(starts[..., column], steps[..., column], low, high, name in space.angles)
            for name, (low, high) in self.intervals.items()
            for column in [space.column(name)]
        ]
        for combination in itertools.product(*slabs):
            enter = xp.stack([enter for enter, _ in combination]).max(axis=0)
            leave = xp.stack([leave for _, leave in combination]).min(axis=0)
            hit = hit | (xp.minimum(leave, 1.0) > xp.maximum(enter, 0.0))
        return hit

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        intervals = {
            name: [value if math.isfinite(value) else None for value in interval]
            for name, interval in self.intervals.items()
        }
        return {"kind": "box", "intervals": intervals}


class Predicate(Constraint):
    """The states for which a function of yours says True.

    Args:
      name: what tables call it.
      function: maps states [..., n] to booleans [...]; written with operators and
        `states.__array_namespace__()` or `jax.numpy`, so that it also works while JAX traces it.
      num_points: how many evenly spaced points of a segment between two states are tried.
    """

    def __init__(self, name: str, function: Callable[[Any], Any], num_points: int = 8) -> None:
        self._name = name
        self.function = function
        self.num_points = whole_number(num_points, f"Predicate {name!r}: num_points", 1)

    def __repr__(self) -> str:
        """Return for example "Predicate('disc', in_disc, num_points=8)", without addresses."""
        function = getattr(self.function, "__name__", type(self.function).__name__)
        return f"Predicate({self.name!r}, {function}, num_points={self.num_points})"

    @property
    def name(self) -> str:
        """The name it was given."""
        return self._name

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set."""
        inside = self.function(states)
        shape, kind = (
            getattr(inside, "shape", None),
            str(getattr(inside, "dtype", type(inside).__name__)),
        )
        if shape != states.shape[:-1] or kind != "bool":
            raise ValueError(
                f"Predicate {self.name!r}: expected one boolean a state, shape "
                f"{states.shape[:-1]}, got {kind} of shape {shape}"
            )
        return inside

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where one of `num_points` points of the segment lies in the set."""
        steps = space.difference(starts, ends)
        hit = self.contains(starts, space)
        for k in range(1, self.num_points + 1):
            hit = hit | self.contains(starts + steps * (k / self.num_points), space)
        return hit

    def to_json(self) -> dict[str, Any]:
        """Return JSON data: the name alone, since code is never stored."""
        return {"kind": "predicate", "name": self.name, "num_points": self.num_points}


def constraint_from_json(data: dict[str, Any]) -> Constraint:
    """Rebuild a constraint from `to_json` data; a predicate comes back without its function."""
    if data["kind"] == "box":
        return Box(
            **{
                name: (-math.inf if low is None else low, math.inf if high is None else high)
                for name, (low, high) in data["intervals"].items()
            }
        )
    return Predicate(data["name"], _missing_function(data["name"]), data["num_points"])


def interval_name(name: str, low: float, high: float) -> str:
    """Return for example 'theta [3.14, 3.77)'."""
    return f"{name} [{_short(low)}, {_short(high)})"


def _short(value: float) -> str:
    return f"{value:.3g}" if value != 0 else "0"


def _literal(value: float) -> str:
    return repr(value) if math.isfinite(value) else f"float('{value}')"


def _missing_function(name: str) -> Callable[[Any], Any]:
    def function(states: Any) -> Any:
        raise ValueError(
            f"predicate {name!r} was read from a file, which holds its name and not its code: "
            "load the problem that defines it"
        )

    return function


def _slabs(start: Any, step: Any, low: float, high: float, is_angle: bool) -> list[tuple[Any, Any]]:
    """Return, for each image of [low, high), the part (enter, leave) of a segment inside it.

    The segment is start + u * step with 0 <= u <= 1; enter >= leave where it misses the image.
    """
    xp = start.__array_namespace__()
    if is_angle:
        start, low, high = (start - low) % TWO_PI, 0.0, high - low
    images = (-TWO_PI, 0.0, TWO_PI) if is_angle else (0.0,)
    still = step == 0
    divisor = xp.where(still, 1.0, step)
    parts = []
    for shift in images:
        to_low, to_high = (low + shift - start) / divisor, (high + shift - start) / divisor
        inside = (low + shift <= start) & (start < high + shift)
        enter = xp.where(still, xp.where(inside, -math.inf, math.inf), xp.minimum(to_low, to_high))
        leave = xp.where(still, xp.where(inside, math.inf, -math.inf), xp.maximum(to_low, to_high))
        parts.append((enter, leave))
    return parts


def check_constraints(constraints: Any, space: StateSpace, where: str) -> tuple[Constraint, ...]:
    """Return the constraints as a tuple after checking each against the state space.

    Raises:
      ValueError: if one is no Constraint or does not fit; `where` names the argument.
    """
    if isinstance(constraints, Constraint):
        raise ValueError(f"{where}: expected a list of constraints, got {constraints!r} alone")
    checked = tuple(constraints)
    for k, constraint in enumerate(checked):
        if not isinstance(constraint, Constraint):
            raise ValueError(f"{where}[{k}]: expected a Constraint, got {constraint!r}")
        constraint.check(space)
    return checked


def violates(
    constraint: Constraint, states: np.ndarray, space: StateSpace, between_states: bool
) -> np.ndarray:
    """Return [...] True where a trajectory [..., T+1, n] enters the constraint.

    A single state, T = 0, is a trajectory too: it is judged as it is.
    """
    if between_states and states.shape[-2] > 1:
        return constraint.crosses(states[..., :-1, :], states[..., 1:, :], space).any(axis=-1)
    return constraint.contains(states, space).any(axis=-1)
