"""The types of stored hypotheses: what `HypothesisSet.to_json` returns, see `base.schema`."""

from __future__ import annotations

from swerve.base.schema import Count, Data, Finite, Positive
from swerve.constraints.schema import ConstraintData


class GridData(Data, tag_field="kind", tag="grid"):
    """The cells of a grid."""

    axes: dict[str, tuple[Finite, Finite, Count]]


class WindowsData(Data, tag_field="kind", tag="windows"):
    """Overlapping windows."""

    axes: dict[str, tuple[Finite, Finite, Positive]]
    overlap: Count


class ConstraintsData(Data, tag_field="kind", tag="constraints"):
    """A list of constraints."""

    constraints: list[ConstraintData]


HypothesesData = GridData | WindowsData | ConstraintsData
