"""Judge hypotheses that are the cells of a regular grid, at a cost that does not grow with H.

The cell of a state follows by index arithmetic,

    cell_d = floor((x_d - low_d) / width_d),

and a segment enters a cell between each two grid lines that the segment crosses. Which side of a
line a state is on, and which cells a segment only touches, is the rule of `constraints.edges`: the
cells are judged exactly as the same boxes in a list are. Results are packed as in `bits`.

Shapes: N trajectories, T steps, n state dimensions, d grid dimensions, H hypotheses.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from swerve.base.arguments import numbers
from swerve.base.space import Actions, StateSpace, single, wide
from swerve.constraints.boxes import Box, interval_distance
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.bits import no_bits, set_pairs
from swerve.hypotheses.grid_axis import GridAxis, grid_lines

BLOCK = 1 << 16  # states judged at once, so that intermediate results fit the cache


class BoxHypotheses(HypothesisSet):
    """Boxes of one size in regular order, the last axis fastest: cells of a grid, or windows."""

    shape: tuple[int, ...]
    """The number of boxes along each axis."""

    @abstractmethod
    def edges(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return for each axis the low ends and the high ends of its boxes."""

    def __len__(self) -> int:
        return math.prod(self.shape)

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the axes."""
        return tuple(self.edges())

    def constraint(self, index: int) -> Box:
        """Return hypothesis `index` as a box."""
        self._check_index(index)
        place = np.unravel_index(index, self.shape)
        return Box(
            **{
                name: (float(low[k]), float(high[k]))
                for k, (name, (low, high)) in zip(place, self.edges().items(), strict=True)
            }
        )

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [..., H] from states [..., n] to each box."""
        states = np.asarray(states, float)
        square = np.zeros((*states.shape[:-1], 1))
        for name, (low, high) in self.edges().items():
            values = states[..., space.column(name), None]
            along = interval_distance(values, low, high, name in space.angles) ** 2
            square = square[..., None] + along[..., None, :]
            square = square.reshape(*states.shape[:-1], math.prod(square.shape[-2:]))
        return np.sqrt(square)


class Pieces(NamedTuple):
    """Pieces of segments, each between two grid lines and so in one cell.

    Attributes:
      trajectory: [P] number of the trajectory that each belongs to.
      starts: [P, n] where the whole segment begins.
      steps: [P, n] from the start to the end of the whole segment.
      indices: for each axis, the extended index [P] of the cell.
    """

    trajectory: np.ndarray
    starts: np.ndarray
    steps: np.ndarray
    indices: list[np.ndarray]

    def are_deep(self, axes: Sequence[GridAxis], count: int = 1) -> np.ndarray:
        """Return [P] True where a segment enters the box of `count` cells along each axis.

        The cell of the piece is the lowest of these cells. A segment enters such a box as it enters
        a `Box` with the same edges.
        """
        enter, leave = np.zeros(len(self.trajectory)), np.ones(len(self.trajectory))
        for axis, index in zip(axes, self.indices, strict=True):
            one_enters, one_leaves = axis.part(self.starts, self.steps, index, count)
            enter, leave = np.maximum(enter, one_enters), np.minimum(leave, one_leaves)
        return leave > enter

    def among(self, chosen: np.ndarray) -> Pieces:
        """Return some of the pieces."""
        indices = [index[chosen] for index in self.indices]
        return Pieces(self.trajectory[chosen], self.starts[chosen], self.steps[chosen], indices)


