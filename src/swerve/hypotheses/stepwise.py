"""Judging a trajectory state by state: which hypotheses its newest segment enters.

On a grid a segment that crosses no grid line enters nothing new, and one that crosses a single
line enters the cell where it ends, so that most states take a few operations on single numbers. The
others are judged as whole trajectories are (see `hypotheses`), and so is whatever is no grid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.base import violates
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses
from swerve.hypotheses.grid_axis import GridAxis


class Steps(Protocol):
    """What judges a trajectory whose states come one by one."""

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the hypotheses that the way from the last state to this one enters."""
        ...


def stepwise(
    hypotheses: HypothesisSet,
    judged: HypothesisSet,
    space: StateSpace,
    between_states: bool,
) -> Steps:
    """Return what judges one trajectory, from its first state on.

    Args:
      hypotheses: what it may enter.
      judged: what a margin leaves of them; they themselves without one.
      space: what the states are.
      between_states: whether the segments between states count as well.
    """
    if not isinstance(hypotheses, GridHypotheses):
        return WholeSteps(judged, space, between_states)
    whole = WholeSteps(hypotheses, space, between_states)
    steps = GridSteps(hypotheses, space, whole)
    return steps if judged is hypotheses else ErodedSteps(steps, judged, space, between_states)


class WholeSteps:
    """Judges each segment as a trajectory of two states."""

    def __init__(self, hypotheses: HypothesisSet, space: StateSpace, between_states: bool) -> None:
        self.hypotheses, self.space, self.between_states = hypotheses, space, between_states
        self._last: list[float] | None = None

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the hypotheses that the way from the last state to this one enters."""
        last, self._last = self._last, list(state)
        return self.segment([last or state, state] if self.between_states else [state])

    def segment(self, states: list[list[float]]) -> Sequence[int]:
        """Return the hypotheses that one or two states, and the way between them, enter."""
        path = np.array(states)[None]
        bits = self.hypotheses.violations(path, self.space, self.between_states)
        return np.flatnonzero(unpack(bits[0], len(self.hypotheses))).tolist()


class GridSteps:
    """Judges by the extended indices of the last state along each axis, see `GridAxis`."""

    def __init__(self, hypotheses: GridHypotheses, space: StateSpace, whole: WholeSteps) -> None:
        self._whole = whole
        self._axes = [
            GridAxis(space.column(name), low, high, count, name in space.angles)
            for name, (low, high, count) in hypotheses.axes.items()
        ]
        self._state: list[float] = []
        self._places: list[tuple[float, int]] = []

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the cells that the way from the last state to this one enters."""
        places = [_place(axis, state[axis.column]) for axis in self._axes]
        last, before = self._state, self._places
        self._state, self._places = list(state), places
        if before:
            crossed = sum(
                _crossed(axis, state[axis.column] - last[axis.column], old, new)
                for axis, old, new in zip(self._axes, before, places, strict=True)
            )
            if crossed == 0:
                return ()
            if crossed > 1 and self._whole.between_states:
                return self._whole.segment([last, state])
        cell = 0
        for axis, (_, index) in zip(self._axes, places, strict=True):
            within = index % axis.period if axis.is_angle else index
            if not 0 <= within < axis.count:
                return ()
            cell = cell * axis.count + within
        return (cell,)


class ErodedSteps:
    """Judges what a margin leaves of the cells of a grid: only where the cells are is any of it."""

    def __init__(
        self, cells: GridSteps, left: HypothesisSet, space: StateSpace, between_states: bool
    ) -> None:
        self._cells, self._left, self._space = cells, left, space
        self._between_states = between_states
        self._around: tuple[int, ...] = ()  # the cell of the last state is one of these
        self._last: list[float] | None = None

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the cells into whose rest the way from the last state to this one leads."""
        last, self._last = self._last, list(state)
        crossed = tuple(self._cells.enter(state))
        path = np.array([last or state, state] if self._between_states else [state])
        candidates = dict.fromkeys((*self._around, *crossed))
        self._around = crossed or self._around
        return [
            k
            for k in candidates
            if violates(self._left.constraint(k), path, self._space, self._between_states)
        ]


def _place(axis: GridAxis, value: float) -> tuple[float, int]:
    """Return position and extended index of a number, as `GridAxis` does of arrays."""
    position = value - axis.low
    if not axis.is_angle:
        return position, min(max(math.floor(position / axis.width), -1), axis.count)
    position %= TWO_PI
    turn = math.floor(position / TWO_PI)  # 1 where a tiny negative number is rounded to a turn
    within = math.floor((position - turn * TWO_PI) / axis.width)
    return position, turn * axis.period + min(within, axis.period - 1)


def _crossed(axis: GridAxis, moved: float, old: tuple[float, int], new: tuple[float, int]) -> int:
    """Return how many lines of an axis a move crosses, along the shorter arc of an angle."""
    (first, first_index), (last, last_index) = old, new
    if axis.is_angle:
        moved -= TWO_PI * round(moved / TWO_PI)
        last_index += round((first + moved - last) / TWO_PI) * axis.period
    return abs(last_index - first_index)
