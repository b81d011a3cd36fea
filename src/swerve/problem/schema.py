"""Check stored problems: the types of what `ProblemRecord.to_json` returns, see `base.schema`."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from swerve.base.files import AnyPath
from swerve.base.schema import Count, Data, Finite, Names, Positive, checked, contents
from swerve.base.space import Transitions
from swerve.constraints.base import check_constraints
from swerve.constraints.schema import ConstraintData
from swerve.hypotheses.schema import HypothesesData
from swerve.problem.record import ProblemRecord


class SpaceData(Data):
    """A `StateSpace`."""

    names: Names
    angles: Names
    bounds: list[tuple[Finite, Finite]]
    is_lattice: bool


class RecordData(Data):
    """A `ProblemRecord`."""

    name: str
    space: SpaceData
    action_names: Names
    goal_names: Names
    goal_is_last_state: bool
    num_actions: Count
    num_steps: Count
    dt: Positive
    hypotheses: HypothesesData
    known: list[ConstraintData]
    beta: Positive
    measure: Literal["uniform", "counting"]
    between_states: bool
    mdp_digest: str
    transitions: tuple[list[Count], list[list[int]], list[list[Finite]]] | None = None
    is_timed: bool = True


def stored_record(path: AnyPath, data: Any) -> ProblemRecord:
    """Rebuild the record of a problem from data that others may have written.

    Args:
      path: the file that the data are from, for messages.
      data: what `ProblemRecord.to_json` returned.

    Raises:
      StoreError: if the data are not those of a problem.
    """
    checked(path, data, RecordData)
    with contents(path):
        record = ProblemRecord.from_json(data)
        for names in (record.action_names, record.goal_names):
            if len(set(names)) < len(names):
                raise ValueError(f"names that are used twice: {', '.join(names)}")
        record.hypotheses.check(record.space, record.action_names)
        check_constraints(record.known, record.space, record.action_names, "known")
        if record.transitions is not None:
            _check_transitions(record, record.transitions)
    return record


def _check_transitions(record: ProblemRecord, transitions: Transitions) -> None:
    """Raise ValueError where a table of transitions does not fit the states and the actions."""
    num_states, num_actions = math.prod(transitions.shape), record.num_actions
    sizes = {
        "lengths of the states": (np.shape(transitions.shape), (len(record.space.names),)),
        "successors": (transitions.successors.shape, (num_states, num_actions)),
        "actions": (transitions.actions.shape, (num_actions, len(record.action_names))),
    }
    for name, (size, expected) in sizes.items():
        if size != expected:
            raise ValueError(f"transitions: {name} of shape {size}, expected {expected}")
    if transitions.successors.max() >= num_states:
        raise ValueError(f"transitions: a successor is beyond the {num_states} states")
