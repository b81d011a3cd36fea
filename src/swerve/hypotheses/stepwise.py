"""Judge a trajectory state by state: tell which hypotheses its newest step enters.

On a grid, a segment that crosses no grid line enters no new cell, and a segment that crosses a
single line enters the cell of its end. So most states need only a few operations on single numbers.
All other segments, and hypotheses other than grids, are judged as a trajectory of two states.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from swerve.base.space import MAX_TURNS, TWO_PI, StateSpace, single
from swerve.constraints.base import step_enters
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses
from swerve.hypotheses.grid_axis import GridAxis


class Steps(Protocol):
    """Judges a trajectory whose states come one by one."""

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the hypotheses that the step from the last state to this state enters."""
        ...


def stepwise(
    hypotheses: HypothesisSet,
    judged: HypothesisSet,
    space: StateSpace,
    between_states: bool,
) -> Steps:
    """Return an object that judges one trajectory, from its first state on.

    Args:
      hypotheses: hypotheses of the problem.
      judged: the hypotheses less a margin; without a margin, the same object as `hypotheses`.
      space: names, angles and bounds of the states.
      between_states: whether the segments between states count as well.
    """
    if not isinstance(hypotheses, GridHypotheses):
        return WholeSteps(judged, space, between_states)
    whole = WholeSteps(hypotheses, space, between_states)
    steps = GridSteps(hypotheses, space, whole)
    return steps if judged is hypotheses else ErodedSteps(steps, judged, space, between_states)


class WholeSteps:
    """Judges each step as a trajectory of two states."""

    def __init__(self, hypotheses: HypothesisSet, space: StateSpace, between_states: bool) -> None:
        self.hypotheses, self.space, self.between_states = hypotheses, space, between_states
        self._last: list[float] | None = None

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the hypotheses that the step from the last state to this state enters."""
        states = [self._last or state, state] if self.between_states else [state]
        entered = self.segment(states)
        self._last = list(state)  # only once it was judged: code of a user may fail
        return entered

    def segment(self, states: list[list[float]]) -> Sequence[int]:
        """Return the hypotheses that one state, or two states and their segment, enter."""
        path = np.array(states)[None]
        bits = self.hypotheses.violations(path, self.space, self.between_states)
        return np.flatnonzero(unpack(bits[0], len(self.hypotheses))).tolist()


class GridSteps:
    """Judges the cells of a grid by the extended indices of the states, see `GridAxis`."""

    def __init__(self, hypotheses: GridHypotheses, space: StateSpace, whole: WholeSteps) -> None:
        self._whole = whole
        self._axes = hypotheses.lines(space)
        self._lines = [axis.lines for axis in self._axes]
        self._state: list[float] = []
        self._places: list[tuple[float, int]] = []

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the cells that the step from the last state to this state enters."""
        rounded = single(np.array(state)).tolist()
        places = [self._place(k, rounded) for k in range(len(self._axes))]
        last, before = self._state, self._places
        self._state, self._places = rounded, places
        if before:
            crossed = sum(
                _crossed(axis, old, new)
                for axis, old, new in zip(self._axes, before, places, strict=True)
            )
            if crossed == 0:
                return ()
            if crossed > 1 and self._whole.between_states:
                return self._whole.segment([last, rounded])
        cell = 0
        for axis, (_, index) in zip(self._axes, places, strict=True):
            within = index % axis.period if axis.is_angle else index
            if not 0 <= within < axis.count:
                return ()
            cell = cell * axis.count + within
        return (cell,)

    def _place(self, k: int, state: list[float]) -> tuple[float, int]:
        """Return the number along axis k that is compared with its lines, and its index."""
        axis, (lines, first) = self._axes[k], self._lines[k]
        value = state[axis.column]
        if axis.is_angle and abs(value) > MAX_TURNS * TWO_PI:
            value = float(axis.values(np.array(state)))
        return value, bisect_right(lines, value) - 1 + first


class ErodedSteps:
    """Judges the cells of a grid less a margin: only steps that enter a cell can enter its core.

    The core of a cell is the cell less the margin.
    """

    def __init__(
        self, cells: GridSteps, rest: HypothesisSet, space: StateSpace, between_states: bool
    ) -> None:
        self._cells, self._rest, self._space = cells, rest, space
        self._between_states = between_states
        self._around: tuple[int, ...] = ()  # the cell of the last state is among these cells
        self._last: list[float] | None = None

    def enter(self, state: list[float]) -> Sequence[int]:
        """Return the cells whose core the step from the last state to this state enters."""
        last, self._last = self._last, list(state)
        crossed = tuple(self._cells.enter(state))
        start, end = np.array([[last or state], [state]])
        candidates = dict.fromkeys((*self._around, *crossed))
        self._around = crossed or self._around
        return [k for k in candidates if self._is_entered(k, start, end)]

    def _is_entered(self, index: int, start: np.ndarray, end: np.ndarray) -> bool:
        rest = self._rest.constraint(index)
        return bool(step_enters(rest, start, end, self._space, self._between_states)[0])


def _crossed(axis: GridAxis, start: tuple[float, int], end: tuple[float, int]) -> int:
    """Return the number of lines of an axis between two places, angles by the shorter arc."""
    (first, first_index), (last, last_index) = start, end
    if axis.is_angle:
        last_index -= round((last - first) / TWO_PI) * axis.period
    return abs(last_index - first_index)
