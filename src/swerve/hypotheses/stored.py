"""Rebuild hypotheses from their stored data: the inverse of `HypothesisSet.to_json`."""

from __future__ import annotations

from typing import Any

from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import GridHypotheses
from swerve.hypotheses.windows import windows


def hypotheses_from_json(data: dict[str, Any]) -> HypothesisSet:
    """Rebuild hypotheses from `to_json` data."""
    match data["kind"]:
        case "grid":
            return GridHypotheses({name: tuple(axis) for name, axis in data["axes"].items()})
        case "windows":
            return windows(data["overlap"], **data["axes"])
        case "constraints":
            return ConstraintHypotheses(constraint_from_json(item) for item in data["constraints"])
    raise ValueError(
        f"hypotheses: no kind {data['kind']!r} is known here: a newer version of swerve stored it, "
        "or hypotheses/stored.py lacks a case for it"
    )
