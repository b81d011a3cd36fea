"""Constraints as convex obstacles, each separated by a plane from every step of a path.

A convex set and a segment from x to y have no point in common if there are weights l of the set's
sides with

    {z: A z < b}:    l^T (A x - b) >= 0,    l^T (A y - b) >= 0,    l >= 0,    sum l = 1,
    |z - c| < r:     l^T (x - c)   >= r,    l^T (y - c)   >= r,    |l| <= 1.

The solver finds the weights of each step, so a path may pass a corner at any time, and avoids the
set between two of its states too (Zhang, Liniger and Borrelli, IEEE T-CST 2021).

Shapes: T steps, n state dimensions, m action dimensions, F sides, k dimensions of an obstacle.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from swerve.base.space import TWO_PI, StateSpace, is_full_turn
from swerve.constraints.base import Constraint
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.polygon_geometry import triangles
from swerve.constraints.polygons import Polygon
from swerve.constraints.shapes import Ball, HalfSpace
from swerve.constraints.state_action import StateAction

UNUSED = 0.02  # weight, in guesses, of sides that do not separate: above 0, the lower bound
PUSH = 1.1  # factor on the distance to a side, by which guesses are pushed out of an obstacle


class Path(NamedTuple):
    """States and the actions between them.

    Attributes:
      states: [T+1, n], angles not wrapped.
      actions: [T, m].
    """

    states: np.ndarray
    actions: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """[T, 2, n + m] both states of each step, each with the action between them."""
        ends = np.stack([self.states[:-1], self.states[1:]], axis=1)
        actions = np.broadcast_to(self.actions[:, None], (*ends.shape[:2], self.actions.shape[1]))
        return np.concatenate([ends, actions], axis=2)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A convex set of states, of actions, or of both together.

    Attributes:
      columns: [k] columns that bound the set, of the n states and the m actions after them.
      normal: [F, k] the sides A, of length 1 in the units of `obstacles_of`; 1 for balls.
      offset: [F] b, or the centre of a ball.
      radius: radius of a ball; 0 for a set with sides.
      angles: (column, low, high) of the angles among the columns; the set repeats every full turn.
      on_segments: whether the set is of states alone: then it is avoided between states too.
    """

    columns: tuple[int, ...]
    normal: np.ndarray
    offset: np.ndarray
    radius: float = 0.0
    angles: tuple[tuple[int, float, float], ...] = ()
    on_segments: bool = True

    @property
    def kind(self) -> tuple:
        """Everything but the place of the set: obstacles of one kind share a solver."""
        return (self.columns, self.normal.tobytes(), self.radius, self.on_segments)

    def images(self, low: np.ndarray, high: np.ndarray) -> list[Obstacle]:
        """Return the obstacle at every full turn where states from low to high [n] may enter it."""
        turns = [
            range(math.ceil((low[k] - last) / TWO_PI), math.floor((high[k] - first) / TWO_PI) + 1)
            for k, first, last in self.angles
        ]
        found = []
        for counts in itertools.product(*turns):
            by = np.zeros(len(self.columns))
            for (column, *_), count in zip(self.angles, counts, strict=True):
                by[self.columns.index(column)] = TWO_PI * count
            found.append(replace(self, offset=self.offset + self.normal @ by))
        return found

    def weights(self, path: Path) -> np.ndarray:
        """Return weights [T, F] that separate each step of a path from the set, where any do."""
        beyond = self._beyond(path.steps)
        if self.radius > 0.0:
            middle = beyond.mean(axis=1)
            return middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
        weights = np.full((len(beyond), len(self.offset)), UNUSED)
        weights[np.arange(len(beyond)), beyond.min(axis=1).argmax(axis=1)] = 1.0
        return weights / weights.sum(axis=1, keepdims=True)

    def pushed(self, path: Path) -> Iterator[Path]:
        """Yield, for each side of the set, the path with its entering steps moved out past it."""
        last = path.actions[-1:]
        points = np.concatenate([path.states, np.concatenate([path.actions, last])], axis=1)
        beyond, num_states = self._beyond(points), path.states.shape[1]
        entering = self._enter(beyond)
        if not entering.any():
            return
        sides, gaps = self.normal, -beyond
        if self.radius > 0.0:
            sides = np.concatenate([self.normal, -self.normal])
            gaps = self.radius - np.concatenate([beyond, -beyond], axis=1)
        for side, gap in zip(sides, gaps.T, strict=True):
            moved = points.copy()
            step = np.outer(PUSH * np.where(entering, gap.clip(0.0), 0.0), side / (side @ side))
            moved[:, list(self.columns)] += step
            yield Path(moved[:, :num_states], moved[:-1, num_states:])

    def _enter(self, beyond: np.ndarray) -> np.ndarray:
        """Return whether each point [T+1] enters the set, by its distance beyond sides [T+1, F].

        Where steps between states count, both ends of a step through the set enter it.
        """
        begin, along = beyond, np.zeros_like(beyond)
        if self.on_segments:
            begin, along = beyond[:-1], np.diff(beyond, axis=0)
        if self.radius > 0.0:
            share = -(begin * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
            nearest = begin + share.clip(0.0, 1.0)[:, None] * along
            passing = np.linalg.norm(nearest, axis=1) < self.radius
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                share = -begin / along
            out = np.where((along == 0.0) & (begin >= 0.0), 2.0, 0.0)
            low = np.where(along < 0.0, share, out).max(axis=1).clip(0.0)
            passing = low < np.where(along > 0.0, share, 1.0).min(axis=1).clip(max=1.0)
        if not self.on_segments:
            return passing
        return np.append(passing, False) | np.append(False, passing)

    def _beyond(self, points: np.ndarray) -> np.ndarray:
        """Return the distances [..., F] of points [..., n + m] beyond each side."""
        return points[..., list(self.columns)] @ self.normal.T - self.offset


def obstacles_of(
    constraint: Constraint, space: StateSpace, action_names: tuple[str, ...], unit: np.ndarray
) -> list[Obstacle]:
    """Return convex sets that together make up a constraint.

    Args:
      constraint: the constraint to avoid.
      space: the state space.
      action_names: the m names of the actions.
      unit: [n + m] units that distances to sides are measured in.

    Raises:
      ValueError: if the sides of a part are unknown, as for predicates and maps.
    """
    found = []
    for part in constraint.parts:
        if isinstance(part, StateAction):
            (action,) = _convex(part.actions, space, action_names, unit)
            states = obstacles_of(part.states, space, action_names, unit)
            found += [_both(state, action) for state in states]
        else:
            found += _convex(part, space, action_names, unit)
    return found


def _convex(
    part: Constraint, space: StateSpace, action_names: tuple[str, ...], unit: np.ndarray
) -> list[Obstacle]:
    """Return the convex sets that make up a constraint other than a union."""
    names = (*space.names, *action_names)
    if isinstance(part, Box):
        rows = [
            row
            for name, (low, high) in part.intervals.items()
            if not (name in space.angles and is_full_turn(low, high))
            for row in (({name: 1.0}, high), ({name: -1.0}, -low))
        ]
        return [replace(_sides(rows, names, unit), angles=_angles(part, space))]
    if isinstance(part, ActionBox):
        rows = [
            row
            for name, (low, high) in part.intervals.items()
            for row in (({name: 1.0}, high), ({name: -1.0}, -low))
        ]
        return [replace(_sides(rows, names, unit), on_segments=False)]
    if isinstance(part, HalfSpace):
        row = ({name: -value for name, value in part.normal.items()}, -part.offset)
        return [_sides([row], names, unit)]
    if isinstance(part, Polygon) and part.depth == 0.0:
        corners = triangles(part.vertices)
        return [_sides(_edge_rows(three, part.names), names, unit) for three in corners]
    if isinstance(part, Ball):
        columns = tuple(names.index(name) for name in part.centre)
        centre, identity = np.array(list(part.centre.values())), np.eye(len(columns))
        return [Obstacle(columns, identity, centre, part.radius, _angles(part, space))]
    raise ValueError(
        f"{part.name}: expected a constraint with sides that a path can be led around, such as "
        f"Box, Ball, HalfSpace or Polygon without a depth, got {type(part).__name__}"
    )


def _angles(part: Box | Ball, space: StateSpace) -> tuple[tuple[int, float, float], ...]:
    """Return column, low and high of the angles that bound a set."""
    return tuple(
        (space.column(name), low, high)
        for name, (low, high) in part.spans.items()
        if name in space.angles and (isinstance(part, Ball) or not is_full_turn(low, high))
    )


def _sides(
    rows: list[tuple[dict[str, float], float]], names: tuple[str, ...], unit: np.ndarray
) -> Obstacle:
    """Return {z: a^T z < b for each row (a, b)}, each divided by the length of a times the unit."""
    rows = [(row, limit) for row, limit in rows if math.isfinite(limit)]
    if not rows:
        raise ValueError(
            "constraint: expected one that allows something, got one that forbids everything"
        )
    columns = tuple(sorted({names.index(name) for row, _ in rows for name in row}))
    normal, offset = np.zeros((len(rows), len(columns))), np.zeros(len(rows))
    for k, (row, limit) in enumerate(rows):
        for name, value in row.items():
            normal[k, columns.index(names.index(name))] = value
        length = np.linalg.norm(normal[k] * unit[list(columns)])
        normal[k] /= length
        offset[k] = limit / length
    return Obstacle(columns, normal, offset)


def _edge_rows(corners: np.ndarray, names: tuple[str, str]) -> list[tuple[dict[str, float], float]]:
    """Return the sides of a triangle [3, 2] with corners in anticlockwise order."""
    rows = []
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outward = np.array([end[1] - begin[1], begin[0] - end[0]])
        rows.append((dict(zip(names, outward.tolist(), strict=True)), float(outward @ begin)))
    return rows


def _both(states: Obstacle, action: Obstacle) -> Obstacle:
    """Return the set of states in one set together with actions in another."""
    if states.radius > 0.0:
        raise ValueError(
            "expected states with straight sides where actions are forbidden in some states only, "
            "got a ball: use a Box or a Polygon"
        )
    split = len(states.columns)
    normal = np.zeros((len(states.offset) + len(action.offset), split + len(action.columns)))
    normal[: len(states.offset), :split] = states.normal
    normal[len(states.offset) :, split:] = action.normal
    offset = np.concatenate([states.offset, action.offset])
    columns = (*states.columns, *action.columns)
    return Obstacle(columns, normal, offset, 0.0, states.angles, False)
