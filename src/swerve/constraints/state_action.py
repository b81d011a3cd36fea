"""Define constraints that forbid actions in some states, such as fast driving in a narrow place.

    (s_t, a_t) lies in c    where s_t lies in the states and a_t in the actions;

s_t is the state in which the action begins; where the action leads does not matter.

Shapes: n state dimensions, m action dimensions, ... any batch dimensions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.space import Actions, StateSpace
from swerve.constraints.base import Constraint, nowhere
from swerve.constraints.boxes import ActionBox


class StateAction(Constraint):
    """Some actions, forbidden in some states: other actions there, and these elsewhere, are not.

    Args:
      states: the states in which the actions are forbidden.
      actions: the actions that are forbidden there.

    Raises:
      ValueError: if `states` is not a constraint on states alone, or `actions` is not an ActionBox.
    """

    about_actions = True

    def __init__(self, states: Constraint, actions: ActionBox) -> None:
        if not isinstance(states, Constraint) or states.about_actions:
            raise ValueError(
                "StateAction: expected a constraint on states alone first, such as a Box, got "
                f"{states!r}"
            )
        if not isinstance(actions, ActionBox):
            raise ValueError(f"StateAction: expected an ActionBox second, got {actions!r}")
        self.states, self.actions = states, actions
        self.needs_code = states.needs_code

    def __repr__(self) -> str:
        """Return Python code that makes this constraint again."""
        return f"StateAction({self.states!r}, {self.actions!r})"

    @property
    def name(self) -> str:
        """For example 'action force [0.5, 2) in x [0, 1)'."""
        return f"{self.actions.name} in {self.states.name}"

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """The spans of the constraint on states."""
        return self.states.spans

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where the states or the actions do not fit."""
        self.states.check(space, action_names)
        self.actions.check(space, action_names)

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] False: no state is forbidden."""
        return nowhere(states)

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] False: no state is forbidden."""
        return nowhere(starts)

    def forbids_in(self, states: Any, actions: Actions, space: StateSpace) -> Any:
        """Return [...] True where an action that begins in a state [..., n] is forbidden."""
        return self.states.contains(states, space) & self.actions.forbids(actions)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [...] of states [..., n] to the states of the constraint."""
        return self.states.distance(states, space)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> StateAction:
        """Return the same actions, forbidden in the states less the margin."""
        return StateAction(self.states.eroded(margin, space), self.actions)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        states, actions = self.states.to_json(), self.actions.to_json()
        return {"kind": "state_action", "states": states, "actions": actions}
