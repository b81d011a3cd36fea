"""Give the reasons against trusting an inference, in plain words.

A demonstration is compared with nominal trajectories of its task. The demonstration need not
resemble them, but its end, its duration and its speed should be of the same order of magnitude.

Shapes: n state dimensions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from swerve.base.phrases import some_names
from swerve.base.solver_kinds import kind_stored
from swerve.constraints.base import violates
from swerve.demonstrations.checks import FAST, JITTER, START_TOLERANCE
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.inference.ranking import Ranking
from swerve.trust import bounds, verdicts
from swerve.trust.hypothesis_doubts import hypothesis_warnings
from swerve.trust.impossible import against_dynamics
from swerve.trust.time_doubts import FAST_SHARE, time_doubts, why_jump

FAR_END = 0.05  # share of a state's extent: a demonstration that ends nearer its goal has arrived
FACTOR = 2.0  # times the reach of nominal ends: an end beyond is odd


def warnings(inference: Ranking) -> tuple[str, ...]:
    """Return warnings about the ranking; empty if there are none."""
    problem = inference.evidence.problem
    return (
        *_exhausted(inference),
        *_left_out(inference),
        *_impossible(inference),
        *_of_samples(inference),
        *(() if inference.evidence.is_exact else bounds.hardly_avoided(inference)),
        *_grazed(inference),
        *hypothesis_warnings(problem.hypotheses, problem.space, problem.known),
        *_doubts(inference),
    )


def data_warnings(inference: Ranking) -> tuple[str, ...]:
    """Return the warnings about samples and demonstrations that hold for every use of them."""
    return (*_of_samples(inference), *_doubts(inference))


def _of_samples(inference: Ranking) -> Iterator[str]:
    is_exact = inference.evidence.is_exact
    return _tabled(inference) if is_exact else verdicts.warnings(inference)


def doubts(demonstration: Demonstration, evidence: Evidence, task: int) -> dict[str, str]:
    """Return the oddities of a demonstration beside nominal trajectories, by kind of doubt."""
    is_known = evidence.is_exact or not evidence.has_too_few[task]
    problem, motion = evidence.problem, evidence.motion
    found = {f"columns: {note}": note for note in demonstration.notes}
    found |= {"still": _still(demonstration, evidence)}
    found |= {"end": _odd_end(demonstration, evidence, task) if is_known else ""}
    if problem.is_timed:
        found |= time_doubts(demonstration, evidence, task)
    elif problem.transitions is None:
        found["move"] = _odd_move(demonstration, evidence, task)
    if motion is not None:
        text = against_dynamics(demonstration, problem, motion)
        found[f"dynamics: {text.rpartition('. ')[2]}"] = text  # each cause is told by itself
    return {kind: text for kind, text in found.items() if text}


def _still(demonstration: Demonstration, evidence: Evidence) -> str:
    states, space = demonstration.states, evidence.problem.space
    moved = np.abs(space.difference(states[:1], states)).max(axis=0)
    if (moved > START_TOLERANCE * space.unit).any():
        return ""
    place = ", ".join(f"{n} = {x:.4g}" for n, x in zip(space.names, states[0], strict=True))
    return (
        f"never moves: all of its {len(states)} rows are at {place}. Another column, or a "
        "recording that was not running? It avoids every hypothesis but those that it is in"
    )


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


def _odd_move(demonstration: Demonstration, evidence: Evidence, task: int) -> str:
    """Return what is odd about the moves of a demonstration, whatever time they took.

    A move after a gap of time may be longer than others, in proportion.
    """
    problem, space, times = evidence.problem, evidence.problem.space, demonstration.times
    moved = np.abs(space.difference(demonstration.states[:-1], demonstration.states[1:]))
    usual = np.sort(moved, axis=0)[int(FAST_SHARE * (len(moved) - 1))]
    largest = evidence.summary.fastest[task] * problem.dt
    far = usual - FAST * largest - JITTER * space.extent
    i = int((far / space.extent).argmax())
    if problem.between_states and far[i] > 0.0:
        return (
            f"has rows {usual[i]:.3g} apart in {space.names[i]}, where a move of the model changes "
            f"it by at most {largest[i]:.3g}: the straight lines between them may cut through a "
            "hypothesis that was avoided, and strike it out"
        )
    elapsed = np.ones(len(moved)) if times is None else np.diff(times)
    gap = np.maximum(elapsed / np.partition(elapsed, len(elapsed) // 2)[len(elapsed) // 2], 1.0)
    beyond = moved - FAST * np.maximum(largest, usual) * gap[:, None] - JITTER * space.extent
    row, i = (int(k) for k in np.unravel_index((beyond / space.extent).argmax(), moved.shape))
    if beyond[row, i] <= 0.0:
        return ""
    return (
        f"jumps by {moved[row, i]:.3g} in {space.names[i]} from row {row + 1} to row {row + 2}, "
        f"where a move of the model changes it by at most {largest[i]:.3g}, and the other rows by "
        f"{usual[i]:.3g} as a rule: {why_jump(demonstration, row, space)} Hypotheses on the "
        "straight line between the rows count as entered"
    )


def _doubts(inference: Ranking) -> Iterator[str]:
    """Yield each kind of doubt once, with the names of its demonstrations."""
    found: dict[str, list[tuple[str, str]]] = {}
    for demonstration, task in zip(inference.demonstrations, inference.task_of, strict=True):
        for kind, text in doubts(demonstration, inference.evidence, int(task)).items():
            found.setdefault(kind, []).append((demonstration.name, text))
    yield from _again(inference)
    for cases in found.values():
        name, text = cases[0]
        others = [other for other, _ in cases[1:]]
        also = f" (the same holds for {some_names(others)})" if others else ""
        yield f"{name} {text}{also}"


def _again(inference: Ranking) -> Iterator[str]:
    """Yield a warning for demonstrations that were given more than once."""
    found: dict[bytes, list[str]] = {}
    for item in inference.demonstrations:
        parts = (item.states, item.task.start, item.task.goal)
        digest = hashlib.sha256(b"".join(part.tobytes() for part in parts)).digest()
        found.setdefault(digest, []).append(item.name)
    for names in found.values():
        if len(names) > 1:
            yield (
                f"{names[0]} is given {len(names)} times (as {some_names(names)}): each copy "
                "counts as a separate demonstration"
            )


def _grazed(inference: Ranking) -> Iterator[str]:
    """Yield a warning where the first hypothesis profits from the margin."""
    problem = inference.evidence.problem
    if inference.judged is problem.hypotheses or not len(inference.ranking):
        return
    best = int(inference.ranking[0])
    constraint = problem.hypotheses.constraint(best)
    grazing = [
        item.name
        for d, item in enumerate(inference.demonstrations)
        if inference.is_counted[inference.task_of[d], best]
        and not inference.entered[d, best]
        and violates(constraint, item.states, problem.space, problem.between_states)
    ]
    if grazing:
        yield (
            f"{len(grazing)} of {len(inference.demonstrations)} demonstrations "
            f"({some_names(grazing)}) enter hypothesis {best} no deeper than the margin, which "
            "counts as avoiding it, while nominal trajectories are judged without a margin: the "
            "hypothesis seems more probable than it is. Take a margin as small as the noise"
        )


def _exhausted(inference: Ranking) -> Iterator[str]:
    if not len(inference.ranking) and inference.demonstrations:
        entered = inference.entered.sum(axis=1)
        yield (
            f"no hypothesis is left: each of the {len(inference.struck_out)} is entered by at "
            f"least one demonstration ({inference.demonstrations[int(entered.argmax())].name} "
            f"alone enters {entered.max()}). There is no constraint, or it is not among the "
            "hypotheses, or the demonstrations are not of this problem"
            f"{tolerable(inference)}"
        )


def _left_out(inference: Ranking) -> Iterator[str]:
    """Yield a warning about hypotheses that are too near the ends of all tasks."""
    num = np.count_nonzero(~inference.is_used.any(axis=0))
    if num:
        yield (
            f"these demonstrations tell nothing about {num} of the {len(inference.struck_out)} "
            "hypotheses, since each task starts or ends within the clearance of these hypotheses, "
            "or grazes them: their probability stays as it was"
        )


def _impossible(inference: Ranking) -> Iterator[str]:
    """Yield a warning about hypotheses that no trajectory of a task avoids."""
    found = np.flatnonzero(inference.impossible & ~inference.entered.any(axis=0))
    if len(found):
        names = some_names([f"hypothesis {index}" for index in found])
        yield (
            f"{names} struck out: according to {inference.evidence.solver}, every trajectory of "
            f"a task enters, so nobody could do that task and obey{_or_coarse(inference)}"
        )


def _or_coarse(inference: Ranking) -> str:
    """Return another possible cause where cells are judged at their centres; '' elsewhere."""
    if not kind_stored(inference.evidence.solver).tabulates:
        return ""
    return (
        "; or the task starts near an edge, and cells are too wide: give the solver more num_cells"
    )


def _tabled(inference: Ranking) -> Iterator[str]:
    """Yield a warning that a table of cells is not the continuous dynamics."""
    if kind_stored(inference.evidence.solver).tabulates:
        yield (
            "answers are exact for a table of cells, not for the dynamics: their error is not "
            "known. See whether the answers change with num_cells and hold"
        )


def tolerable(inference: Ranking) -> str:
    """Return a text with the least tolerance that leaves a hypothesis, where all are struck out."""
    tolerance = inference.least_tolerance
    if tolerance is None:
        return "; no tolerance makes a hypothesis more probable than no constraint"
    return (
        f"; with a tolerance of about {tolerance:.2g} or more (some demonstrations then ignore "
        "the constraint), one hypothesis would be more probable than no constraint"
    )
