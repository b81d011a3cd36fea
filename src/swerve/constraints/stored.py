"""Rebuild constraints from their stored data: the inverse of `Constraint.to_json`.

The modules of other kinds than boxes are imported only when needed: a stored grid is read sooner
without them.
"""

from __future__ import annotations

import math
from typing import Any

from swerve.constraints.base import Constraint, Union
from swerve.constraints.boxes import ActionBox, Box


def constraint_from_json(data: dict[str, Any]) -> Constraint:
    """Rebuild a constraint from `to_json` data; a predicate comes back without its function.

    Raises:
      ValueError: if the kind of the constraint is unknown.
    """
    match data["kind"]:
        case "union":
            return Union(data["name"], [constraint_from_json(part) for part in data["constraints"]])
        case "box":
            return Box(**_intervals(data))
        case "action_box":
            return ActionBox(**_intervals(data))
        case "ball":
            from swerve.constraints.shapes import Ball

            return Ball(data["radius"], **data["centre"])
        case "half_space":
            from swerve.constraints.shapes import HalfSpace

            return HalfSpace(data["offset"], **data["normal"])
        case "polygon":
            from swerve.constraints.polygons import Polygon

            return Polygon(data["vertices"], data["names"], data["depth"])
        case "state_action":
            from swerve.constraints.state_action import StateAction

            actions = ActionBox(**_intervals(data["actions"]))
            return StateAction(constraint_from_json(data["states"]), actions)
        case "occupancy":
            from swerve.constraints.occupancy import Occupancy

            return Occupancy.from_json(data)
        case "predicate":
            from swerve.constraints.predicate import Predicate, missing_function

            return Predicate(data["name"], missing_function(data["name"]), data["num_points"])
    raise ValueError(
        f"constraint: no kind {data['kind']!r} is known here: a newer version of swerve stored it, "
        "or constraints/stored.py lacks a case for it"
    )


def _intervals(data: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the intervals of a box; a stored side of None is open."""
    return {
        name: (-math.inf if low is None else low, math.inf if high is None else high)
        for name, (low, high) in data["intervals"].items()
    }
