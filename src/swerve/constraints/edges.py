"""Decide on which side of an edge a number lies: the one rule of all judging.

    x lies at or above an edge e    where    float32(x) >= float32(e - r),

with r the resolution: about a millionth of the state's extent (`StateSpace.resolution`), at most
SHARE of the width of the region, and at least twice the spacing of float32 at the edge. So a number
that lies on an edge but for rounding counts as on it, whether it was recorded in decimals,
simulated in float32 or computed in float64. An interval [low, high) holds the numbers that are at
or above low and not at or above high. The interval of an angle is repeated at every turn. For
intervals nothing but comparisons decides, so NumPy and JAX agree on every number.

A segment between two states enters a set where one of its ends lies in the set, or where the
segment comes more than the resolution deep into the set: a corner that is touched is not entered.
Along a state that changes by no more than twice the resolution, the segment stays where it begins.

Shapes: n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from swerve.base.space import MAX_TURNS, TWO_PI, StateSpace, is_full_turn, single, wide

SHARE = 2.0**-12  # of a region's width: a larger resolution, by far too wide bounds, would move it
ZERO = MAX_TURNS + 3  # index of the turn 0 in TURNS
TURNS = TWO_PI * np.arange(-ZERO, ZERO + 1)  # rad; as far as angles and segments reach


def fine(resolution: float, width: float) -> float:
    """Return the resolution at the edges of a region of a width, which may be infinite."""
    return float(np.float32(min(resolution, SHARE * width)))


def rounding(sizes: Any) -> Any:
    """Return twice the spacing of float32 [...], or a little more, at numbers of sizes [...]."""
    return 2.0**-22 * sizes


def depth(resolution: float, width: float, size: float) -> float:
    """Return how far inside the edge of a region, which adds numbers up, a state has to lie.

    Args:
      resolution: of the states.
      width: of the region.
      size: greatest number of the region: where float32 is coarse, an eighth of the width at most.
    """
    return max(fine(resolution, width), min(rounding(size), width / 8.0))


def blur(edges: Any, resolution: float) -> np.ndarray:
    """Return by how much edges [...] are lowered: the resolution, or the spacing of float32."""
    size = np.where(np.isfinite(edges), np.abs(edges), 0.0).astype(np.float32)
    return np.maximum(resolution, 2.0 * np.spacing(size, dtype=np.float32))


def threshold(edges: Any, resolution: float) -> np.ndarray:
    """Return the least float32 numbers [...] that count as at or above edges [...]."""
    return np.asarray(np.float32(np.asarray(edges) - blur(edges, resolution)))


def coordinate(states: Any, space: StateSpace, name: str) -> Any:
    """Return one component [...] of states [..., n] as float32; angles within MAX_TURNS turns."""
    values = single(states[..., space.column(name)])
    if name not in space.angles:
        return values
    xp = values.__array_namespace__()
    near = values - single(TWO_PI * xp.round(values / TWO_PI))
    return xp.where(xp.abs(values) <= MAX_TURNS * TWO_PI, values, near)


def near_zero(low: float, high: float) -> tuple[float, float]:
    """Return an interval of an angle moved by whole turns, where it lies beyond MAX_TURNS turns."""
    turns = TWO_PI * round(low / TWO_PI) if abs(low) > MAX_TURNS * TWO_PI else 0.0
    return low - turns, high - turns


@functools.lru_cache(1024)
def judged_interval(low: float, high: float, resolution: float, is_angle: bool) -> Interval:
    """Return an interval; those of constraints are judged again and again."""
    return Interval(low, high, resolution, is_angle)


class Interval:
    """A half-open interval [low, high) of one state, repeated at every turn for an angle."""

    def __init__(self, low: float, high: float, resolution: float, is_angle: bool) -> None:
        turns = TURNS if is_angle else np.zeros(1)
        if is_angle:
            low, high = near_zero(low, high)
        sizes = [abs(edge) or 1.0 for edge in (low, high) if math.isfinite(edge)]
        resolution = fine(resolution, high - low if len(sizes) == 2 else max(sizes, default=1.0))
        self._low, self._is_angle = low - resolution, is_angle
        edges = low + turns, high + turns
        self._lows, self._highs = (threshold(edge, resolution) for edge in edges)
        self._blur = np.maximum(*(blur(edge, resolution) for edge in edges)).astype(np.float32)
        self.is_everything = is_angle and is_full_turn(low, high)

    def holds(self, values: Any) -> Any:
        """Return [...] True where float32 numbers [...] lie in the interval."""
        xp = values.__array_namespace__()
        if self.is_everything:
            return xp.ones(values.shape, bool)
        if not self._is_angle:
            return (values >= self._lows[0]) & (values < self._highs[0])
        return values < xp.asarray(self._highs)[self._image(values)]

    def parts(self, start: Any, step: Any) -> list[tuple[Any, Any]]:
        """Return for each image of the interval the part (enter, leave) of a segment in the image.

        The segment is start + u * step with 0 <= u <= 1; enter >= leave where the segment misses
        the image. The images of an angle's interval are those of three turns, the most that half a
        turn can reach.

        Args:
          start: [...] float32 numbers where segments begin.
          step: [...] from the starts to the ends of segments.
        """
        xp = start.__array_namespace__()
        if self.is_everything:
            return [(xp.full(start.shape, -math.inf), xp.full(start.shape, math.inf))]
        if not self._is_angle:
            return [part(start, step, self._lows[0], self._highs[0], self._blur[0])]
        edges = [xp.asarray(values) for values in (self._lows, self._highs, self._blur)]
        middle = self._image(start)
        return [
            part(start, step, *(wide(values[image]) for values in edges))
            for image in (middle - 1, middle, middle + 1)
        ]

    def _image(self, values: Any) -> Any:
        """Return the index [...] of the last turn whose image begins at or below angles [...]."""
        xp = values.__array_namespace__()
        turn = xp.floor((values - self._low) / TWO_PI) + ZERO
        turn = xp.nan_to_num(xp.clip(turn, 1, len(TURNS) - 3)).astype(int)
        lows = xp.asarray(self._lows)
        return turn - (values < lows[turn]) + (values >= lows[turn + 1])


def part(start: Any, step: Any, low: Any, high: Any, blur: Any) -> tuple[Any, Any]:
    """Return the part (enter, leave) of a segment that lies deeper in an interval than its edges.

    Args:
      start: [...] float32 numbers where segments begin.
      step: [...] from the starts to the ends of segments.
      low: [...] threshold of the low edge.
      high: [...] threshold of the high edge.
      blur: [...] by how much the thresholds lie below the edges.

    Returns:
      Shares of the segment, each [...]; enter >= leave where the segment misses the interval.
    """
    xp = step.__array_namespace__()
    still, start = xp.abs(step) <= 2.0 * blur, wide(start)
    share = 1.0 / xp.where(still, 1.0, step)
    deep = xp.minimum(wide(low + 2.0 * blur), high)  # in a thin interval, nothing is deep
    to_low, to_high = (deep - start) * share, (high - start) * share
    outside = xp.where((low <= start) & (start < high), -math.inf, math.inf)
    enter = xp.where(still, outside, xp.minimum(to_low, to_high))
    leave = xp.where(still, -outside, xp.maximum(to_low, to_high))
    return enter, leave
