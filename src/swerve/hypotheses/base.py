"""Define sets of hypotheses, and judge which hypotheses each trajectory of a batch enters.

The answer for N trajectories and H hypotheses is one bit per pair, packed as `bits` says.

Shapes: N trajectories, T steps, n state dimensions, m action dimensions, H hypotheses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.space import Actions, StateSpace
from swerve.constraints.base import Constraint, check_constraints, violates
from swerve.hypotheses.bits import no_bits, set_one


class HypothesisSet(ABC):
    """H hypotheses, numbered 0 to H - 1."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def constraint(self, index: int) -> Constraint:
        """Return hypothesis `index` as a constraint."""

    @abstractmethod
    def violations(
        self,
        states: np.ndarray,
        space: StateSpace,
        between_states: bool,
        actions: Actions | None = None,
    ) -> np.ndarray:
        """Return packed bits [N, ceil(H / 8)], set where a trajectory enters a hypothesis.

        Args:
          states: [N, T+1, n] trajectories.
          space: names, angles and bounds of the states.
          between_states: whether the segments between states count as well.
          actions: [N, T, m], required if a hypothesis is about actions.
        """

    @abstractmethod
    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a hypothesis does not fit the states or the actions."""

    @property
    @abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """The states that the hypotheses name, in the order in which pictures show them."""

    @property
    def needs_code(self) -> bool:
        """Whether judging a trajectory needs Python functions, which no file can hold."""
        return False

    @property
    def about_actions(self) -> bool:
        """Whether judging a trajectory needs its actions."""
        return False

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return JSON data from which `hypotheses_from_json` rebuilds the set."""

    def _check_index(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise ValueError(f"hypothesis {index}: expected an index from 0 to {len(self) - 1}")

    def name(self, index: int) -> str:
        """Return the name of hypothesis `index`."""
        return self.constraint(index).name

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [..., H] from states [..., n] to each hypothesis.

        Raises:
          ValueError: if a hypothesis has no shape to measure distances to, see
            `Constraint.distance`.
        """
        states = np.asarray(states, float)
        each = [self.constraint(index).distance(states, space) for index in range(len(self))]
        return np.stack(each, axis=-1)

    def eroded(self, margin: Mapping[str, float], space: StateSpace) -> HypothesisSet:
        """Return the same hypotheses, each made smaller by a margin for measurement noise.

        Args:
          margin: for some states, by name, how deep inside a hypothesis a state must lie, in the
            state's unit.
          space: names, angles and bounds of the states.

        Raises:
          ValueError: if a margin is negative or not a number, names no state, or leaves nothing of
            a hypothesis.
        """
        each = (self.constraint(index).eroded(margin, space) for index in range(len(self)))
        return ConstraintHypotheses(each)


class ConstraintHypotheses(HypothesisSet):
    """Any constraints as hypotheses; the cost of judging a trajectory grows with their number."""

    def __init__(self, constraints: Iterable[Constraint]) -> None:
        if isinstance(constraints, Constraint) or not isinstance(constraints, Iterable):
            raise ValueError(
                f"hypotheses: expected a list of constraints, or one of swerve.grid and "
                f"swerve.windows, got {constraints!r}"
            )
        self.constraints = tuple(constraints)
        if not self.constraints:
            raise ValueError("hypotheses: expected at least one constraint, got an empty list")

    def __len__(self) -> int:
        return len(self.constraints)

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states that the constraints name, in the order in which they first appear."""
        return tuple(dict.fromkeys(name for c in self.constraints for name in c.spans))

    @property
    def needs_code(self) -> bool:
        """Whether one of the constraints is a predicate."""
        return any(constraint.needs_code for constraint in self.constraints)

    @property
    def about_actions(self) -> bool:
        """Whether one of the constraints forbids actions."""
        return any(constraint.about_actions for constraint in self.constraints)

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a constraint does not fit the states or the actions."""
        check_constraints(self.constraints, space, action_names, "hypotheses")

    def constraint(self, index: int) -> Constraint:
        """Return constraint `index`."""
        self._check_index(index)
        return self.constraints[index]

    def violations(
        self,
        states: np.ndarray,
        space: StateSpace,
        between_states: bool,
        actions: Actions | None = None,
    ) -> np.ndarray:
        """Return packed bits [N, ceil(H / 8)]."""
        states = np.asarray(states, np.float64)
        bits = no_bits(len(states), len(self))
        for index, constraint in enumerate(self.constraints):
            set_one(bits, index, violates(constraint, states, space, between_states, actions))
        return bits

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"kind": "constraints", "constraints": [c.to_json() for c in self.constraints]}
