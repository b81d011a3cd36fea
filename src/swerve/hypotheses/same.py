"""Tell which hypotheses are the same set, whatever they are called.

Shapes: H hypotheses.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from swerve.base.space import TWO_PI, StateSpace, is_full_turn
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.shapes import HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet

DIGITS = 9  # significant digits in which two numbers must agree to count as the same


def same_as(hypotheses: HypothesisSet, space: StateSpace) -> np.ndarray:
    """Return for each hypothesis the index [H] of the first hypothesis that is the same set.

    The cells of a grid, and windows, all differ.
    """
    if not isinstance(hypotheses, ConstraintHypotheses):
        return np.arange(len(hypotheses))
    first: dict[Any, int] = {}
    keys = (set_key(constraint, space) for constraint in hypotheses.constraints)
    return np.array([first.setdefault(key, index) for index, key in enumerate(keys)])


def set_key(constraint: Constraint, space: StateSpace) -> Any:
    """Return a key that is the same for constraints that are the same set."""
    return frozenset(_key_of_part(part, space) for part in constraint.parts)


def _key_of_part(constraint: Constraint, space: StateSpace) -> Any:
    """Return such a key of a constraint that is no union."""
    if isinstance(constraint, Box):
        return ("box", *sorted(filter(None, _sides(constraint, space))))
    if isinstance(constraint, Predicate):
        return ("predicate", id(constraint.function), constraint.num_points)
    if isinstance(constraint, StateAction):
        return (
            "state_action",
            *(set_key(c, space) for c in (constraint.states, constraint.actions)),
        )
    if constraint.needs_code:  # which its JSON data do not hold
        return ("code", id(constraint))
    if isinstance(constraint, HalfSpace):
        return _key_of_half_space(constraint, space)
    data = constraint.to_json()
    if data.get("kind") == "occupancy":
        del data["name"]
    if data.get("kind") == "polygon":
        data["vertices"] = _in_order(data["vertices"])
    return json.dumps(_rounded(data), sort_keys=True)


def _key_of_half_space(half: HalfSpace, space: StateSpace) -> Any:
    """Return the key of a half-space, whose numbers may all be scaled; x >= a is a box as well."""
    size = math.hypot(*half.normal.values())
    normal = {name: factor / size for name, factor in half.normal.items()}
    (name, factor), *others = normal.items()
    if factor > 0.0 and not others:
        return _key_of_part(Box(**{name: (half.offset / size, math.inf)}), space)
    return ("half_space", _rounded(half.offset / size), *sorted(_rounded(normal).items()))


def _in_order(vertices: list[list[float]]) -> list[list[float]]:
    """Return vertices from the least one on, in the direction of the lesser of its neighbours."""
    first = vertices.index(min(vertices))
    forth = vertices[first:] + vertices[:first]
    return min(forth, [forth[0], *reversed(forth[1:])])


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
