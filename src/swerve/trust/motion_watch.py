"""Hold a demonstration against the dynamics while it lasts, step by step.

The motion of each component of the state is added up until it has gone LEAST_SUM of the extent, by
the states or by the dynamics; then the two sums are compared, as `trust.impossible` compares
windows of a finished demonstration.

Shapes: n state dimensions, B features.
"""

from __future__ import annotations

import math

import numpy as np

from swerve.base.space import StateSpace
from swerve.demonstrations.checks import (
    FAST,
    IMPOSSIBLE_SHARE,
    JITTER,
    RELATIVE,
    STRENGTH,
    USUAL_ERRORS,
)
from swerve.evidence.motion import MOST_WAVES, STRAYING, Motion

LEAST_SUM = 0.06  # share of the extent: shorter motions tell too little while noise is not known
GLITCH = 2  # impossible steps in turn, out and back, that count as a glitch and not as motion
LEAST_BAD = 2  # impossible sums of one component: a single one may be a glitch
MEMORY = 0.95  # share of the usual error that stays with each step
NOISE = 2.0  # times JITTER: what glitches must exceed at first, while noise is not known


class MotionWatch:
    """Sums of the motion of one demonstration, in plain floats where these are quicker.

    Args:
      motion: how states of the problem move.
      space: state space.
    """

    def __init__(self, motion: Motion, space: StateSpace) -> None:
        num, angles = len(space.names), space.is_angle
        middle, half = space.bounds.mean(axis=1), 0.5 * space.extent
        straight = np.flatnonzero(~angles)
        self._forms = np.ascontiguousarray(motion.forms)
        self._scaled = [(i, float(middle[i]), float(1.0 / half[i])) for i in straight.tolist()]
        self._waving = list(range(num)) if num <= MOST_WAVES else np.flatnonzero(angles).tolist()
        columns = (
            motion.place,
            0.5 + np.abs(motion.place - 0.5),
            STRAYING * motion.turning,
            STRENGTH * motion.reach + motion.error,
            STRENGTH * motion.reach + motion.worst,
            JITTER * space.extent,
            LEAST_SUM * space.extent,
        )
        self._limits = list(zip(*(column.tolist() for column in columns), strict=True))
        self._sums = [_Sums(NOISE / USUAL_ERRORS * x) for x in (JITTER * space.extent).tolist()]
        self._rates: list[float] = []

    def begin(self, values: list[float]) -> None:
        """Take in the first state, n values."""
        self._rates = self._rates_of(values)

    def step(
        self, values: list[float], moved: list[float], elapsed: float
    ) -> tuple[list[int], list[int]]:
        """Take in the next state, n values.

        Args:
          values: the state.
          moved: change of each component, angles by the shorter arc.
          elapsed: since the last state [s].

        Returns:
          The components of which the step by itself is impossible, and those of which the motion up
          to this state is.
        """
        before, self._rates = self._rates, self._rates_of(values)
        jumps, against = [], []
        for i, (change, first, second, limits, sums) in enumerate(
            zip(moved, before, self._rates, self._limits, self._sums, strict=True)
        ):
            place, share, straying, slack, reach, jitter, least = limits
            turned = second - first
            predicted = elapsed * (first + place * turned)
            bend = elapsed * (share * abs(turned) + straying * elapsed)
            error = abs(change - predicted)
            allowed = reach * elapsed + FAST * bend + jitter + USUAL_ERRORS * sums.usual
            sums.usual = MEMORY * sums.usual + (1.0 - MEMORY) * min(error, allowed)
            sums.jumps = sums.jumps + 1 if error > allowed else 0
            if sums.jumps:
                jumps.append(i)
            if 0 < sums.jumps <= GLITCH:
                continue
            sums.moved += change
            sums.predicted += predicted
            sums.slack += slack * elapsed + bend
            gone = max(abs(sums.moved), abs(sums.predicted), sums.slack)
            if gone > least and sums.compare(jitter):
                against.append(i)
        return jumps, against

    def _rates_of(self, values: list[float]) -> list[float]:
        """Return g of a state, as `Motion.rates` does."""
        waving = [values[i] for i in self._waving]
        parts = [1.0, *[(values[i] - middle) * scale for i, middle, scale in self._scaled]]
        found = np.array([*parts, *map(math.sin, waving), *map(math.cos, waving)])
        return (self._forms.dot(found).dot(found)).tolist()


class _Sums:
    """The motion of one component since the last comparison, and what was found so far."""

    __slots__ = ("bad", "gone", "jumps", "moved", "num_bad", "predicted", "slack", "usual")

    def __init__(self, usual: float) -> None:
        self.moved = self.predicted = self.slack = 0.0
        self.gone = self.bad = 0.0  # motion that was compared, and that was impossible
        self.num_bad = self.jumps = 0  # `jumps`: impossible steps in turn, up to the last one
        self.usual = usual  # error of a step

    def compare(self, jitter: float) -> bool:
        """Compare the sums and begin new ones; return whether the motion has become impossible."""
        moved, predicted, slack = self.moved, self.predicted, self.slack
        self.moved = self.predicted = self.slack = 0.0
        size = max(abs(moved), abs(predicted))
        self.gone += size
        if abs(moved - predicted) <= slack + RELATIVE * size + jitter:
            return False
        self.bad += size
        self.num_bad += 1
        return self.num_bad >= LEAST_BAD and self.bad > IMPOSSIBLE_SHARE * self.gone
