"""Boxes and segments in exact arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction


def meets_exactly(
    start: Sequence[float], end: Sequence[float], box: Sequence[tuple[float, float]]
) -> bool:
    """Whether an end lies in the half-open box or a part of positive length does, by fractions."""
    if any(
        all(low <= value < high for value, (low, high) in zip(point, box, strict=True))
        for point in (start, end)
    ):
        return True
    enter, leave = Fraction(0), Fraction(1)
    for first, last, (low, high) in zip(start, end, box, strict=True):
        at, step = Fraction(first), Fraction(last) - Fraction(first)
        if step == 0:
            if not low <= at < high:
                return False
            continue
        ends = sorted([(Fraction(low) - at) / step, (Fraction(high) - at) / step])
        enter, leave = max(enter, ends[0]), min(leave, ends[1])
    return enter < leave
