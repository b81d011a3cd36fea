"""Doubt the times of a demonstration: its duration, its speed, and how far apart its rows are.

Where a demonstration has no times, each row should be a step of the model. Its motion tells how far
apart its rows are instead (see `trust.recorded`).

Shapes: L states, n state dimensions.
"""

from __future__ import annotations

import numpy as np

from swerve.base.space import StateSpace
from swerve.demonstrations.checks import (
    COARSE,
    FAST,
    IMPOSSIBLE_SHARE,
    JITTER,
    SPLIT,
    TIME_SLACK,
    restarts,
)
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.durations import UNITS, likely_unit
from swerve.evidence.evidence import Evidence
from swerve.trust.recorded import Recording, goes_on, moving

FAST_SHARE = 0.9  # quantile of the speeds of steps: noise makes single steps fast

NO_TIMES = (
    "There are no times, so fits and monitors take each row for a step: give them [s] in a column t"
)
CUTS = (
    "the straight lines between them may cut through a hypothesis that was avoided, and strike it "
    "out"
)


def time_doubts(demonstration: Demonstration, evidence: Evidence, task: int) -> dict[str, str]:
    """Return what is odd about the times of a demonstration, by kind of doubt; '' if nothing."""
    return {
        "duration": _odd_duration(demonstration, evidence, task),
        "speed": _odd_speed(demonstration, evidence, task) or _jump(demonstration, evidence, task),
        "rate": _coarse(demonstration, evidence, task) or _other_rate(demonstration, evidence),
    }


