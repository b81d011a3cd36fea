"""What speaks against trusting an inference, in plain words.

A demonstration is held against nominal trajectories of its task, which it need not resemble but
whose order of magnitude it shares: where they end, how long they last, how fast a state changes.

Shapes: n state dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence

if TYPE_CHECKING:
    from swerve.inference import Inference

LOW_ESS_SHARE = 0.02
LOW_ESS = 100.0
GOOD_ESS_SHARE = 0.3  # above it the policy is not what is wrong
FAR_END = 0.05  # of the extent: within it of its goal a demonstration has arrived
FACTOR = 2.0  # beyond nominal trajectories in where it ends
FAST = 3.0  # times the fastest nominal change of a state
FAST_SHARE = 0.9  # of a demonstration's steps may be slower: noise makes single steps fast
TIME_SLACK = 0.1  # of the duration
COARSE = 1.5  # of the model's steps, between two states of a demonstration
NUM_NAMES = 3  # demonstrations named in a warning


def warnings(inference: Inference) -> tuple[str, ...]:
    """Return what speaks against trusting the ranking; empty if nothing does."""
    return (
        *_exhausted(inference),
        *_low_samples(inference),
        *_floored(inference),
        *_doubts(inference),
    )


def some_names(names: Sequence[str]) -> str:
    """Return for example 'demo_1, demo_2, demo_3 and 30 more'."""
    shown = ", ".join(names[:NUM_NAMES])
    more = len(names) - NUM_NAMES
    return f"{shown} and {more} more" if more > 0 else shown


def doubts(demonstration: Demonstration, evidence: Evidence, task: int) -> dict[str, str]:
    """Return what is odd about a demonstration next to nominal trajectories, by kind."""
    found = {
        "end": _odd_end(demonstration, evidence, task),
        "duration": _odd_duration(demonstration, evidence, task),
        "speed": _odd_speed(demonstration, evidence, task),
        "rate": _coarse(demonstration, evidence),
    }
    return {kind: text for kind, text in found.items() if text}


def _odd_end(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    problem = evidence.problem
    if problem.goal_names != problem.space.names:
        return ""
    goal, nominal = evidence.tasks.goal[task], float(evidence.summary.farthest_end[task])
    end = float(problem.space.relative_distance(demonstration.states[-1], goal))
    if end <= max(FAR_END, FACTOR * nominal):
        return ""
    return (
        f"ends {end:.2g} of the state space's extent away from its goal, where nominal "
        f"trajectories come within {nominal:.2g}: cut short, or the goal of another task?"
    )


def _odd_duration(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    if demonstration.times is None:
        return ""
    duration = float(demonstration.times[-1] - demonstration.times[0])
    longest = evidence.problem.num_steps * evidence.problem.dt
    shortest = float(evidence.summary.shortest[task])
    if duration > (1.0 + TIME_SLACK) * longest:
        return (
            f"lasts {duration:.4g} s, and the model's episodes at most {longest:.4g} s: another "
            "unit of t, or a horizon that is too short?"
        )
    if duration < (1.0 - TIME_SLACK) * shortest:
        return (
            f"lasts {duration:.4g} s, and nominal trajectories at least {shortest:.4g} s: cut "
            "short, or another unit of t?"
        )
    return ""


def _odd_speed(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    problem, states, times = evidence.problem, demonstration.states, demonstration.times
    horizon = problem.num_steps * problem.dt
    if times is None:  # as if it lasted as long as the model's episodes
        times = np.linspace(0.0, horizon, len(states))
    steps = np.abs(problem.space.difference(states[:-1], states[1:])) / np.diff(times)[:, None]
    # sorted by hand: np.quantile loads another 30 ms of NumPy
    speed = np.sort(steps, axis=0)[int(FAST_SHARE * (len(steps) - 1))]
    nominal = np.maximum(evidence.summary.fastest[task], 1e-6 * problem.space.extent / horizon)
    worst = int((speed / nominal).argmax())
    if speed[worst] <= FAST * nominal[worst]:
        return ""
    return (
        f"changes {problem.space.names[worst]} by {speed[worst]:.3g} a second, "
        f"{speed[worst] / nominal[worst]:.0f} times as fast as any nominal trajectory: another "
        "unit, such as degrees, or another t?"
    )


def _coarse(demonstration: Demonstration, evidence: Evidence) -> str:
    problem, times = evidence.problem, demonstration.times
    if times is None or not problem.between_states:
        return ""
    widest = float(np.diff(times).max())
    if widest <= COARSE * problem.dt:
        return ""
    return (
        f"has states up to {widest:.3g} s apart, where the model steps every {problem.dt:.3g} s: "
        "the straight lines between them may cut through what was avoided, and strike it out"
    )


def _doubts(inference: Inference) -> Iterator[str]:
    """Yield each kind of doubt once, with the demonstrations that it is about."""
    found: dict[str, list[tuple[str, str]]] = {}
    for demonstration, task in zip(inference.demonstrations, inference.task_of, strict=True):
        for kind, text in doubts(demonstration, inference.evidence, int(task)).items():
            found.setdefault(kind, []).append((demonstration.name, text))
    for cases in found.values():
        name, text = cases[0]
        others = [other for other, _ in cases[1:]]
        also = f" (so it is with {some_names(others)})" if others else ""
        yield f"{name} {text}{also}"


def _exhausted(inference: Inference) -> Iterator[str]:
    if not len(inference.ranking):
        entered = inference.entered.sum(axis=1)
        yield (
            f"no hypothesis is left: each of the {len(inference.struck_out)} is entered by at "
            f"least one demonstration ({inference.demonstrations[int(entered.argmax())].name} "
            f"alone enters {entered.max()}). The constraint is not among the hypotheses, or the "
            "demonstrations are not of this problem"
        )


def _low_samples(inference: Inference) -> Iterator[str]:
    evidence, used = inference.evidence, inference.task_counts > 0
    ess, num = evidence.effective_sample_size, evidence.num_trajectories
    low = (ess < max(LOW_ESS, LOW_ESS_SHARE * num)) & used
    if low.any():
        worst = int(np.flatnonzero(low)[ess[low].argmin()])
        yield (
            f"not to be trusted: the effective sample size is too low for {low.sum()} of "
            f"{np.count_nonzero(used)} tasks (worst: {inference.task_name(worst)}, "
            f"{ess[worst]:.0f} of {num}). {_remedy(ess[worst] / num, evidence.solver)}"
        )


def _remedy(share: float, solver: str) -> str:
    """Return what to do about an effective sample size that is this share of N."""
    if share > GOOD_ESS_SHARE:
        return f"Sample more trajectories: at least {LOW_ESS / share:.0f}"
    if solver.startswith("Grid("):
        return "The grid is too coarse for this problem: give it more num_points"
    return (
        "The policy is far from pi_0: train it longer, or use the grid solver where the state "
        "has at most 3 dimensions"
    )


def _floored(inference: Inference) -> Iterator[str]:
    """Yield that scores are lower bounds where almost every nominal trajectory enters."""
    evidence, ranking = inference.evidence, inference.ranking
    floored = evidence.is_floored & (inference.task_counts > 0)[:, None]
    bounds = ranking[np.flatnonzero(floored[:, ranking].any(axis=0))]
    if len(bounds):
        names = some_names([f"hypothesis {index}" for index in bounds])
        resolution = evidence.resolution[floored[:, bounds].any(axis=1)]
        yield (
            f"the score of {names} is only a lower bound: almost every nominal trajectory of a "
            "task enters it, and for each demonstration of such a task the samples tell no more "
            f"than about {-math.log(resolution.min()):.1f} nats"
        )
