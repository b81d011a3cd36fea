"""Judging demonstrations: whether they fit the problem, of which tasks they are, what they enter.

Shapes: D demonstrations, L states, n state dimensions, m action dimensions, H hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swerve.constraints import violates
from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence
from swerve.hypotheses import HypothesisSet, unpack
from swerve.problem import ProblemRecord
from swerve.space import Actions
from swerve.state_checks import (
    check_finite,
    check_horizon,
    check_start,
    check_states,
    check_transitions,
    row_namer,
)

AT_ONCE = 64  # demonstrations judged together


def judge(
    demonstrations: Sequence[Demonstration], evidence: Evidence, hypotheses: HypothesisSet
) -> tuple[np.ndarray, np.ndarray]:
    """Check demonstrations; return their tasks in the evidence [D] and what they enter [D, H].

    Args:
      demonstrations: finished ones.
      evidence: what they are held against.
      hypotheses: what they may have entered: those of the problem, or what is left of them where
        measurement noise is allowed for.

    Raises:
      ValueError: if one is none, does not fit the problem, or there is no evidence for its task.
    """
    for item in demonstrations:
        if not isinstance(item, Demonstration):
            raise ValueError(
                f"expected a list of swerve.Demonstration, got a {type(item).__name__} in it: "
                "make one with swerve.Demonstration(name, states, task)"
            )
    tasks = np.zeros(len(demonstrations), int)
    entered = np.zeros((len(demonstrations), len(hypotheses)), bool)
    for first in range(0, len(demonstrations), AT_ONCE):
        block = demonstrations[first : first + AT_ONCE]
        tasks[first : first + AT_ONCE] = [_checked(item, evidence) for item in block]
        entered[first : first + AT_ONCE] = _entered(block, evidence.problem, hypotheses)
    return tasks, entered


def _checked(demonstration: Demonstration, evidence: Evidence) -> int:
    """Return the task of a demonstration in the evidence, after checking that it fits."""
    problem, states = evidence.problem, demonstration.states
    check_states(states, demonstration.times, problem.space, demonstration.name)
    check_start(states[0], demonstration.task, problem.space, demonstration.name)
    if problem.transitions is not None:
        actions = _actions(demonstration, problem, demonstration.actions is not None)
        check_transitions(
            states, actions and actions.values, problem.transitions, demonstration.name
        )
        num_moves = int((~problem.transitions.rests(states)).sum())
        check_horizon(num_moves, problem.num_steps, demonstration.name)
    _check_known(demonstration, problem)
    _check_goal(demonstration, evidence)
    return evidence.match(demonstration.task, demonstration.name)


def _entered(
    demonstrations: Sequence[Demonstration], problem: ProblemRecord, hypotheses: HypothesisSet
) -> np.ndarray:
    """Return what demonstrations enter [D, H]; all are judged at once, resting after their end."""
    longest = max(len(item.states) for item in demonstrations)
    rows = [np.minimum(np.arange(longest), len(item.states) - 1) for item in demonstrations]
    states = np.stack([item.states[row] for item, row in zip(demonstrations, rows, strict=True)])
    actions = None
    if hypotheses.about_actions:
        values = np.full((len(states), longest - 1, len(problem.action_names)), np.nan)
        for row, item in zip(values, demonstrations, strict=True):
            taken = _actions(item, problem, needed=True)
            assert taken is not None
            row[: len(taken.values)] = taken.values
        actions = Actions(problem.action_names, values)
    bits = hypotheses.violations(states, problem.space, problem.between_states, actions)
    return unpack(bits, len(hypotheses))


def _check_known(demonstration: Demonstration, problem: ProblemRecord) -> None:
    """Refuse a demonstration that enters a known constraint: under the model it cannot happen."""
    for constraint in problem.known:
        actions = _actions(demonstration, problem, constraint.about_actions)
        states, between = demonstration.states, problem.between_states
        if violates(constraint, states, problem.space, between, actions):
            raise ValueError(
                f"{demonstration.name} enters the known constraint {constraint.name}, which the "
                "problem says nobody can: correct the demonstration (units, frame) or `known`"
            )


def _actions(demonstration: Demonstration, problem: ProblemRecord, needed: bool) -> Actions | None:
    """Return the actions of a demonstration [L-1, m] where they are needed."""
    if not needed:
        return None
    names, values = problem.action_names, demonstration.actions
    if values is None or values.shape[1] != len(names):
        raise ValueError(
            f"{demonstration.name}: the problem has constraints on actions, so a demonstration "
            f"needs its actions, columns {', '.join(names)}, got "
            f"{'none' if values is None else f'{values.shape[1]} of them'}"
        )
    values = values[: len(demonstration.states) - 1]
    check_finite(values, names, row_namer(demonstration.name, None))
    return Actions(names, values)


def _check_goal(demonstration: Demonstration, evidence: Evidence) -> None:
    expected, got = evidence.tasks.goal.shape[1], len(demonstration.task.goal)
    if got != expected:
        names = ", ".join(evidence.problem.goal_names)
        raise ValueError(
            f"{demonstration.name}: expected a goal of {expected} numbers ({names}), got {got}"
        )
