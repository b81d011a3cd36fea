"""Hold the motion of a recording against the dynamics, in windows of several lengths.

A component i of the state misses the dynamics in a window of rows by

    m_i = |moved_i - predicted_i| - slack_i,

where the slack is what actions and the straight lines between rows can explain (see
`evidence.motion`). A window is impossible where m_i exceeds RELATIVE of the motion and JITTER of
the extent. Windows of several lengths are tried: noise hides what single rows say, and long windows
hide what comes and goes.

Shapes: L rows, n state dimensions, W windows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.base.space import StateSpace
from swerve.demonstrations.checks import JITTER, LEAST_MOTION, RELATIVE, STRENGTH
from swerve.evidence.motion import Motion, Steps
from swerve.problem.record import ProblemRecord

WINDOWS = (1, 4, 16, 64)  # rows
LEAST_WINDOWS = 4  # of a demonstration: fewer windows say little
FAR = 3.0  # half widths from the middle of the bounds: the fit says nothing of states beyond
LEAST_ONWARD = 0.2  # correlation of successive changes: noise at rest has about -0.5
TINY = 1e-300  # for sums of motions that may be 0


class Finding(NamedTuple):
    """The worst of what is impossible.

    Attributes:
      share: share of the motion in this component that is impossible.
      num_bad: number of windows that are impossible.
      column: the component of the state.
      first: first row of the worst window.
      last: last row of the worst window.
      moved: change of the component in the window.
      predicted: change by the dynamics.
    """

    share: float
    num_bad: int
    column: int
    first: int
    last: int
    moved: float
    predicted: float


class Recording(NamedTuple):
    """The rows of a demonstration until it comes to rest, and what they are held against.

    Attributes:
      states: [L, n].
      elapsed: [L-1] s between the rows; None where it is not known.
      problem: the problem.
      motion: how states of the problem move.
    """

    states: np.ndarray
    elapsed: np.ndarray | None
    problem: ProblemRecord
    motion: Motion

    @property
    def steps(self) -> Steps:
        """The steps; without times, of the duration that leaves least impossible.

        That is one step of the model, an even share of an episode, or what the motion of one
        component tells.
        """
        states, space = self.states, self.problem.space
        if self.elapsed is not None:
            return self._steps(self.elapsed)
        num, motion = len(states) - 1, self.motion
        moved = np.abs(space.difference(states[:-1], states[1:])).mean(axis=0)
        rates = np.abs(motion.rates(states[:-1], space)).mean(axis=0)
        is_told = rates > motion.reach + motion.error  # by the state, whatever the actions
        told = (moved[is_told] / rates[is_told]).tolist()
        durations = [self.problem.dt, *told, self.problem.num_steps * self.problem.dt / num]
        each = [self._steps(np.full(num, duration)) for duration in durations]
        return min(each, key=lambda steps: self.worst(steps).share)

    @property
    def model_steps(self) -> Steps:
        """The steps, if each row is a step of the model."""
        return self._steps(np.full(len(self.states) - 1, self.problem.dt))

    def _steps(self, elapsed: np.ndarray) -> Steps:
        """Return the steps, all 0 where a state is too far outside the bounds for the fit."""
        space, motion = self.problem.space, self.motion
        offset = np.abs(self.states - space.bounds.mean(axis=1)) / (0.5 * space.extent)
        offset = np.where(space.is_angle, 0.0, offset).max(axis=1)
        steps = motion.steps(self.states, elapsed, space)
        if (offset <= 1.0).all():
            return steps
        beyond = np.maximum(np.maximum(offset[1:], offset[:-1]), 1.0)[:, None]
        bend = steps.bend + steps.duration * (beyond**2 - 1.0) * motion.error
        return Steps(*(np.where(beyond <= FAR, x, 0.0) for x in steps._replace(bend=bend)))

    def worst(self, steps: Steps, strength: float = STRENGTH) -> Finding:
        """Return the component of which the largest share of the motion is impossible.

        Args:
          steps: steps of this recording.
          strength: how many times as strong as the model's the actions may have been.
        """
        slack = steps.bend + steps.duration * (strength * self.motion.reach + self.motion.error)
        parts = np.hstack([steps.moved, steps.predicted, slack])
        findings = []
        for width in WINDOWS:
            starts = np.arange(0, len(parts), width)
            if width > 1 and len(starts) < LEAST_WINDOWS:
                break
            sums = np.add.reduceat(parts, starts, axis=0) if width > 1 else parts
            moved, predicted, allowed = np.split(sums, 3, axis=1)
            findings.append(_worst_window(moved, predicted, allowed, width, self.problem.space))
        found = max(findings, key=lambda finding: finding.share)
        return found._replace(last=min(found.last, len(parts)))

    def mismatch(self, steps: Steps, column: int) -> float:
        """Return the share of the motion of a component that the dynamics do not explain."""
        starts = np.arange(0, len(steps.moved), min(WINDOWS[2], max(1, len(steps.moved) // 4)))
        moved, predicted = (
            np.add.reduceat(part[:, column], starts) for part in (steps.moved, steps.predicted)
        )
        size = np.maximum(np.abs(moved), np.abs(predicted)).sum()
        return float(np.abs(moved - predicted).sum() / max(size, TINY))


def goes_on(states: np.ndarray, space: StateSpace) -> bool:
    """Return whether a component of states [L, n] moves on, where noise goes back and forth.

    At rest, each change of a noisy component tends to undo the one before, and so does each change
    of its means over windows of rows.
    """
    path = np.zeros(states.shape)
    path[1:] = np.cumsum(space.difference(states[:-1], states[1:]), axis=0)
    for width in WINDOWS:
        starts = np.arange(0, len(path) - width + 1, width)
        if width > 1 and len(starts) < LEAST_WINDOWS:
            break
        means = np.add.reduceat(path[: len(starts) * width], starts, axis=0) / width
        moved = np.diff(means, axis=0)
        is_far = np.ptp(means, axis=0) > LEAST_MOTION * space.extent
        onward = (moved[1:] * moved[:-1]).sum(axis=0)
        if (is_far & (onward > LEAST_ONWARD * (moved**2).sum(axis=0))).any():
            return True
    return False


def _worst_window(
    moved: np.ndarray, predicted: np.ndarray, slack: np.ndarray, width: int, space: StateSpace
) -> Finding:
    """Return what is impossible in windows [W, n] of the same width."""
    size = np.maximum(np.abs(moved), np.abs(predicted))
    missed = np.abs(moved - predicted) - slack - RELATIVE * size - JITTER * space.extent
    bad = np.where((missed > 0.0) & (size > LEAST_MOTION * space.extent), size, 0.0)
    share = bad.sum(axis=0) / np.maximum(size.sum(axis=0), TINY)
    i = int(share.argmax())
    k = int(bad[:, i].argmax())
    change = float(moved[k, i]), float(predicted[k, i])
    num_bad = int(np.count_nonzero(bad[:, i]))
    return Finding(float(share[i]), num_bad, i, k * width, (k + 1) * width, *change)


def moving(states: np.ndarray) -> np.ndarray:
    """Return the states [L, n] up to the first of those at the end that are all the same."""
    differs = np.flatnonzero((states != states[-1]).any(axis=1))
    return states[: differs[-1] + 2] if len(differs) else states[:1]
