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
HIGH_KL = {"importance": 0.5, "plain": 0.1}  # nats, between policy and pi_0
VALUE_GAP = 0.1  # nats, between a solver's log Z_0 and that of its samples
NUM_ERRORS = 3.0  # standard errors on top
GOOD_ESS_SHARE = 0.3  # above it the policy is not what is wrong
FAR_END = 0.05  # of the extent: within it of its goal a demonstration has arrived
FACTOR = 2.0  # beyond nominal trajectories in where it ends
FAST = 3.0  # times the fastest nominal change of a state
FAST_SHARE = 0.9  # of a demonstration's steps may be slower: noise makes single steps fast
TIME_SLACK = 0.1  # of the duration
COARSE = 1.5  # of the model's steps, between two states of a demonstration
TABLED = "Discrete("  # the solver that makes a table of continuous dynamics
NUM_NAMES = 3  # demonstrations named in a warning


def warnings(inference: Inference) -> tuple[str, ...]:
    """Return what speaks against trusting the ranking; empty if nothing does."""
    return (
        *_exhausted(inference),
        *_impossible(inference),
        *(_tabled(inference) if inference.evidence.is_exact else _sampling(inference)),
        *_doubts(inference),
    )


def _sampling(inference: Inference) -> Iterator[str]:
    """Yield what speaks against the samples."""
    yield from _low_samples(inference)
    yield from _far_policy(inference)
    yield from _wrong_value(inference)
    yield from _floored(inference)


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
    problem, space, end = evidence.problem, evidence.problem.space, demonstration.states[-1]
    is_state = problem.goal_names == space.names
    if is_state and space.relative_distance(end, evidence.tasks.goal[task]) <= FAR_END:
        return ""
    middle, reach = evidence.summary.end[task], evidence.summary.end_reach[task]
    away = space.difference(middle, end)
    beyond = np.abs(away) - np.maximum(reach + FAR_END * space.extent, FACTOR * reach)
    worst = int((beyond / space.extent).argmax())
    if beyond[worst] <= 0.0:
        return ""
    low, high = middle[worst] - reach[worst], middle[worst] + reach[worst]
    return (
        f"ends at {space.names[worst]} = {middle[worst] + away[worst]:.3g}, where nominal "
        f"trajectories end between {low:.3g} and {high:.3g}: cut short, another unit, or the goal "
        "of another task?"
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
    if not len(inference.ranking) and inference.demonstrations:
        entered = inference.entered.sum(axis=1)
        yield (
            f"no hypothesis is left: each of the {len(inference.struck_out)} is entered by at "
            f"least one demonstration ({inference.demonstrations[int(entered.argmax())].name} "
            f"alone enters {entered.max()}). The constraint is not among the hypotheses, or the "
            "demonstrations are not of this problem"
        )


def _impossible(inference: Inference) -> Iterator[str]:
    """Yield which hypotheses forbid everything."""
    found = np.flatnonzero(inference.impossible & ~inference.entered.any(axis=0))
    if len(found):
        names = some_names([f"hypothesis {index}" for index in found])
        yield (
            f"{names} struck out: by {inference.evidence.solver} every trajectory of a task "
            f"enters, so nobody could do that task and obey{_or_coarse(inference)}"
        )


def _or_coarse(inference: Inference) -> str:
    """Return what else it may be where cells are judged at their centres."""
    if not inference.evidence.solver.startswith(TABLED):
        return ""
    return "; or it starts near an edge, and cells are too wide: give it more num_cells"


def _tabled(inference: Inference) -> Iterator[str]:
    """Yield that a table of continuous dynamics is not the dynamics."""
    if inference.evidence.solver.startswith(TABLED):
        yield (
            "answers are exact for a table of cells, not for the dynamics: how far off they are is "
            "not known. See whether they change with num_cells and hold"
        )


def _low_ess(inference: Inference) -> np.ndarray:
    """Return [K] whether a task that is used has too few effective samples."""
    least = max(LOW_ESS, LOW_ESS_SHARE * inference.evidence.num_trajectories)
    return (inference.evidence.effective_sample_size < least) & (inference.task_counts > 0)


def _low_samples(inference: Inference) -> Iterator[str]:
    evidence, used, low = inference.evidence, inference.task_counts > 0, _low_ess(inference)
    ess, num = evidence.effective_sample_size, evidence.num_trajectories
    if low.any():
        worst = int(np.flatnonzero(low)[ess[low].argmin()])
        yield (
            f"not to be trusted: the effective sample size is too low for {low.sum()} of "
            f"{np.count_nonzero(used)} tasks (worst: {inference.task_name(worst)}, "
            f"{ess[worst]:.0f} of {num}). {_remedy(ess[worst] / num, evidence.solver)}"
        )


def _far_policy(inference: Inference) -> Iterator[str]:
    """Yield that standard errors say nothing of what a policy far from pi_0 hardly ever does."""
    evidence = inference.evidence
    used = (inference.task_counts > 0) & ~_low_ess(inference)
    far = used & (evidence.kl > HIGH_KL[evidence.method])
    if far.any():
        worst = int(np.where(far, evidence.kl, 0.0).argmax())
        cause = "what it hardly ever does may be missing from them"
        if evidence.method == "plain":
            cause = "equal weights take it for pi_0: use importance weights"
        yield (
            f"errors may be larger than stated: for {far.sum()} of "
            f"{np.count_nonzero(inference.task_counts)} tasks the policy is more than "
            f"{HIGH_KL[evidence.method]:g} nats from pi_0 (worst: {inference.task_name(worst)}, KL "
            f"{evidence.kl[worst]:.2f}), and {cause}. {_remedy(0.0, evidence.solver)}"
        )


def _wrong_value(inference: Inference) -> Iterator[str]:
    """Yield that the solver's own log Z_0 is not what its samples say."""
    evidence = inference.evidence
    used = (inference.task_counts > 0) & ~_low_ess(inference)
    share = evidence.effective_sample_size / evidence.num_trajectories
    error = np.sqrt((1.0 / share - 1.0) / evidence.num_trajectories)  # of log Z_0
    # weights account for -log(share): where that share of trajectories survives a wall, say
    explained = NUM_ERRORS * error - np.log(share)
    gap = np.abs(evidence.soft_value - evidence.log_partition) - explained
    wrong = used & (gap > VALUE_GAP)  # not where the solver has no value: then the gap is NaN
    if wrong.any():
        worst = int(np.where(wrong, gap, 0.0).argmax())
        yield (
            f"errors may be larger than stated: for {wrong.sum()} of "
            f"{np.count_nonzero(inference.task_counts)} tasks the solver's log Z_0 is not that of "
            f"its samples (worst: {inference.task_name(worst)}, "
            f"{evidence.soft_value[worst]:.2f} and {evidence.log_partition[worst]:.2f} nats). "
            f"{_remedy(0.0, evidence.solver)}"
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
    bounds = ranking[inference.is_lower_bound[ranking]]
    if len(bounds):
        names = some_names([f"hypothesis {index}" for index in bounds])
        resolution = evidence.resolution[floored[:, bounds].any(axis=1)]
        yield (
            f"the score of {names} is only a lower bound: almost every nominal trajectory of a "
            "task enters it, and for each demonstration of such a task the samples tell no more "
            f"than about {-math.log(resolution.min()):.1f} nats"
        )