def _odd_duration(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    if demonstration.times is None:
        return ""
    duration, longest = _duration(demonstration.times), _longest(evidence)
    shortest = float(evidence.summary.shortest[task])
    hint = _unit_hint(demonstration.times, evidence, task)
    if duration > (1.0 + TIME_SLACK) * longest:
        return (
            f"lasts {duration:.4g} s, and the model's episodes at most {longest:.4g} s: another "
            f"unit of t, or a horizon that is too short?{hint}"
        )
    if duration < (1.0 - TIME_SLACK) * shortest:
        return (
            f"lasts {duration:.4g} s, and nominal trajectories at least {shortest:.4g} s: cut "
            f"short, or another unit of t?{hint}"
        )
    return ""


def _duration(times: np.ndarray) -> float:
    return float(times[-1] - times[0])


def _longest(evidence: Evidence) -> float:
    """Return the duration of the model's longest episodes [s]."""
    return evidence.problem.num_steps * evidence.problem.dt


def _unit(times: np.ndarray, evidence: Evidence, task: int) -> str:
    """Return the unit of times [L] that explains their duration; '' for seconds, or for none."""
    duration, shortest = _duration(times), float(evidence.summary.shortest[task])
    return likely_unit(duration, min(max(duration, shortest), _longest(evidence)))


def _counts_rows(times: np.ndarray, dt: float) -> bool:
    """Return whether times [L] are 1, 2, 3, ..., and steps of the model take far from 1 s."""
    return not 1.0 / COARSE <= dt <= COARSE and bool((np.diff(times) == 1.0).all())


def _unit_hint(times: np.ndarray, evidence: Evidence, task: int) -> str:
    """Return what times [L] of an odd duration may be in place of seconds, in words."""
    unit = _unit(times, evidence, task)
    found = [f"be {unit}"] * bool(unit) + ["count the rows"] * _counts_rows(
        times, evidence.problem.dt
    )
    return f" The times may {' or '.join(found)}: give them in seconds" if found else ""


def _steps(demonstration: Demonstration, evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Return the change of each state from row to row [L-1, n] and its duration [L-1] s."""
    problem, states, times = evidence.problem, demonstration.states, demonstration.times
    if times is None:  # assume that the demonstration lasts as long as an episode
        times = np.linspace(0.0, problem.num_steps * problem.dt, len(states))
    return np.abs(problem.space.difference(states[:-1], states[1:])), np.diff(times)


def _odd_speed(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    problem = evidence.problem
    horizon = problem.num_steps * problem.dt
    moved, elapsed = _steps(demonstration, evidence)
    # a quantile by sorting: np.quantile would take another 30 ms to load
    speed = np.sort(moved / elapsed[:, None], axis=0)[int(FAST_SHARE * (len(moved) - 1))]
    rate = f"rate? {NO_TIMES}" if demonstration.times is None else "t?"
    nominal = np.maximum(evidence.summary.fastest[task], 1e-6 * problem.space.extent / horizon)
    worst = int((speed / nominal).argmax())
    if speed[worst] <= FAST * nominal[worst]:
        return ""
    return (
        f"changes {problem.space.names[worst]} by {speed[worst]:.3g} a second, "
        f"{speed[worst] / nominal[worst]:.0f} times as fast as any nominal trajectory: another "
        f"unit, such as degrees, or another {rate}"
    )


def _jump(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    space, fastest = evidence.problem.space, evidence.summary.fastest[task]
    moved, elapsed = _steps(demonstration, evidence)
    beyond = moved - FAST * fastest * elapsed[:, None] - JITTER * space.extent
    if not (beyond > 0.0).any():
        return ""
    k = int((beyond / space.extent).argmax())
    row, column = (int(x) for x in np.unravel_index(k, beyond.shape))
    return (
        f"jumps by {moved[row, column]:.3g} in {space.names[column]} from row {row + 1} to row "
        f"{row + 2}, in {elapsed[row]:.3g} s, where no nominal trajectory changes it faster than "
        f"by {fastest[column]:.3g} a second: {why_jump(demonstration, row, space)} Hypotheses on "
        "the straight line between the rows count as entered"
    )


def _coarse(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    """Return that the rows are too far apart for straight lines between them; '' if they are not.

    Times that seem to be of a smaller unit are taken for that unit; those that count the rows, in
    episodes that would be too long, for steps of the model. Times that seem to be minutes may be
    seconds of a demonstration that was cut short.
    """
    problem, times = evidence.problem, demonstration.times
    if times is None or not problem.between_states:
        return ""
    unit = _unit(times, evidence, task)
    in_second = max(UNITS.get(unit, 1.0), 1.0)
    widest = float(np.diff(times).max()) / in_second
    is_long = _duration(times) > (1.0 + TIME_SLACK) * _longest(evidence)
    if widest <= COARSE * problem.dt or (is_long and _counts_rows(times, problem.dt)):
        return ""
    given = f", if its times are {unit}" if in_second > 1.0 else ""
    return (
        f"has states up to {widest:.3g} s apart{given}, where the model steps every "
        f"{problem.dt:.3g} s: {CUTS}"
    )


def _other_rate(demonstration: Demonstration, evidence: Evidence) -> str:
    """Return how far apart the rows of a demonstration without times are, if that is no step."""
    problem, motion, states = evidence.problem, evidence.motion, moving(demonstration.states)
    if demonstration.times is not None or motion is None or len(states) < 3:
        return ""
    recording = Recording(states, None, problem, motion)
    steps = recording.steps
    shares = [recording.worst(x).share for x in (recording.model_steps, steps)]
    if not shares[0] > IMPOSSIBLE_SHARE >= shares[1]:  # a step will do, or no rate will
        return ""
    if not goes_on(states, problem.space):
        return ""
    apart = float(steps.duration.max())
    is_coarse = problem.between_states and apart > COARSE * problem.dt
    return (
        f"moves as if its rows were about {apart:.2g} s apart, where the model steps every "
        f"{problem.dt:.3g} s: another rate, or another unit of a state? "
        f"{f'At that rate, {CUTS}. ' if is_coarse else ''}{NO_TIMES}"
    )


def why_jump(demonstration: Demonstration, row: int, space: StateSpace) -> str:
    """Return what may have caused a jump from a row, counted from 0, to the next."""
    if restarts(demonstration.states, row + 1, space):
        return f"back to its start. {SPLIT}."
    return "a glitch of the recording?"
