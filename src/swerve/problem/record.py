"""Hold a problem as plain data, as it is stored with a result.

The nominal distribution of the problem is

    pi_0(xi) = m(xi) exp(beta R(xi)) / Z_0

over the trajectories that avoid the known constraints, with base measure m = 1 ("counting") or
m = A^-length ("uniform"). A record holds the whole problem except the code of the dynamics, so that
inference needs neither JAX nor user code.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from swerve.base.space import StateSpace, Transitions
from swerve.constraints.base import Constraint
from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.stored import hypotheses_from_json

MEASURES = ("uniform", "counting")


@dataclass(frozen=True, eq=False)
class ProblemRecord:
    """A problem as plain data: everything except the code of the dynamics.

    Attributes:
      name: the MDP and its parameters, for people to read.
      goal_is_last_state: whether the MDP keeps the default `MDP.goal_of`.
      mdp_digest: hash of the MDP's class name, parameters and actions.
      transitions: transitions of a tabular MDP; None for other MDPs.
      is_timed: as in `MDP`; of no account for the fingerprint, as no number depends on it.
      Other attributes: as in `Problem` and `MDP`.
    """

    name: str
    space: StateSpace
    action_names: tuple[str, ...]
    goal_names: tuple[str, ...]
    goal_is_last_state: bool
    num_actions: int
    num_steps: int
    dt: float
    hypotheses: HypothesisSet
    known: tuple[Constraint, ...]
    beta: float
    measure: str
    between_states: bool
    mdp_digest: str
    transitions: Transitions | None = None
    is_timed: bool = True

    @property
    def needs_code(self) -> bool:
        """Whether judging a demonstration needs user functions, which no file can hold."""
        return self.hypotheses.needs_code or any(c.needs_code for c in self.known)

    @property
    def fingerprint(self) -> str:
        """A hash of the model, the hypotheses and all settings."""
        data = self.to_json()
        del data["is_timed"]
        return digest(json.dumps(data))  # not sorted: the order of a grid's axes counts

    @property
    def summary(self) -> str:
        """The model and the settings that results depend on, in one line for people."""
        known = f", known: {'; '.join(c.name for c in self.known)}" if self.known else ""
        judged = "states and segments between them" if self.between_states else "states alone"
        return (
            f"{self.name}, beta {self.beta:g}, {self.measure} measure, "
            f"{len(self.hypotheses)} hypotheses judged at {judged}{known}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        data = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return data | {
            "space": self.space.to_json(),
            "hypotheses": self.hypotheses.to_json(),
            "known": [constraint.to_json() for constraint in self.known],
            "action_names": list(self.action_names),
            "goal_names": list(self.goal_names),
            "transitions": self.transitions
            and [np.asarray(values).tolist() for values in self.transitions],
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> ProblemRecord:
        """Rebuild a record from `to_json` data."""
        return cls(
            **data
            | {
                "space": StateSpace.from_json(data["space"]),
                "hypotheses": hypotheses_from_json(data["hypotheses"]),
                "known": tuple(constraint_from_json(item) for item in data["known"]),
                "action_names": tuple(data["action_names"]),
                "goal_names": tuple(data["goal_names"]),
                "transitions": data["transitions"] and _transitions(*data["transitions"]),
            }
        )


def _transitions(shape: list, successors: list, actions: list) -> Transitions:
    return Transitions(tuple(shape), np.array(successors), np.array(actions))


def digest(text: str) -> str:
    """Return the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()
