"""Define constraints made of intervals: boxes of states, and boxes of actions.

Shapes: n state dimensions, m action dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import itertools
import keyword
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from swerve.base.arguments import numbers
from swerve.base.space import (
    RESOLUTION,
    TWO_PI,
    Actions,
    StateSpace,
    is_full_turn,
    single,
    wide,
)
from swerve.constraints.base import Constraint, nowhere
from swerve.constraints.edges import Interval, coordinate, judged_interval


class Box(Constraint):
    """The states whose named components lie in half-open intervals [low, high).

    Components without an interval are free. The interval of an angle may lie anywhere and may wrap:
    `Box(theta=(3.0, 3.5))` and `Box(theta=(3.0 - 2 * pi, 3.5 - 2 * pi))` are the same set.

    Args:
      **intervals: for each named state (low, high), in that state's unit; +-inf leaves a side open.

    Raises:
      ValueError: if there is no interval, or an interval is empty or not a pair of numbers.
    """

    def __init__(self, /, **intervals: tuple[float, float]) -> None:
        self.intervals = _checked_intervals("Box", intervals)

    def __repr__(self) -> str:
        """Return Python code that makes this box again, to the last digit."""
        return call("Box", [], _sides(self.intervals))

    @property
    def name(self) -> str:
        """For example 'theta [3.14, 3.77), omega [0, 1.2)'."""
        return _intervals_name(self.intervals)

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """The intervals of the box."""
        return self.intervals

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
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
        inside = (
            interval.holds(coordinate(states, space, name))
            for name, interval in self._judged(space)
        )
        return functools.reduce(operator.and_, inside)

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment enters the box, see `edges`.

        This is the slab test. For each component, the segment lies between two sides of the box
        over a part of its length. The segment enters the box where the parts of all components
        overlap. For angles, the copies of the box one turn away are tried too.
        """
        xp = starts.__array_namespace__()
        steps = space.difference(*(wide(single(states)) for states in (starts, ends)))
        starts_inside, ends_inside, slabs = True, True, []
        for name, interval in self._judged(space):
            start, end = coordinate(starts, space, name), coordinate(ends, space, name)
            starts_inside = starts_inside & interval.holds(start)
            ends_inside = ends_inside & interval.holds(end)
            slabs.append(interval.parts(start, steps[..., space.column(name)]))
        hit = starts_inside | ends_inside
        for combination in itertools.product(*slabs):
            enter = functools.reduce(xp.maximum, [enter for enter, _ in combination], 0.0)
            leave = functools.reduce(xp.minimum, [leave for _, leave in combination], 1.0)
            hit = hit | (leave > enter)
        return hit

    def _judged(self, space: StateSpace) -> list[tuple[str, Interval]]:
        """Return the intervals of the box as they are judged."""
        return [
            (
                name,
                judged_interval(
                    low, high, space.resolution[space.column(name)], name in space.angles
                ),
            )
            for name, (low, high) in self.intervals.items()
        ]

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the Euclidean distance [...] of states [..., n], over the named states."""
        parts = [
            interval_distance(states[..., space.column(name)], low, high, name in space.angles)
            for name, (low, high) in self.intervals.items()
        ]
        return np.linalg.norm(parts, axis=0)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Box:
        """Return the box less a margin on both sides of every interval.

        Open sides stay open, and the full turn of an angle, which has no sides, stays full.
        """
        intervals = {}
        for name, (low, high) in self.intervals.items():
            has_sides = not (name in space.angles and is_full_turn(low, high))
            width = margin.get(name, 0.0) if has_sides else 0.0
            if not low + width < high - width:
                raise ValueError(
                    f"margin: {width:g} for {name!r} leaves nothing of {self.name}: expected less "
                    f"than half its width, {(high - low) / 2:.6g}"
                )
            intervals[name] = (low + width, high - width)
        return Box(**intervals)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data; an open side is None, since JSON has no infinity."""
        return {"kind": "box", "intervals": _finite_intervals(self.intervals)}


class HasActions(Protocol):
    """The part of an MDP that says what its actions are."""

    @property
    def action_names(self) -> Sequence[str]:
        """Names of the m components."""
        ...

    @property
    def actions(self) -> Any:
        """[A, m] the discretised actions."""
        ...


