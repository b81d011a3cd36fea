"""Find demonstrations that the dynamics do not allow, and what would explain them.

Their motion is held against the dynamics in windows (see `trust.recorded`). One wrong row, which no
window of usual motion shows, is looked for by itself.

Shapes: L rows, n state dimensions.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from swerve.base.space import StateSpace
from swerve.demonstrations.checks import (
    FAST,
    IMPOSSIBLE_SHARE,
    JITTER,
    RELATIVE,
    SPLIT,
    STRENGTH,
    USUAL_ERRORS,
    restarts,
)
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.motion import STRAYING, Motion, Steps
from swerve.problem.record import ProblemRecord
from swerve.trust.recorded import Finding, Recording, moving

LEAST_JUDGED = 0.5  # share of the steps that must lie near the bounds for a cause to be believed
EXPLAINED = 0.1  # share of the motion that may stay impossible where a cause explains the rest
FEW = 3  # impossible windows: with a single step that is far off, these are a glitch
ALIKE = 0.01  # share of the motion: causes whose misfits differ by less are all named
STRICT = 1.5  # STRENGTH in the search for another rate, which makes all actions seem too weak
RATES = (0.5, 2.0, 0.1, 10.0, 0.01, 100.0, 1e-3, 1e3, 1 / 60, 60.0, 1e-6, 1e-9)
"""Factors that t may have to be multiplied by, likely ones first."""

NUM_NEAR = 4  # of RATES: with times far longer, the dynamics would allow anything

UNITS = {
    math.pi / 180: "degrees in place of radians",
    180 / math.pi: "radians in place of degrees",
    0.001: "thousandths, such as mm in place of m",
    1000.0: "thousands, such as m in place of mm",
    0.01: "hundredths, such as cm in place of m",
    100.0: "hundreds, such as m in place of cm",
    0.3048: "feet in place of m",
    1 / 3.6: "km/h in place of m/s",
    60.0: "per minute in place of per second",
}
"""Factors that a column may have to be multiplied by, and what the column would then be in."""

GLITCH = "A glitch of the recording, or rows that are left out, swapped or repeated?"
UNKNOWN = "A wrong sign, columns swapped, another unit, or another rate?"
UNTIMED = " It has no times: if its rows are not evenly spaced, give them [s] in a column t"


def against_dynamics(demonstration: Demonstration, problem: ProblemRecord, motion: Motion) -> str:
    """Return what of a demonstration the dynamics do not allow, in words; '' if they allow all."""
    told = judged(demonstration.states, demonstration.times, problem, motion)
    return "" if told is None else _text(told[0], demonstration, problem, motion, told[1])


def judged(
    states: np.ndarray, times: np.ndarray | None, problem: ProblemRecord, motion: Motion
) -> tuple[Finding, str] | None:
    """Return what of states [L, n] the dynamics do not allow, and its cause; None: they allow all.

    The cause is GLITCH where it is a single step, '' where it is not known.
    """
    states = moving(states)
    if len(states) < 3:
        return None
    elapsed = None if times is None else np.diff(times[: len(states)])
    recording = Recording(states, elapsed, problem, motion)
    steps = recording.steps
    strict = recording.worst(steps, STRICT)
    found, cause = strict, ""
    if strict.share > IMPOSSIBLE_SHARE:
        found = recording.worst(steps)
        if found.share > IMPOSSIBLE_SHARE:
            cause = _cause(recording, found)
        else:
            found, cause = strict, _slower(recording)
    glitch = _glitch(steps, problem.space, motion)
    if cause or (found is not strict and (glitch is None or found.num_bad > FEW)):
        return found, cause
    return None if glitch is None else (glitch, GLITCH)


def _glitch(steps: Steps, space: StateSpace, motion: Motion) -> Finding | None:
    """Return the step that misses the dynamics by far more than the other steps, or None.

    A row that is off by itself misses them twice, to either side: then even actions of the model's
    own strength are no excuse.
    """
    signed = steps.moved - steps.predicted
    error, middle = np.abs(signed), len(signed) // 2
    usual = USUAL_ERRORS * np.partition(error, middle, axis=0)[middle]
    other = FAST * steps.bend + JITTER * space.extent + usual
    beyond = error - other - steps.duration * (STRENGTH * motion.reach + motion.worst)
    returns = np.where(signed[1:] * signed[:-1] < 0.0, np.minimum(error[1:], error[:-1]), 0.0)
    reach = steps.duration * np.maximum(FAST * motion.reach, motion.worst)
    beyond[:-1] = np.maximum(beyond[:-1], returns - (other + reach)[:-1])
    beyond /= space.extent
    row, i = (int(k) for k in np.unravel_index(int(beyond.argmax()), beyond.shape))
    if beyond[row, i] <= 0.0:
        return None
    change = float(steps.moved[row, i]), float(steps.predicted[row, i])
    return Finding(0.0, 1, i, row, row + 1, *change)


def _cause(recording: Recording, found: Finding) -> str:
    """Return the mistake without which the rows after the first fit the dynamics; '' if unknown.

    The first row may be right where a task names it.
    """
    states, names = recording.states[1:], recording.problem.space.names
    elapsed = None if recording.elapsed is None else recording.elapsed[1:]
    rest = recording._replace(states=states, elapsed=elapsed)
    numbers = range(len(names))

    def misfit(changed: np.ndarray) -> float:
        return _misfit(rest._replace(states=changed), found.column)

    signs = [name for i, name in enumerate(names) if misfit(_scaled(states, i, -1.0)) < RELATIVE]
    if signs:
        return f"It fits with the sign of {' or of '.join(signs)} reversed"
    for i, j in itertools.combinations(numbers, 2):
        order = [j if k == i else i if k == j else k for k in numbers]
        if misfit(states[:, order]) < RELATIVE:
            return f"It fits with the columns {names[i]} and {names[j]} swapped"
    units = {
        f"with {names[i]} times {factor:.4g} ({unit})": misfit(_scaled(states, i, factor))
        for (factor, unit), i in itertools.product(UNITS.items(), numbers)
    }
    return _best(units | _other_rates(rest, found))


def _slower(recording: Recording) -> str:
    """Return the nearest other unit of time in which no action seems too weak; '' if none helps."""
    elapsed = recording.elapsed
    if elapsed is None:
        return ""
    for factor in RATES[:NUM_NEAR]:
        other = recording._replace(elapsed=factor * elapsed)
        if other.worst(other.steps, STRICT).share < EXPLAINED:
            return f"It fits {_other_rate(factor)}"
    return ""


def _other_rates(recording: Recording, found: Finding) -> dict[str, float]:
    """Return how far a recording misses the dynamics with other units of time."""
    if recording.elapsed is None:
        return {}
    return {
        _other_rate(factor): _misfit(
            recording._replace(elapsed=factor * recording.elapsed), found.column
        )
        for factor in RATES
    }


def _other_rate(factor: float) -> str:
    return f"with t times {factor:.4g} (another rate, or another unit of t)"


def _best(misfits: dict[str, float]) -> str:
    """Return the causes that leave least unexplained, in words; '' if all leave too much."""
    least = min(misfits.values(), default=math.inf)
    if least >= RELATIVE:
        return ""
    return "It fits " + ", or ".join(text for text, x in misfits.items() if x < least + ALIKE)


def _misfit(recording: Recording, column: int) -> float:
    """Return the share of the motion of a component that is left unexplained.

    The share is infinite where the recording does not fit the dynamics.
    """
    steps = recording.steps
    is_judged = np.count_nonzero(steps.duration) > LEAST_JUDGED * len(steps.duration)
    fits = is_judged and recording.worst(steps).share < EXPLAINED
    return recording.mismatch(steps, column) if fits else math.inf


def _scaled(states: np.ndarray, column: int, factor: float) -> np.ndarray:
    """Return states [L, n] with one component times a factor."""
    changed = states.copy()
    changed[:, column] *= factor
    return changed


def _text(
    found: Finding, demonstration: Demonstration, problem: ProblemRecord, motion: Motion, cause: str
) -> str:
    """Return a finding in words that follow the name of the demonstration."""
    space, dt, i = problem.space, problem.dt, found.column
    name = space.names[i]
    if cause == GLITCH and restarts(demonstration.states, found.last, space):
        cause = f"It leads back to the start. {SPLIT}"
    residual = abs(found.moved - found.predicted)
    step = dt * float(motion.reach[i] + STRAYING * dt * motion.turning[i])
    worth = f", {residual / step:,.0f} times what the actions of a step can do" if step else ""
    times = demonstration.times
    at = "" if times is None else f" (t = {times[found.first]:.6g} s)"
    share = (
        f" {100 * found.share:.0f} % of its motion in {name} is like this." if found.share else ""
    )
    return (
        f"does what the dynamics cannot: from row {found.first + 1}{at} to row {found.last + 1} "
        f"{name} changes by {found.moved:.3g}, where the dynamics change it by "
        f"{found.predicted:.3g}, a residual of {residual:.3g}{worth}.{share} "
        f"{cause or UNKNOWN + ('' if times is not None else UNTIMED)}"
    )
