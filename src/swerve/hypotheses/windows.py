"""Judge hypotheses that are overlapping windows: boxes of one size, slid by a part of a side.

Whether a regular grid finds an obstacle depends on where the grid lines are. Windows of side w,
moved by w / k along each axis, fit an obstacle to within w / 2k wherever the obstacle is. A window
consists of k cells of side w / k along every axis, and the cells are judged as a grid:

    window i is entered    where one of the cells i, ..., i + k - 1 is entered.

Shapes: N trajectories, d axes, F cells, H windows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import whole_number
from swerve.base.space import RESOLUTION, TWO_PI, Actions, StateSpace
from swerve.hypotheses.bits import no_bits, pack, set_pairs, unpack
from swerve.hypotheses.grid import BoxHypotheses, GridHypotheses, Pieces, checked_range
from swerve.hypotheses.grid_axis import GridAxis, grid_lines

AT_ONCE = 1 << 22  # pairs of a trajectory and a cell judged at a time: bounds the memory
ROUNDING = 1e-9  # share of a stride: errors of sums of widths up to this one are rounding


class WindowHypotheses(BoxHypotheses):
    """Overlapping windows over some of the states; made by `windows`.

    The last named state varies fastest. A window lies within [low, high] of every axis; where the
    strides fill the full turn of an angle, windows continue across the ends.
    """

    def __init__(self, axes: dict[str, tuple[float, float, float]], overlap: int) -> None:
        self.overlap = whole_number(overlap, "windows: overlap", 1)
        if not axes:
            raise ValueError(
                "windows: expected at least one axis, as in windows(x=(0.0, 10.0, 0.75))"
            )
        self.axes = {name: _checked_axis(name, axis) for name, axis in axes.items()}
        cells = {}
        for name, (low, high, width) in self.axes.items():
            count = math.floor((high - low) / width * self.overlap + ROUNDING)
            cells[name] = (low, low + count * width / self.overlap, count)
        self._cells = GridHypotheses(cells, self.overlap)
        self._goes_round = [
            math.isclose(high - low, TWO_PI, rel_tol=RESOLUTION)
            for low, high, _ in self._cells.axes.values()
        ]
        self.shape = tuple(
            count if goes_round else count - self.overlap + 1
            for count, goes_round in zip(self._cells.shape, self._goes_round, strict=True)
        )

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where an axis names no state, or spans 2 pi but is not an angle."""
        self._cells.check(space, action_names)
        for name, goes_round in zip(self.axes, self._goes_round, strict=True):
            if goes_round and name not in space.angles:
                raise ValueError(
                    f"windows: {name!r} has the range of a full turn, 2 pi, but is no angle: make "
                    "the range a little wider"
                )

    def edges(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return for each axis the low ends and the high ends of its windows."""
        ends = {}
        for (name, (low, high, count)), num in zip(
            self._cells.axes.items(), self.shape, strict=True
        ):
            lines = grid_lines(low, high, count)
            if num == count:  # windows continue across the ends of a full turn
                lines = np.append(lines, lines[1:] + TWO_PI)
            ends[name] = (lines[:num], lines[self.overlap : self.overlap + num])
        return ends

    def violations(
        self,
        states: np.ndarray,
        space: StateSpace,
        between_states: bool,
        actions: Actions | None = None,
    ) -> np.ndarray:
        """Return packed bits [N, ceil(H / 8)]; the cost grows with F and H."""
        cells, bits = no_bits(len(states), len(self._cells)), no_bits(len(states), len(self))
        axes = self._cells.lines(space)
        for pieces in self._cells.judge(cells, states, space, between_states):
            self._set_around(bits, axes, pieces)
        size = max(1, AT_ONCE // len(self._cells))
        for first in range(0, len(states), size):
            entered = unpack(cells[first : first + size], len(self._cells))
            windows = self._dilated(entered.reshape(-1, *self._cells.shape))
            bits[first : first + size] |= pack(windows.reshape(len(entered), -1))
        return bits

    def _set_around(self, bits: np.ndarray, axes: list[GridAxis], pieces: Pieces) -> None:
        """Set the bits of windows that segments enter by pieces too shallow to enter a cell.

        Such a piece runs along a line between two cells, or cuts a corner off: it may lie deep in a
        window that holds both cells.
        """
        for offset in itertools.product(range(self.overlap), repeat=len(axes)):
            lowest = [index - k for index, k in zip(pieces.indices, offset, strict=True)]
            place = [axis.cell(index) for axis, index in zip(axes, lowest, strict=True)]
            shape = np.reshape(self.shape, (-1, 1))
            entered = pieces._replace(indices=lowest).are_deep(axes, self.overlap)
            entered &= ((np.array(place) >= 0) & (np.array(place) < shape)).all(axis=0)
            window = np.ravel_multi_index([along[entered] for along in place], self.shape)
            set_pairs(bits, pieces.trajectory[entered], window)

    def _dilated(self, entered: np.ndarray) -> np.ndarray:
        """Return [N, ...] True for windows that hold one of the entered cells [N, ...]."""
        for axis, num in enumerate(self.shape, start=1):
            if self._goes_round[axis - 1]:
                entered = np.concatenate(
                    [entered, entered.take(range(self.overlap - 1), axis=axis, mode="wrap")], axis
                )
            parts = np.moveaxis(entered, axis, 0)
            together = parts[:num].copy()
            for k in range(1, self.overlap):
                together |= parts[k : k + num]
            entered = np.moveaxis(together, 0, axis)
        return entered

    def best_of_cells(self, values: np.ndarray) -> tuple[GridHypotheses, np.ndarray]:
        """Return the cells of the windows, and for each cell the largest value [F] of its windows.

        Args:
          values: [H] a number for each window.
        """
        best = values.reshape(self.shape)
        for axis, goes_round in enumerate(self._goes_round):
            rows = np.moveaxis(best, axis, 0)
            edge = np.full((self.overlap - 1, *rows.shape[1:]), -np.inf)
            before = rows[len(rows) - self.overlap + 1 :] if goes_round else edge
            rows = np.concatenate([before, rows] if goes_round else [edge, rows, edge])
            num = len(rows) - self.overlap + 1
            holding = [rows[k : k + num] for k in range(self.overlap)]
            best = np.moveaxis(np.max(holding, axis=0), 0, axis)
        return self._cells, best.ravel()

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        axes = {name: list(axis) for name, axis in self.axes.items()}
        return {"kind": "windows", "axes": axes, "overlap": self.overlap}


def windows(overlap: int = 4, /, **axes: Any) -> WindowHypotheses:
    """Make hypotheses of overlapping windows of one size, slid along every axis.

    Args:
      overlap: k, the number of strides in the width of a window: a stride is width / k. It may be
        given by name: a single number is never the axis of a state, whatever the state's name.
      **axes: for each state (low, high, width), in that state's unit. Windows lie within [low,
        high], the first at low; a rest shorter than a stride at the high end is in no window. Where
        strides fill the full turn of an angle, windows continue across the ends.

    Returns:
      Hypotheses numbered with the last axis fastest.

    Raises:
      ValueError: if there is no axis, low >= high, or a width is not above 0 and within the range.
    """
    given = axes.get("overlap", ())
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
        overlap = axes.pop("overlap")
    return WindowHypotheses(axes, overlap)


def _checked_axis(name: str, axis: Sequence[float]) -> tuple[float, float, float]:
    low, high, width = checked_range("windows", name, axis, "width")
    if not 0.0 < width <= (high - low) * (1.0 + ROUNDING):
        raise ValueError(
            f"windows: expected a width above 0 and at most {high - low:g}, the range of {name!r}, "
            f"got {axis[2]!r}"
        )
    return low, high, width
