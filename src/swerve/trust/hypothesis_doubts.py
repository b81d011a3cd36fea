"""Give what is odd about the hypotheses themselves: the same set twice, or sets nobody comes to.

Each hypothesis has a share of the prior probability. Two that are the same set share what one of
them should have alone; one outside the bounds can neither win nor lose by any demonstration.

Shapes: H hypotheses.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from swerve.base.phrases import some_names
from swerve.base.space import TWO_PI, StateSpace, is_full_turn
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.shapes import HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import BoxHypotheses

DIGITS = 9  # significant digits in which two numbers must agree to count as the same


def hypothesis_warnings(hypotheses: HypothesisSet, space: StateSpace) -> Iterator[str]:
    """Yield warnings about hypotheses that are the same, or lie wholly outside the bounds."""
    if isinstance(hypotheses, ConstraintHypotheses):
        yield from _same(hypotheses, space)
    found: dict[str, list[tuple[int, float, float]]] = {}
    for index, name, low, high in _outside(hypotheses, space):
        found.setdefault(name, []).append((index, low, high))
    for name, places in found.items():
        yield _outside_text(name, places, space)


def _same(hypotheses: ConstraintHypotheses, space: StateSpace) -> Iterator[str]:
    """Yield a warning for each group of hypotheses that are the same set."""
    groups: dict[Any, list[int]] = {}
    for index, constraint in enumerate(hypotheses.constraints):
        key = frozenset(_key(part, space) for part in constraint.parts)
        groups.setdefault(key, []).append(index)
    for group in groups.values():
        if len(group) > 1:
            names = some_names([str(index) for index in group])
            yield (
                f"hypotheses {names} are the same set ({hypotheses.name(group[0])}), each with a "
                f"share of the prior: together they count {len(group)} times. Keep one of them"
            )


def _key(constraint: Constraint, space: StateSpace) -> Any:
    """Return a key that is the same for constraints that are the same set."""
    if isinstance(constraint, Box):
        return ("box", *sorted(filter(None, _sides(constraint, space))))
    if isinstance(constraint, Predicate):
        return ("predicate", id(constraint.function), constraint.num_points)
    return json.dumps(_rounded(constraint.to_json()), sort_keys=True)


def _sides(box: Box, space: StateSpace) -> Iterator[tuple[Any, ...] | None]:
    """Yield the sides of a box that limit it; angles as if they began in [0, 2 pi)."""
    for name, (low, high) in box.intervals.items():
        is_angle = name in space.angles
        if np.isinf([low, high]).all() or (is_angle and is_full_turn(low, high)):
            continue
        if not is_angle:
            yield name, _rounded(float(low)), _rounded(float(high))
            continue
        begin = round(low % TWO_PI, DIGITS) % round(TWO_PI, DIGITS)
        yield name, begin, round(high - low, DIGITS)


def _rounded(value: Any) -> Any:
    """Return JSON data with numbers of DIGITS significant digits."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.{DIGITS - 1}e}") + 0.0 if isinstance(value, float | int) else value


def _outside(
    hypotheses: HypothesisSet, space: StateSpace
) -> Iterator[tuple[int, str, float, float]]:
    """Yield each hypothesis outside the bounds: its index, the state, and its interval there."""
    bounds = {
        name: (low, high)
        for name, (low, high) in zip(space.names, space.bounds.tolist(), strict=True)
        if name not in space.angles
    }
    if isinstance(hypotheses, BoxHypotheses):
        for axis, (name, (low, high)) in enumerate(hypotheses.edges().items()):
            if name in bounds:
                place = np.indices(hypotheses.shape)[axis].ravel()
                is_out = (high <= bounds[name][0]) | (low > bounds[name][1])  # [low, high)
                for index in np.flatnonzero(is_out[place]).tolist():
                    yield index, name, float(low[place[index]]), float(high[place[index]])
        return
    for index in range(len(hypotheses)):
        each = [_beyond(part, bounds) for part in hypotheses.constraint(index).parts]
        if each[0] is not None and None not in each:
            yield index, *each[0]


def _beyond(
    part: Constraint, bounds: dict[str, tuple[float, float]]
) -> tuple[str, float, float] | None:
    """Return a state in which a constraint lies outside the bounds, and its interval there."""
    states = part.states if isinstance(part, StateAction) else part
    holds_high = isinstance(states, HalfSpace)  # other sets hold at most their low edges
    for name, (low, high) in part.spans.items():
        least, most = bounds.get(name, (-math.inf, math.inf))
        if high < least or (high == least and not holds_high) or low > most:
            return name, low, high
    return None


def _outside_text(name: str, places: list[tuple[int, float, float]], space: StateSpace) -> str:
    low, high = space.bounds[space.column(name)].tolist()
    first, least, most = places[0]
    names = some_names([str(index) for index, _, _ in places])
    are, have = ("hypothesis", "it has") if len(places) == 1 else ("hypotheses", "each has")
    return (
        f"{are} {names}: wholly outside the bounds of {name}, [{low:.6g}, {high:.6g}] (hypothesis "
        f"{first} has {name} from {least:.6g} to {most:.6g}). Nominal trajectories hardly go "
        f"there, and yet {have} a share of the prior: another unit? Leave out what cannot be, or "
        "widen the MDP's bounds"
    )