class ActionBox(Constraint):
    """The actions whose named components lie in half-open intervals [low, high).

    Args:
      **intervals: for each named component (low, high), in its unit; +-inf leaves a side open.

    Raises:
      ValueError: if there is no interval, or an interval is empty or not a pair of numbers.
    """

    about_actions = True

    def __init__(self, /, **intervals: tuple[float, float]) -> None:
        self.intervals = _checked_intervals("ActionBox", intervals)

    def __repr__(self) -> str:
        """Return Python code that makes this box again, to the last digit."""
        return call("ActionBox", [], _sides(self.intervals))

    @property
    def name(self) -> str:
        """For example 'action force [0.5, 2)'."""
        return f"action {_intervals_name(self.intervals)}"

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where no component of the actions has a name of the box."""
        for name in self.intervals:
            if name not in action_names:
                raise ValueError(
                    f"ActionBox: no action component {name!r}; there are {', '.join(action_names)}"
                )

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] False: no state is forbidden."""
        return nowhere(states)

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] False: no state is forbidden."""
        return nowhere(starts)

    def forbids(self, actions: Actions) -> Any:
        """Return [...] True where an action lies in the box."""
        inside = True
        for name, (low, high) in self.intervals.items():
            value = single(actions.values[..., actions.names.index(name)])
            edges = [abs(edge) for edge in (low, high) if edge and math.isfinite(edge)]
            resolution = RESOLUTION * max(edges, default=1.0)
            inside = inside & judged_interval(low, high, resolution, False).holds(value)
        return inside

    def among(self, mdp: HasActions) -> np.ndarray:
        """Return [A] True for each of the discretised actions of an MDP that the box forbids."""
        table = np.asarray(mdp.actions, float)
        return np.asarray(self.forbids(Actions(tuple(mdp.action_names), table)))

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return [...] infinity: no state is near a box of actions."""
        return np.full(np.shape(states)[:-1], np.inf)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> ActionBox:
        """Return the box itself: the margin concerns states alone."""
        del margin, space
        return self

    def to_json(self) -> dict[str, Any]:
        """Return JSON data; an open side is None, since JSON has no infinity."""
        return {"kind": "action_box", "intervals": _finite_intervals(self.intervals)}


def interval_distance(values: np.ndarray, low: Any, high: Any, is_angle: bool) -> np.ndarray:
    """Return the distance of values to intervals [low, high), along the shorter arc for angles."""
    if not is_angle:
        return np.maximum(0.0, np.maximum(low - values, values - high))
    above, width = (values - low) % TWO_PI, high - low
    return np.where(above < width, 0.0, np.minimum(above - width, TWO_PI - above))


def interval_name(name: str, low: float, high: float) -> str:
    """Return for example 'theta [3.14, 3.77)'."""
    return f"{name} [{short(low)}, {short(high)})"


def _intervals_name(intervals: dict[str, tuple[float, float]]) -> str:
    return ", ".join(interval_name(name, low, high) for name, (low, high) in intervals.items())


def _checked_intervals(
    kind: str, intervals: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    if not intervals:
        raise ValueError(f"{kind}: expected at least one interval, as in {kind}(x=(0.0, 1.0))")
    checked = {}
    for name, interval in intervals.items():
        pair = numbers(interval, 2)
        if pair is None:
            raise ValueError(f"{kind}: expected {name}=(low, high), got {interval!r}")
        low, high = pair
        if not low < high:
            raise ValueError(
                f"{kind}: expected low < high for {name!r}, got {interval!r}: give two numbers, "
                "+-inf for an open side"
            )
        checked[name] = (low, high)
    return checked


def call(kind: str, arguments: Sequence[str], named: Mapping[str, str]) -> str:
    """Return Python code that makes a constraint, from the Python code of its arguments."""
    if all(name.isidentifier() and not keyword.iskeyword(name) for name in named):
        return f"{kind}({', '.join([*arguments, *(f'{k}={v}' for k, v in named.items())])})"
    pairs = ", ".join(f"{name!r}: {value}" for name, value in named.items())
    return f"{kind}({', '.join([*arguments, f'**{{{pairs}}}'])})"


def short(value: float) -> str:
    """Return a number as text of three significant digits; 0 has no sign."""
    return f"{value:.3g}" if value != 0 else "0"


def _sides(intervals: dict[str, tuple[float, float]]) -> dict[str, str]:
    """Return the Python code of intervals."""
    return {
        name: f"({', '.join(_literal(value) for value in interval)})"
        for name, interval in intervals.items()
    }


def _finite_intervals(intervals: dict[str, tuple[float, float]]) -> dict[str, list[float | None]]:
    return {
        name: [value if math.isfinite(value) else None for value in interval]
        for name, interval in intervals.items()
    }


def _literal(value: float) -> str:
    return repr(value) if math.isfinite(value) else f"float('{value}')"
