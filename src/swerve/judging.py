"""Judging a demonstration: whether it fits the problem, which task it is of, what it enters.

Shapes: L states, n state dimensions, m action dimensions, B = ceil(H / 8) bytes.
"""

from __future__ import annotations

import numpy as np

from swerve.constraints import violates
from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence
from swerve.hypotheses import HypothesisSet
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


def judge(
    demonstration: Demonstration, evidence: Evidence, hypotheses: HypothesisSet
) -> tuple[int, np.ndarray]:
    """Check a demonstration; return its task in the evidence and packed bits [B] of what it enters.

    Args:
      demonstration: a finished one.
      evidence: what it is held against.
      hypotheses: what it may have entered: those of the problem, or what is left of them where
        measurement noise is allowed for.

    Raises:
      ValueError: if it is none, does not fit the problem, or there is no evidence for its task.
    """
    if not isinstance(demonstration, Demonstration):
        raise ValueError(
            f"expected a list of swerve.Demonstration, got a {type(demonstration).__name__} in it: "
            "make one with swerve.Demonstration(name, states, task)"
        )
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
    task = evidence.match(demonstration.task, demonstration.name)
    actions = _actions(demonstration, problem, problem.hypotheses.about_actions)
    if actions is not None:
        actions = actions._replace(values=actions.values[None])
    bits = hypotheses.violations(states[None], problem.space, problem.between_states, actions)
    return task, bits[0]


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
