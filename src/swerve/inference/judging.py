"""Judge demonstrations: whether they fit the problem, their tasks, and the hypotheses entered.

Shapes: D demonstrations, L states, n state dimensions, m action dimensions, H hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swerve.base.space import Actions, Task
from swerve.constraints.base import violates
from swerve.demonstrations.batch import checked_states
from swerve.demonstrations.checks import (
    check_finite,
    check_horizon,
    check_transitions,
    row_namer,
)
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.headers import why_absent
from swerve.evidence.evidence import Evidence
from swerve.evidence.matching import match_each
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.problem.record import ProblemRecord

AT_ONCE = 64  # demonstrations judged together: bounds the memory for their states


def judge(
    demonstrations: Sequence[Demonstration], evidence: Evidence, hypotheses: HypothesisSet
) -> tuple[np.ndarray, np.ndarray]:
    """Check demonstrations; return their tasks in the evidence [D], and True [D, H] where entered.

    Args:
      demonstrations: finished demonstrations.
      evidence: evidence for the tasks of all demonstrations.
      hypotheses: H regions that demonstrations may enter: the hypotheses of the problem, less a
        margin where measurement noise is allowed for.

    Raises:
      ValueError: if an item is not a Demonstration or does not fit the problem, or its task has no
        evidence.
    """
    for item in demonstrations:
        if not isinstance(item, Demonstration):
            raise ValueError(
                f"expected a list of swerve.Demonstration, got a {type(item).__name__} in it: "
                "make one with swerve.Demonstration(name, states, task)"
            )
    entered = np.zeros((len(demonstrations), len(hypotheses)), bool)
    for first in range(0, len(demonstrations), AT_ONCE):
        block = demonstrations[first : first + AT_ONCE]
        states = checked_states(block, evidence.problem.space)
        for item in block:
            _check_fits(item, evidence)
        entered[first : first + AT_ONCE] = _entered(block, states, evidence.problem, hypotheses)
    tasks = Task.stack([item.task for item in demonstrations])
    names = [item.name for item in demonstrations]
    return match_each(evidence.problem, evidence.tasks, tasks, names), entered


def _check_fits(demonstration: Demonstration, evidence: Evidence) -> None:
    """Raise ValueError where a demonstration does what the problem does not allow."""
    problem, states = evidence.problem, demonstration.states
    if problem.transitions is not None:
        actions = _actions(demonstration, problem, demonstration.actions is not None)
        check_transitions(
            states, actions and actions.values, problem.transitions, demonstration.name
        )
        num_moves = int((~problem.transitions.rests(states)).sum())
        check_horizon(num_moves, problem.num_steps, demonstration.name)
    _check_known(demonstration, problem)
    _check_goal(demonstration, evidence)


def _entered(
    demonstrations: Sequence[Demonstration],
    states: np.ndarray,
    problem: ProblemRecord,
    hypotheses: HypothesisSet,
) -> np.ndarray:
    """Return [D, H] True where a demonstration, by its states [D, L, n], enters a hypothesis."""
    actions = None
    if hypotheses.about_actions:
        values = np.full((*states[:, 1:, 0].shape, len(problem.action_names)), np.nan)
        for row, item in zip(values, demonstrations, strict=True):
            taken = _actions(item, problem, needed=True)
            assert taken is not None
            row[: len(taken.values)] = taken.values
        actions = Actions(problem.action_names, values)
    bits = hypotheses.violations(states, problem.space, problem.between_states, actions)
    return unpack(bits, len(hypotheses))


def _check_known(demonstration: Demonstration, problem: ProblemRecord) -> None:
    """Raise ValueError where a demonstration enters a known constraint."""
    for constraint in problem.known:
        actions = _actions(demonstration, problem, constraint.about_actions)
        states, between = demonstration.states, problem.between_states
        if violates(constraint, states, problem.space, between, actions):
            raise ValueError(
                f"{demonstration.name} enters the known constraint {constraint.name}, which the "
                "problem says nobody can enter: correct the demonstration (units, frame) or `known`"
            )


def _actions(demonstration: Demonstration, problem: ProblemRecord, needed: bool) -> Actions | None:
    """Return the actions [L-1, m] of a demonstration; None where no actions are needed.

    NaN stands for rows of a tabular MDP that repeat the last state, although no action stays there:
    the episode has ended, and whatever is recorded is no action.
    """
    if not needed:
        return None
    names, values = problem.action_names, demonstration.actions
    if values is None or values.shape[1] != len(names):
        raise ValueError(
            f"{demonstration.name}: the problem has constraints on actions, so a demonstration "
            f"needs its actions, columns {', '.join(names)}, got "
            f"{'none' if values is None else f'{values.shape[1]} of them'}"
            f"{why_absent(names, demonstration.notes)}"
        )
    values = values[: len(demonstration.states) - 1]
    check_finite(values, names, row_namer(demonstration.name, None))
    if problem.transitions is not None:
        states, transitions = demonstration.states, problem.transitions
        ended = transitions.rests(states) & ~transitions.fits(states).any(axis=1)
        values = np.where(ended[:, None], np.nan, values)
    return Actions(names, values)


def _check_goal(demonstration: Demonstration, evidence: Evidence) -> None:
    expected, got = evidence.tasks.goal.shape[1], len(demonstration.task.goal)
    if got != expected:
        names = ", ".join(evidence.problem.goal_names)
        raise ValueError(
            f"{demonstration.name}: expected a goal of {expected} numbers ({names}), got {got}"
        )
