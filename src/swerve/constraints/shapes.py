"""Define constraints that are balls and half-spaces.

    ball         |x - c| < r                 (angles by the shorter arc)
    half-space   sum_i n_i x_i >= offset

Each constraint names some of the states; the states that it does not name are free. A state that
lies on the edge but for the resolution of the states counts as on it (`constraints.edges`): so it
is outside of a ball, and inside of a half-space.

Shapes: n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import number_or_nan
from swerve.base.space import TWO_PI, StateSpace, single, wide
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import call, short
from swerve.constraints.edges import depth, fine, rounding


class Ball(Constraint):
    """The states nearer to a centre than a radius: an open Euclidean ball.

    The distance is over the states that the centre names, in their own units, with angles by the
    shorter arc.

    Args:
      radius: in the unit of the states.
      **centre: coordinate of the centre along each named state.

    Raises:
      ValueError: if the radius is not above 0, the centre names no state, or a coordinate is not
        finite.
    """

    def __init__(self, radius: float, /, **centre: float) -> None:
        self.radius = number_or_nan(radius)
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(
                f"Ball: expected a finite radius > 0, got {radius!r}: give it first, in the unit "
                "of the states, as in Ball(0.5, x=1.0, y=2.0)"
            )
        self.centre = _checked_axes("Ball", "a centre, as in Ball(0.5, x=1.0, y=2.0)", centre)

    def __repr__(self) -> str:
        """Return Python code that makes this ball again, to the last digit."""
        return call("Ball", [repr(self.radius)], {k: repr(v) for k, v in self.centre.items()})

    @property
    def name(self) -> str:
        """For example 'ball of radius 0.5 at x 1, y 2'."""
        centre = ", ".join(f"{name} {short(value)}" for name, value in self.centre.items())
        return f"ball of radius {short(self.radius)} at {centre}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """From the centre less the radius to the centre plus the radius."""
        return {name: (x - self.radius, x + self.radius) for name, x in self.centre.items()}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is not that of a state."""
        for name in self.centre:
            space.column(name)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] is nearer to the centre than the radius."""
        offsets = self._offsets(wide(single(states)), space)
        return functools.reduce(operator.add, [d**2 for d in offsets]) < self._reach(space) ** 2

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment's nearest point lies in the ball or in its image.

        The images of the ball are its copies one turn away along each angle.
        """
        xp = starts.__array_namespace__()
        starts, ends = wide(single(starts)), wide(single(ends))
        steps = space.difference(starts, ends)
        along = [steps[..., space.column(name)] for name in self.centre]
        length = functools.reduce(operator.add, [step**2 for step in along])
        hit = self.contains(starts, space) | self.contains(ends, space)
        images = [(-TWO_PI, 0.0, TWO_PI) if k in space.angles else (0.0,) for k in self.centre]
        for shifts in itertools.product(*images):
            offsets = [d + s for d, s in zip(self._offsets(starts, space), shifts, strict=True)]
            dots = (d * step for d, step in zip(offsets, along, strict=True))
            share = -functools.reduce(operator.add, dots) / xp.where(length > 0, length, 1.0)
            share = xp.clip(share, 0.0, 1.0)
            nearest = [(d + share * step) ** 2 for d, step in zip(offsets, along, strict=True)]
            hit = hit | (functools.reduce(operator.add, nearest) < self._reach(space) ** 2)
        return hit

    def _reach(self, space: StateSpace) -> float:
        """Return the radius less the resolution, or the rounding of states near the ball."""
        resolution = max(space.resolution[[*map(space.column, self.centre)]])
        size = max(map(abs, self.centre.values())) + self.radius
        return self.radius - depth(resolution, self.radius, size)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n], over the named states."""
        to_centre = np.linalg.norm(self._offsets(np.asarray(states, float), space), axis=0)
        return np.maximum(0.0, to_centre - self.radius)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Ball:
        """Return the ball with its radius reduced by the largest margin of the named states.

        A ball that names angles alone and reaches round all of them has no edge: it stays the same.
        """
        if set(self.centre) <= set(space.angles) and self.radius > math.pi * math.sqrt(
            len(self.centre)
        ):
            return self
        name = max(self.centre, key=lambda name: margin.get(name, 0.0))
        width = margin.get(name, 0.0)
        if not width < self.radius:
            raise ValueError(
                f"margin: {width:g} for {name!r} leaves nothing of {self.name}: expected less than "
                f"its radius, {self.radius:.6g}"
            )
        return Ball(self.radius - width, **self.centre)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "ball", "radius": self.radius, "centre": self.centre}

    def _offsets(self, states: Any, space: StateSpace) -> list[Any]:
        """Return the offset [...] of states [..., n] from the centre along each named state."""
        xp = states.__array_namespace__()
        offsets = []
        for name, centre in self.centre.items():
            offset = states[..., space.column(name)] - centre
            if name in space.angles:
                offset = offset - TWO_PI * xp.round(offset / TWO_PI)
            offsets.append(offset)
        return offsets


class HalfSpace(Constraint):
    """The states with sum_i n_i x_i >= offset, on one side of a line, a plane and so on.

    Args:
      offset: the least sum that is forbidden.
      **normal: the factor n_i of each named state; no angles, which have no sides. A factor of 0
        leaves its state free, as if the state were not named.

    Raises:
      ValueError: if the normal names no state or is zero, or a number is not finite.
    """

    def __init__(self, offset: float, /, **normal: float) -> None:
        self.offset = number_or_nan(offset)
        if not math.isfinite(self.offset):
            raise ValueError(
                f"HalfSpace: expected a finite offset, got {offset!r}: give it first, as in "
                "HalfSpace(1.0, x=1.0) for x >= 1"
            )
        factors = _checked_axes("HalfSpace", "a normal, as in HalfSpace(1.0, x=1.0)", normal)
        self.normal = {name: factor for name, factor in factors.items() if factor != 0.0}
        if not self.normal:
            raise ValueError(
                f"HalfSpace: expected a normal that is not zero, got {factors}, which restricts "
                "no state: give at least one state a factor other than 0"
            )

    def __repr__(self) -> str:
        """Return Python code that makes this half-space again, to the last digit."""
        return call("HalfSpace", [repr(self.offset)], {k: repr(v) for k, v in self.normal.items()})

    @property
    def name(self) -> str:
        """For example 'x - 2 y >= 3'."""
        text = ""
        for name, factor in self.normal.items():
            sign = "-" if factor < 0 else "+" if text else ""
            size = "" if abs(factor) == 1.0 else f"{short(abs(factor))} "
            text += f" {sign} {size}{name}" if text else f"{sign}{size}{name}"
        return f"{text} >= {short(self.offset)}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """All numbers; where only one state is named, the numbers on the forbidden side."""
        if len(self.normal) > 1:
            return dict.fromkeys(self.normal, (-math.inf, math.inf))
        ((name, factor),) = self.normal.items()
        limit = self.offset / factor
        return {name: (limit, math.inf) if factor > 0 else (-math.inf, limit)}

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a name is not that of a state, or is that of an angle."""
        check_no_angles("HalfSpace", self.normal, space)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] is on the forbidden side, or on its edge."""
        parts = self._parts(wide(single(states)), space)
        size = functools.reduce(operator.add, map(abs, parts))
        missing = self.offset - functools.reduce(operator.add, parts)
        return (missing <= self._resolution(space)) | (missing <= rounding(size))

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where an end of the segment is inside: the sum is largest at an end."""
        return self.contains(starts, space) | self.contains(ends, space)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n], over the named states."""
        missing = self.offset - sum(self._parts(np.asarray(states, float), space))
        return np.maximum(0.0, missing) / math.hypot(*self.normal.values())

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> HalfSpace:
        """Return the half-space with an offset larger by the sum of |n_i| times the margins."""
        widths = (abs(factor) * margin.get(name, 0.0) for name, factor in self.normal.items())
        return HalfSpace(self.offset + sum(widths), **self.normal)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "half_space", "offset": self.offset, "normal": self.normal}

    def _parts(self, states: Any, space: StateSpace) -> list[Any]:
        """Return n_i x_i [...] of states [..., n] for each named state."""
        return [factor * states[..., space.column(k)] for k, factor in self.normal.items()]

    def _resolution(self, space: StateSpace) -> float:
        """Return the resolution of the sum: the sum of |n_i| times that of each state."""
        sizes = {name: space.resolution[space.column(name)] for name in self.normal}
        total = sum(abs(factor) * sizes[name] for name, factor in self.normal.items())
        return fine(total, abs(self.offset) or 1.0)


def _checked_axes(kind: str, expected: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers by state after checking that each is finite."""
    if not values:
        raise ValueError(f"{kind}: expected {expected}, got none")
    checked = {name: number_or_nan(value) for name, value in values.items()}
    for name, value in checked.items():
        if not math.isfinite(value):
            raise ValueError(f"{kind}: expected a finite number for {name!r}, got {values[name]!r}")
    return checked


def check_no_angles(kind: str, names: Iterable[str], space: StateSpace) -> None:
    """Raise ValueError where a name is not that of a state, or is that of an angle."""
    for name in names:
        space.column(name)
        if name in space.angles:
            raise ValueError(
                f"{kind}: {name!r} is an angle, which goes round and has no sides: use a Box, a "
                "Ball or a Predicate"
            )
