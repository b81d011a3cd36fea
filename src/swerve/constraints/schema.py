"""The types of stored constraints: what `Constraint.to_json` returns, see `base.schema`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from swerve.base.schema import Count, Data, Finite, Names, Positive

Pair = Annotated[Names, Meta(min_length=2, max_length=2)]
Intervals = dict[str, tuple[Finite | None, Finite | None]]


class BoxData(Data, tag_field="kind", tag="box"):
    """A `Box`."""

    intervals: Intervals


class ActionBoxData(Data, tag_field="kind", tag="action_box"):
    """An `ActionBox`."""

    intervals: Intervals


class BallData(Data, tag_field="kind", tag="ball"):
    """A `Ball`."""

    radius: Positive
    centre: dict[str, Finite]


class HalfSpaceData(Data, tag_field="kind", tag="half_space"):
    """A `HalfSpace`."""

    offset: Finite
    normal: dict[str, Finite]


class PolygonData(Data, tag_field="kind", tag="polygon"):
    """A `Polygon`."""

    vertices: list[tuple[Finite, Finite]]
    names: Pair
    depth: Finite


class StateActionData(Data, tag_field="kind", tag="state_action"):
    """A `StateAction`."""

    states: ConstraintData
    actions: ActionBoxData


class OccupancyData(Data, tag_field="kind", tag="occupancy"):
    """An `Occupancy`."""

    name: str
    shape: tuple[Count, Count]
    blocked: str
    corner: tuple[Finite, Finite]
    cell: Positive
    names: Pair


class PredicateData(Data, tag_field="kind", tag="predicate"):
    """A `Predicate`, without its function."""

    name: str
    num_points: Count


class UnionData(Data, tag_field="kind", tag="union"):
    """A `Union`."""

    name: str
    constraints: list[ConstraintData]


ConstraintData = (
    BoxData
    | ActionBoxData
    | BallData
    | HalfSpaceData
    | PolygonData
    | StateActionData
    | OccupancyData
    | PredicateData
    | UnionData
)
