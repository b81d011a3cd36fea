"""One axis of a regular grid of cells: index arithmetic, also where an angle wraps.

    index = floor((x - low) / width)

Indices go on beyond the ends of the grid, so that the difference of two of them counts the lines
between them.

Shapes: S segments, n state dimensions.
"""

from __future__ import annotations

import numpy as np

from swerve.base.space import TWO_PI, is_full_turn


class GridAxis:
    """One axis of a grid: cells of equal width, numbered beyond the ends too.

    Index e of a position lies between line e and line e + 1. On a straight axis e is -1 below and
    `count` above. An angle goes on for ever: each turn adds `period` indices, `count` cells and,
    unless they fill the circle, one gap.
    """

    def __init__(self, column: int, low: float, high: float, count: int, is_angle: bool) -> None:
        self.column, self.low, self.count, self.is_angle = column, low, count, is_angle
        self.width = (high - low) / count
        self.period = count if is_angle and is_full_turn(low, high) else count + 1

    def position(self, states: np.ndarray) -> np.ndarray:
        """Return [...] the distance above the low end; for angles in [0, 2 pi)."""
        position = states[..., self.column] - self.low
        return position % TWO_PI if self.is_angle else position

    def index(self, position: np.ndarray) -> np.ndarray:
        """Return the extended index of a position."""
        if not self.is_angle:
            return np.clip(np.floor(position / self.width), -1, self.count).astype(np.int64)
        turn = np.floor(position / TWO_PI)
        within = np.floor((position - turn * TWO_PI) / self.width)
        return (turn * self.period + np.minimum(within, self.period - 1)).astype(np.int64)

    @property
    def has_gap(self) -> bool:
        """Whether it is an angle of which cells leave some open: one step may leave and enter."""
        return self.is_angle and self.period > self.count

    def in_gap(self, index: np.ndarray) -> np.ndarray:
        """Return where an index is the gap of an angle that has one."""
        return index % self.period >= self.count

    def turned(
        self, last: np.ndarray, starts: np.ndarray, ends: np.ndarray, steps: np.ndarray
    ) -> np.ndarray:
        """Return the extended indices [S] of the ends of segments, counted on from their starts.

        The end itself tells its index: start + step may be rounded to the other side of a line.

        Args:
          last: [S] extended indices of the ends.
          starts: [S, n] where segments begin.
          ends: [S, n] where they end.
          steps: [S, n] how far they go, along the shorter arc.
        """
        if not self.is_angle:
            return last
        missed = self.position(starts) + steps[:, self.column] - self.position(ends)
        return last + np.round(missed / TWO_PI).astype(np.int64) * self.period

    def cell(self, index: np.ndarray) -> np.ndarray:
        """Return the cell number of an extended index; not from 0 to `count` - 1: none."""
        return index % self.period if self.is_angle else index

    def line(self, number: np.ndarray) -> np.ndarray:
        """Return the position of a grid line."""
        if not self.is_angle:
            return number * self.width
        return number // self.period * TWO_PI + number % self.period * self.width

    def crossings(
        self, starts: np.ndarray, steps: np.ndarray, first: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (segment, index entered, fraction of the segment) of every line crossed.

        Args:
          starts: where the segments begin.
          steps: how far they go.
          first: [S] extended indices where they begin.
          last: [S] extended indices where they end.
        """
        count = np.abs(last - first)
        segment = np.repeat(np.arange(len(count)), count)
        order = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
        entered = np.minimum(first, last)[segment] + order
        entered += (last > first)[segment]
        line = entered + (last < first)[segment]
        position, step = self.position(starts)[segment], steps[segment, self.column]
        ahead = self.line(line) - position
        fraction = np.divide(ahead, step, out=np.zeros(len(step)), where=step != 0.0)
        return segment, entered, np.clip(fraction, 0.0, 1.0)

    def index_after(
        self,
        starts: np.ndarray,
        steps: np.ndarray,
        fraction: np.ndarray,
        first: np.ndarray,
        last: np.ndarray,
    ) -> np.ndarray:
        """Return the extended index just after a fraction of segments from index first to last.

        A line that is met at that very point counts as crossed, so that a corner that is only
        touched is not entered, as with boxes.
        """
        position = self.position(starts) + fraction * steps[:, self.column]
        index = self.index(position)
        index -= (last < first) & (self.line(index) >= position)
        return np.clip(index, np.minimum(first, last), np.maximum(first, last))
