"""Flag a state that a monitor observes, where its time, its place or its distance is odd.

Within dt seconds a component of the state may change by at most

    FAST v dt + JITTER extent,

where v is the fastest change of this component in nominal trajectories of the task. Where the
evidence tells how states move, the states are held against the dynamics too (see
`trust.motion_watch`).

Shapes: n state dimensions.
"""

from __future__ import annotations

import numpy as np

from swerve.base.space import TWO_PI
from swerve.constraints.base import violates
from swerve.demonstrations.checks import COARSE, FAST, JITTER, START_TOLERANCE, TIME_SLACK
from swerve.demonstrations.durations import UNITS, unit_hint
from swerve.evidence.evidence import Evidence
from swerve.trust.motion_watch import MotionWatch

LATE = "late start"
OUTSIDE = "outside the bounds"
UNREACHABLE = "unreachable"
REPEATED = "repeated"
CONFLICTING = "another state at the same time"
GAP = "gap"
UNIT = "times of another unit"
OVERTIME = "past the horizon"
SHORT = "cut short"
KNOWN = "in a known constraint"
AGAINST = "against the dynamics"
UNTIMED = "no times: another rate than the model's?"

FINE = 1 / 3  # model steps between two states: times in which there were less are of no other unit
SLOW_FEED = 4.0  # s between two states: slower feeds, of a model of shorter steps, are rare


class StateChecks:
    """Checks of the states of one demonstration against the nominal trajectories of its task.

    The checks use plain floats: NumPy takes longer for a few numbers.

    Args:
      evidence: evidence for the task.
      number: number of the task in the evidence.
    """

    def __init__(self, evidence: Evidence, number: int) -> None:
        self._problem = evidence.problem
        self._is_timed = evidence.problem.is_timed
        space = evidence.problem.space
        limits = space.bounds + [-START_TOLERANCE, START_TOLERANCE] * space.extent[:, None]
        limits[space.is_angle] = -np.inf, np.inf
        self._bounds = limits.tolist()
        self._angles = np.flatnonzero(space.is_angle).tolist()
        self._start = np.asarray(evidence.tasks.start[number], float).tolist()
        self._fastest = (FAST * evidence.summary.fastest[number]).tolist()
        self._shortest = float(evidence.summary.shortest[number])
        self._jitter = (JITTER * space.extent).tolist()
        self._near_start = (START_TOLERANCE * space.unit).tolist()
        motion = evidence.motion
        self._has_seconds = False  # whether steps of the model, or of a slow feed, have come
        self._watch = None if motion is None else MotionWatch(motion, space)

    def of_first(self, values: list[float], now: float) -> tuple[str, ...]:
        """Return the flags of the first state, n values at a time [s]."""
        is_late = self._is_timed and now > 0.5 * self._problem.dt
        is_late = is_late or self._exceed(self._moved(values, self._start), self._near_start)
        if self._watch is not None:
            self._watch.begin(values)
        return (*([LATE] if is_late else []), *self._of_place(values, values, now))

    def of_next(
        self, values: list[float], now: float, last: list[float], last_time: float
    ) -> tuple[str, ...]:
        """Return the flags of a state, n values at a time [s], that follows another state."""
        return (
            *self._of_step(values, now - last_time, last),
            *self._of_place(values, last, now),
        )

    def of_end(self, now: float) -> tuple[str, ...]:
        """Return the flags of a demonstration that ends at a time [s]."""
        is_short = self._is_timed and now < (1.0 - TIME_SLACK) * self._shortest
        return (SHORT,) if is_short else ()

    def late_hint(self, elapsed: float, horizon: float) -> str:
        """Return the end of a message about a state that comes far too long after the last [s]."""
        hint = "" if self._has_seconds else unit_hint(elapsed, horizon)
        return f"{hint}. After a pause, another demonstration begins: make a new monitor for it"

    def _of_step(self, values: list[float], elapsed: float, last: list[float]) -> list[str]:
        """Return the flags of the step from the last state to this one, in `elapsed` seconds."""
        if elapsed == 0.0:
            if self._watch is not None:
                self._watch.begin(values)
            return [CONFLICTING]
        dt = self._problem.dt
        flags = self._of_duration(elapsed) if self._is_timed else []
        if not self._is_timed:  # however quickly the demonstrator moves, a move is a move
            elapsed = max(elapsed, dt)
        pairs = zip(self._fastest, self._jitter, strict=True)
        reach = [speed * elapsed + slack for speed, slack in pairs]
        moved = self._moved(values, last)
        is_jump, is_against = self._exceed(moved, reach), False
        if self._watch is not None:
            jumps, against = self._watch.step(values, moved, elapsed)
            is_jump, is_against = is_jump or bool(jumps), bool(against)
        return flags + [UNREACHABLE] * is_jump + [AGAINST] * is_against

    def _of_duration(self, elapsed: float) -> list[str]:
        """Return the flags of the duration of a step [s].

        Once steps have come that are no longer than the model's, or than those of a slow feed, the
        times are seconds, and what is longer is a gap. Until then, they are of the unit in which a
        step is about one of the model.
        """
        dt = self._problem.dt
        if elapsed <= max(COARSE * dt, SLOW_FEED):
            self._has_seconds = True
        if elapsed <= COARSE * dt:
            return []
        units = [
            unit
            for unit, number in UNITS.items()
            if number > 1.0 and FINE * dt <= elapsed / number <= COARSE * dt
        ]
        return [GAP] if self._has_seconds or not units else [GAP, f"{UNIT}: {units[0]}?"]

    def _of_place(self, values: list[float], last: list[float], now: float) -> list[str]:
        """Return the flags of a state's place and time."""
        problem, flags = self._problem, []
        for value, (low, high) in zip(values, self._bounds, strict=True):
            if not low <= value <= high:
                flags.append(OUTSIDE)
                break
        if self._is_timed and now > (problem.num_steps + 0.5) * problem.dt:
            flags.append(OVERTIME)
        if problem.known and self._enters_known(last, values):
            flags.append(KNOWN)
        return flags

    def _moved(self, values: list[float], last: list[float]) -> list[float]:
        """Return the change from one state to another, with angles by the shorter arc."""
        moved = [value - other for value, other in zip(values, last, strict=True)]
        for i in self._angles:
            moved[i] -= TWO_PI * round(moved[i] / TWO_PI)
        return moved

    def _exceed(self, moved: list[float], limits: list[float]) -> bool:
        """Return whether a change is larger than the limits in any component."""
        return any(abs(change) > limit for change, limit in zip(moved, limits, strict=True))

    def _enters_known(self, last: list[float], values: list[float]) -> bool:
        """Return whether the step from the last state to this one enters a known constraint."""
        problem, path = self._problem, np.array([last, values])
        return any(
            bool(violates(constraint, path, problem.space, problem.between_states))
            for constraint in problem.known
            if not constraint.about_actions
        )
