"""Number the cells along one axis of a regular grid, also where an angle wraps.

    index = floor((x - low) / width)

Indices go on beyond the ends of the grid, so that the difference of two indices is the number of
lines between them.

Shapes: S segments, n state dimensions.
"""

from __future__ import annotations

import numpy as np

from swerve.base.space import TWO_PI, is_full_turn


class GridAxis:
    """One axis of a grid, with cells of equal width; indices go on beyond both ends.

    A position of extended index e lies between line e and line e + 1. On a straight axis, e is -1
    below the grid and `count` above the grid. On the axis of an angle, each turn adds `period`
    indices: `count` for the cells and, unless the cells fill the turn, one for the gap.
    """

    def __init__(self, column: int, low: float, high: float, count: int, is_angle: bool) -> None:
        self.column, self.low, self.count, self.is_angle = column, low, count, is_angle
        self.width = (high - low) / count
        self.period = count if is_angle and is_full_turn(low, high) else count + 1

    def position(self, states: np.ndarray) -> np.ndarray:
        """Return how far [...] states [..., n] lie above the low end; in [0, 2 pi) for angles."""
        position = states[..., self.column] - self.low
        return position % TWO_PI if self.is_angle else position

    def index(self, position: np.ndarray) -> np.ndarray:
        """Return the extended index [...] of positions [...]."""
        if not self.is_angle:
            return np.clip(np.floor(position / self.width), -1, self.count).astype(np.int64)
        turn = np.floor(position / TWO_PI)
        within = np.floor((position - turn * TWO_PI) / self.width)
        return (turn * self.period + np.minimum(within, self.period - 1)).astype(np.int64)

    @property
    def has_gap(self) -> bool:
        """Whether the cells of an angle leave a gap: a step can leave and re-enter a cell."""
        return self.is_angle and self.period > self.count

    def in_gap(self, index: np.ndarray) -> np.ndarray:
        """Return True where an extended index is that of the gap of an angle."""
        return index % self.period >= self.count

    def turned(
        self, last: np.ndarray, starts: np.ndarray, ends: np.ndarray, steps: np.ndarray
    ) -> np.ndarray:
        """Return the extended indices [S] of the ends of segments, counted on from their starts.

        An end's cell follows from the end itself, since start + step may be rounded to the other
        side of a line.

        Args:
          last: [S] extended indices of the ends.
          starts: [S, n] where segments begin.
          ends: [S, n] where segments end.
          steps: [S, n] from starts to ends, along the shorter arc.
        """
        if not self.is_angle:
            return last
        missed = self.position(starts) + steps[:, self.column] - self.position(ends)
        return last + np.round(missed / TWO_PI).astype(np.int64) * self.period

    def cell(self, index: np.ndarray) -> np.ndarray:
        """Return the cell of an extended index; results outside 0 to `count` - 1 are not cells."""
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
          starts: [S, n] where segments begin.
          steps: [S, n] from starts to ends, along the shorter arc.
          first: [S] extended indices of the starts.
          last: [S] extended indices of the ends.
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

        A line met exactly at the fraction counts as crossed. So a cell that is only touched at a
        corner is not entered, as with boxes.
        """
        position = self.position(starts) + fraction * steps[:, self.column]
        index = self.index(position)
        index -= (last < first) & (self.line(index) >= position)
        return np.clip(index, np.minimum(first, last), np.maximum(first, last))