class GridHypotheses(BoxHypotheses):
    """The cells of a regular grid over some of the states; made by `grid`.

    The last named state varies fastest: with axes theta and omega of 10 cells each,
    cell = 10 * theta_index + omega_index.

    Args:
      axes: (low, high, number of cells) by state.
      overlap: number of cells along each axis of the regions that the cells make up: the edges are
        those of the regions.
    """

    def __init__(self, axes: dict[str, tuple[float, float, int]], overlap: int = 1) -> None:
        if not axes:
            raise ValueError("grid: expected at least one axis, as in grid(x=(0.0, 1.0, 10))")
        self.axes = {name: _checked_axis(name, axis) for name, axis in axes.items()}
        self._overlap = overlap
        self.shape = tuple(cells for _, _, cells in self.axes.values())

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where an axis names no state, or an axis of an angle exceeds a turn."""
        self._bounding_box().check(space, action_names)

    def _bounding_box(self) -> Box:
        return Box(**{name: (low, high) for name, (low, high, _) in self.axes.items()})

    def cells(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the cell [...] of each state [..., n], or -1 outside the grid."""
        axes = self.lines(space)
        return _join(axes, [axis.index(axis.values(states)) for axis in axes])

    def violations(
        self,
        states: np.ndarray,
        space: StateSpace,
        between_states: bool,
        actions: Actions | None = None,
    ) -> np.ndarray:
        """Return packed bits [N, ceil(H / 8)]; the cost grows with lines crossed, not with H."""
        bits = no_bits(len(states), len(self))
        for _ in self.judge(bits, states, space, between_states):
            pass
        return bits

    def judge(
        self, bits: np.ndarray, states: np.ndarray, space: StateSpace, between_states: bool
    ) -> Iterator[Pieces]:
        """Set the bits of the cells that trajectories [N, T+1, n] enter, block by block.

        Yields:
          After each block, the pieces of segments that are in cells without entering them.
        """
        size = max(1, BLOCK // states.shape[1])
        for first in range(0, len(states), size):
            block = wide(single(np.asarray(states[first : first + size])))
            for pieces in self._judge(bits[first : first + size], block, space, between_states):
                yield pieces._replace(trajectory=pieces.trajectory + first)

    def _judge(
        self, bits: np.ndarray, states: np.ndarray, space: StateSpace, between_states: bool
    ) -> Iterator[Pieces]:
        """Set the bits of the cells that a block of trajectories enters; see `judge`."""
        axes = self.lines(space)
        indices = [axis.index(axis.values(states)) for axis in axes]
        moved = np.ones(states.shape[:-1], bool)
        moved[:, 1:] = False
        for axis, index in zip(axes, indices, strict=True):
            moved[:, 1:] |= index[:, 1:] != index[:, :-1]
            if axis.has_gap:
                moved[:, 1:] |= axis.in_gap(index[:, :-1])
        _set_cells(bits, np.nonzero(moved)[0], _join(axes, [index[moved] for index in indices]))
        if between_states:
            trajectory, step = np.nonzero(moved[:, 1:])
            starts, ends = states[trajectory, step], states[trajectory, step + 1]
            steps = space.difference(starts, ends)
            spans = []
            for axis, index in zip(axes, indices, strict=True):
                first = index[trajectory, step]
                last = axis.turned(index[trajectory, step + 1], starts, ends, steps)
                spans.append((first, last))
            segment, indices = _crossed_cells(axes, starts, steps, spans)
            pieces = Pieces(trajectory[segment], starts[segment], steps[segment], indices)
            deep = pieces.are_deep(axes)
            cell = _join(axes, [index[deep] for index in indices])
            _set_cells(bits, pieces.trajectory[deep], cell)
            if not deep.all():
                yield pieces.among(~deep)

    def edges(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return for each axis the low ends and the high ends of its cells."""
        ends = {}
        for name, (low, high, count) in self.axes.items():
            lines = grid_lines(low, high, count)
            ends[name] = (lines[:-1], lines[1:])
        return ends

    def lines(self, space: StateSpace) -> list[GridAxis]:
        """Return the axes of the grid, with their lines as they are judged."""
        return [GridAxis(space, name, *axis, self._overlap) for name, axis in self.axes.items()]

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "grid", "axes": {name: list(axis) for name, axis in self.axes.items()}}


def grid(**axes: tuple[float, float, int]) -> GridHypotheses:
    """Make every cell of a regular grid a hypothesis.

    Args:
      **axes: for each state (low, high, number of cells), in that state's unit. An angle's range
        may lie anywhere and span at most 2 pi.

    Returns:
      Hypotheses numbered with the last axis fastest.

    Raises:
      ValueError: if there is no axis, or an axis has low >= high or no cell.
    """
    return GridHypotheses(axes)


def checked_range(kind: str, name: str, axis: Any, third: str) -> tuple[float, float, float]:
    """Return low and high of an axis after checking both, and the third item as a number or NaN.

    Raises:
      ValueError: if `axis` has not three items, or low and high are not finite with low < high.
    """
    given = numbers(axis, 3)
    if given is None:
        raise ValueError(f"{kind}: expected {name}=(low, high, {third}), got {axis!r}")
    low, high, last = given
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        first, second, _ = axis
        raise ValueError(
            f"{kind}: expected finite low < high for {name!r}, got ({first!r}, {second!r})"
        )
    return low, high, last


def _crossed_cells(
    axes: list[GridAxis],
    starts: np.ndarray,
    steps: np.ndarray,
    spans: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the segment [P] and the extended indices [P] along each axis of the cells crossed.

    A segment comes into a cell wherever it crosses a grid line. Segments that cross fewer than two
    lines have no cell between their ends.

    Args:
      axes: axes of the grid.
      starts: [S, n] where segments begin.
      steps: [S, n] from the starts to the ends of segments.
      spans: for each axis the extended indices [S] of starts and of ends.
    """
    num_lines = sum(np.abs(last - first) for first, last in spans)
    many = np.flatnonzero(num_lines >= 2)
    if not many.size:
        return many, [many for _ in axes]
    starts, steps = starts[many], steps[many]
    found, firsts = [], [first[many] for first, _ in spans]
    for axis, first, (_, last) in zip(axes, firsts, spans, strict=True):
        still = axis.is_still(steps, first)
        found.append(axis.crossings(starts, steps, first, np.where(still, first, last[many])))
    along = np.repeat(np.arange(len(axes)), [len(segment) for segment, _, _ in found])
    segment, direction, fraction = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((fraction, segment))
    along, segment, direction = along[order], segment[order], direction[order]
    begins = np.searchsorted(segment, segment)  # the first line that each one's segment crosses
    indices = []
    for number, first in enumerate(firsts):
        crossed = np.concatenate([[0], np.cumsum(np.where(along == number, direction, 0))])
        indices.append(first[segment] + crossed[1:] - crossed[begins])
    return many[segment], indices


def _join(axes: list[GridAxis], indices: list[np.ndarray]) -> np.ndarray:
    """Return the cell numbers of extended indices, one array for each axis; -1 outside the grid."""
    cell, inside = np.zeros(indices[0].shape, np.int64), np.True_
    for axis, index in zip(axes, indices, strict=True):
        along = axis.cell(index)
        inside = inside & (along >= 0) & (along < axis.count)
        cell = cell * axis.count + along
    return np.where(inside, cell, -1)


def _set_cells(bits: np.ndarray, rows: np.ndarray, cells: np.ndarray) -> None:
    """Set the bit of cells[k] in row rows[k], except where cells[k] is -1, outside the grid."""
    inside = cells >= 0
    set_pairs(bits, rows[inside], cells[inside])


def _checked_axis(name: str, axis: Sequence[float]) -> tuple[float, float, int]:
    low, high, cells = checked_range("grid", name, axis, "number of cells")
    if not cells.is_integer() or cells < 1:
        raise ValueError(f"grid: expected a whole number of cells for {name!r}, got {axis[2]!r}")
    return low, high, int(cells)
