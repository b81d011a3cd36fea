"""See to it that no trajectory of the model itself seems impossible.

The fit of the dynamics knows usual steps alone. Bounces, walls and jumps are rare among steps from
anywhere, yet a trajectory may owe them most of its motion. Whatever component of the state would
raise an alarm in trajectories of the model is judged no more.

Shapes: N trajectories, T steps, n state dimensions.
"""

from __future__ import annotations

import numpy as np

from swerve.evidence.motion import Motion
from swerve.problem.record import ProblemRecord
from swerve.trust.impossible import GLITCH, judged
from swerve.trust.motion_watch import MotionWatch

NEAR = 1.5  # half widths from the middle of the bounds: trajectories count until they are beyond
EVERY = (1, 5)  # steps between two rows: people record at other rates than the model's


def without_alarms(motion: Motion, own: np.ndarray, problem: ProblemRecord) -> Motion:
    """Return the motion without what trajectories of the model itself do not fit.

    Args:
      motion: how states of the problem move.
      own: [N, T+1, n] trajectories of the model, from states in the bounds.
      problem: the problem.
    """
    space = problem.space
    offset = np.abs(own - space.bounds.mean(axis=1)) / (0.5 * space.extent)
    offset = np.where(space.is_angle & np.isfinite(own), 0.0, offset)
    is_near = np.all(offset <= NEAR, axis=2)  # what is not a number is not near
    num_near = np.logical_and.accumulate(is_near, axis=1).sum(axis=1)
    for states, num in zip(own, num_near.tolist(), strict=True):
        known = states[:num]
        for every in EVERY:
            while alarm := _alarm(known[::every], every * problem.dt, problem, motion):
                column, is_jump = alarm
                motion = motion.silenced(column, space, is_jump=is_jump)
    return motion


def _alarm(
    states: np.ndarray, dt: float, problem: ProblemRecord, motion: Motion
) -> tuple[int, bool] | None:
    """Return a component that seems impossible in states [L, n], and whether by a single step."""
    if len(states) < 2:
        return None
    told = judged(states, dt * np.arange(len(states)), problem, motion)
    if told is not None:
        return told[0].column, told[1] == GLITCH
    watch, rows = MotionWatch(motion, problem.space), states.tolist()
    moved = problem.space.difference(states[:-1], states[1:]).tolist()
    watch.begin(rows[0])
    for row, change in zip(rows[1:], moved, strict=True):
        jumps, against = watch.step(row, change, dt)
        if jumps or against:
            return (jumps or against)[0], bool(jumps)
    return None
