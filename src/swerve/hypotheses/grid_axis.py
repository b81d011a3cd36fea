"""Number the cells along one axis of a regular grid, also where an angle wraps.

    index = e    where    line e <= x < line e + 1,    line e = low + e width

Lines are edges, judged as `constraints.edges` says. Indices go on beyond the ends of the grid, so
that the difference of two indices is the number of lines between them.

Shapes: S segments, n state dimensions.
"""

from __future__ import annotations

import math

import numpy as np

from swerve.base.space import RESOLUTION, TWO_PI, StateSpace, is_full_turn
from swerve.constraints.edges import TURNS, ZERO, blur, coordinate, fine, near_zero, part, threshold


def grid_lines(low: float, high: float, count: int) -> np.ndarray:
    """Return the count + 1 lines of a grid; a range of about a full turn ends exactly there."""
    lines = low + np.arange(count + 1) * ((high - low) / count)
    if math.isclose(high - low, TWO_PI, rel_tol=RESOLUTION):
        lines[-1] = low + TWO_PI
    return lines


class GridAxis:
    """One axis of a grid, with cells of equal width; indices go on beyond both ends.

    A number of extended index e lies between line e and line e + 1. On a straight axis, e is -1
    below the grid and `count` above the grid. On the axis of an angle, each turn adds `period`
    indices: `count` for the cells and, unless the cells fill the turn, one for the gap.

    Args:
      space: state space.
      name: the state.
      low: first line.
      high: last line.
      count: number of cells.
      overlap: number of cells along this axis that a hypothesis consists of.
    """

    def __init__(
        self, space: StateSpace, name: str, low: float, high: float, count: int, overlap: int
    ) -> None:
        self._space, self._name, self.count = space, name, count
        self.column = space.column(name)
        self.is_angle = name in space.angles
        if self.is_angle:
            low, high = near_zero(low, high)
        self.width = (high - low) / count
        resolution = fine(space.resolution[self.column], overlap * self.width)
        self.period = count if self.is_angle and is_full_turn(low, high) else count + 1
        self._low = low - resolution
        lines = grid_lines(low, high, count)
        if self.is_angle:
            lines = (TURNS[:, None] + lines[: self.period]).ravel()
        self._first = -ZERO * self.period if self.is_angle else 0  # number of the first line
        ends = [] if self.is_angle else [np.inf]
        lines = np.concatenate([np.negative(ends), lines, ends])
        self._lines = threshold(lines, resolution).astype(float)
        self._blur = blur(lines, resolution)

    @property
    def lines(self) -> tuple[list[float], int]:
        """The thresholds of all lines in ascending order, and the number of the first line."""
        inner = self._lines if self.is_angle else self._lines[1:-1]
        return inner.tolist(), self._first

    def values(self, states: np.ndarray) -> np.ndarray:
        """Return the numbers [...] of states [..., n] that are compared with the lines."""
        return coordinate(states, self._space, self._name).astype(np.float64)

    def index(self, values: np.ndarray) -> np.ndarray:
        """Return the extended index [...] of numbers [...].

        Arithmetic gives the index or a neighbour; comparisons with the lines decide.
        """
        if self.is_angle:
            turn = np.floor((values - self._low) / TWO_PI)
            within = np.floor((values - self._low - turn * TWO_PI) / self.width)
            guess = turn * self.period + np.minimum(within, self.period - 1)
            guess = np.clip(guess, self._first + 1, self._first + len(self._lines) - 3)
        else:
            guess = np.clip(np.floor((values - self._low) / self.width), -1, self.count)
        guess = guess.astype(np.int64)
        return guess - (values < self.line(guess)) + (values >= self.line(guess + 1))

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
        missed = self.values(starts) + steps[:, self.column] - self.values(ends)
        return last + np.round(missed / TWO_PI).astype(np.int64) * self.period

    def cell(self, index: np.ndarray) -> np.ndarray:
        """Return the cell of an extended index; results outside 0 to `count` - 1 are not cells."""
        return index % self.period if self.is_angle else index

    def line(self, number: np.ndarray) -> np.ndarray:
        """Return where a grid line lies; on a straight axis, -inf and inf beyond the grid."""
        return self._lines[self._place(number)]

    def is_still(self, steps: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return [S] True where segments that begin in cells of an index stay along this axis."""
        return np.abs(steps[:, self.column]) <= 2.0 * self._blur_of(index, index + 1)

    def _blur_of(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.maximum(self._blur[self._place(low)], self._blur[self._place(high)])

    def _place(self, number: np.ndarray) -> np.ndarray:
        """Return the place of lines in the table; beyond it, the last place."""
        place = number - self._first + (0 if self.is_angle else 1)
        return np.clip(place, 0, len(self._lines) - 1)

    def crossings(
        self, starts: np.ndarray, steps: np.ndarray, first: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (segment, direction, fraction of the segment) of every line crossed.

        Args:
          starts: [S, n] where segments begin.
          steps: [S, n] from starts to ends, along the shorter arc.
          first: [S] extended indices of the starts.
          last: [S] extended indices of the ends.
        """
        count = np.abs(last - first)
        segment = np.repeat(np.arange(len(count)), count)
        order = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
        line = np.minimum(first, last)[segment] + order + 1
        start, step = self.values(starts)[segment], steps[segment, self.column]
        ahead = self.line(line) - start
        fraction = np.divide(ahead, step, out=np.zeros(len(step)), where=step != 0.0)
        return segment, np.sign(last - first)[segment], np.clip(fraction, 0.0, 1.0)

    def part(
        self, starts: np.ndarray, steps: np.ndarray, index: np.ndarray, count: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the part (enter, leave) of each segment that lies deep in cells, see `edges.part`.

        Args:
          starts: [S, n] where segments begin.
          steps: [S, n] from starts to ends, along the shorter arc.
          index: [S] extended index of the first cell for each segment.
          count: the number of cells that are taken together.
        """
        start, step, end = self.values(starts), steps[:, self.column], index + count
        return part(start, step, self.line(index), self.line(end), self._blur_of(index, end))
