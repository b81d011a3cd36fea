"""Define constraints: forbidden sets of states and actions, and the rule of what enters a set.

A constraint c is a set of states, of actions, or of both. A trajectory enters c where one of its
states lies in c; where the straight segment between two consecutive states meets c (along the
shorter arc for angles), unless states alone are judged; and where one of its actions lies in c.
`step_enters` and `violates` are this rule. All these checks work alike on NumPy and JAX arrays: the
same code judges demonstrations and masks the actions of a policy.

Shapes: n state dimensions, m action dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import number_or_nan
from swerve.base.space import Actions, StateSpace


class Constraint(ABC):
    """A forbidden set of states and actions."""

    about_actions = False
    """Whether the constraint forbids actions, so that judging a trajectory needs its actions."""

    needs_code = False
    """Whether judging a trajectory needs Python functions, which no file can hold."""

    @property
    def parts(self) -> tuple[Constraint, ...]:
        """The parts of a union; for other constraints, the constraint itself."""
        return (self,)

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the constraint in tables and pictures."""

    @abstractmethod
    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set."""

    @abstractmethod
    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment from start to end [..., n] meets the set."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return JSON data from which `constraint_from_json` rebuilds the constraint."""

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """For each state that the constraint names, an interval around the set; +-inf if open."""
        return {}

    def forbids(self, actions: Actions) -> Any:
        """Return [...] True where an action is forbidden in every state; False by default."""
        return nowhere(actions.values)

    def forbids_in(self, states: Any, actions: Actions, space: StateSpace) -> Any:
        """Return [...] True where an action that begins in a state [..., n] is forbidden."""
        del states, space
        return self.forbids(actions)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [...] from states [..., n] to the set, 0 inside.

        The distance is Euclidean over the states that the set names, in their own units, with
        angles by the shorter arc.

        Raises:
          ValueError: if the set has no shape to measure distances to, as with predicates.
        """
        del states, space
        raise ValueError(
            f"{self.name}: expected a constraint on states with a shape, such as Box, to measure "
            f"distances to, got {type(self).__name__}"
        )

    def eroded(self, margin: Mapping[str, float], space: StateSpace) -> Constraint:
        """Return the set less a margin: the states deeper inside than measurement noise explains.

        Args:
          margin: for some states, by name, how deep inside the set a state must lie, in the state's
            unit.
          space: names, angles and bounds of the states. An interval of a full turn has no ends, so
            a margin does not change it.

        Raises:
          ValueError: if a margin is negative or not a number; if a margin names no state; if the
            margins leave nothing of the set; or if the set has no shape, as with predicates.
        """
        if not isinstance(margin, Mapping):
            raise ValueError(
                f"margin: expected widths by state, as in {{'x': 0.05}}, got {margin!r}"
            )
        for name, width in margin.items():
            if name not in space.names:
                raise ValueError(
                    f"margin: no state named {name!r}; the states are {', '.join(space.names)}"
                )
            if not 0.0 <= number_or_nan(width) < math.inf:
                raise ValueError(
                    f"margin: expected a width >= 0 for {name!r}, in its unit, got {width!r}"
                )
        return self._eroded(margin, space)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Constraint:
        """Return the set less a margin that `eroded` has checked."""
        del margin, space
        raise ValueError(
            f"{self.name}: a {type(self).__name__} cannot be made smaller by a margin: use "
            "constraints with a shape, such as Box"
        )

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where the constraint does not fit the states or the actions."""


class Union(Constraint):
    """The states and actions that at least one of several constraints forbids.

    Args:
      name: name of the union, in tables.
      constraints: parts of the union.

    Raises:
      ValueError: if there is no part, or a part is not a constraint.
    """

    def __init__(self, name: str, constraints: Sequence[Constraint]) -> None:
        if not isinstance(name, str):
            raise ValueError(f"Union: expected a name first, got {name!r}")
        self._name = name
        parts = tuple(constraints) if isinstance(constraints, Iterable) else ()
        if not parts or not all(isinstance(part, Constraint) for part in parts):
            raise ValueError(
                f"Union {name!r}: expected constraints, got {constraints!r}: give a list of at "
                "least one, such as [Box(x=(0.0, 1.0))]"
            )
        self._constraints: tuple[Constraint, ...] = parts
        self.about_actions = any(part.about_actions for part in self._constraints)
        self.needs_code = any(part.needs_code for part in self._constraints)

    def __repr__(self) -> str:
        """Return Python code that makes this union again."""
        return f"Union({self._name!r}, {list(self._constraints)!r})"

    @property
    def name(self) -> str:
        """The name that the union was given."""
        return self._name

    @property
    def parts(self) -> tuple[Constraint, ...]:
        """The parts of the union; a part that is a union is replaced by its own parts."""
        return tuple(part for constraint in self._constraints for part in constraint.parts)

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a part does not fit."""
        for part in self._constraints:
            part.check(space, action_names)

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """For each state that a part names, an interval that holds the intervals of all parts."""
        found: dict[str, tuple[float, float]] = {}
        for part in self._constraints:
            for name, (low, high) in part.spans.items():
                first, last = found.get(name, (low, high))
                found[name] = (min(first, low), max(last, high))
        return found

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state lies in one of the parts."""
        return _any(part.contains(states, space) for part in self._constraints)

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment meets one of the parts."""
        return _any(part.crosses(starts, ends, space) for part in self._constraints)

    def forbids(self, actions: Actions) -> Any:
        """Return [...] True where an action lies in one of the parts."""
        return _any(part.forbids(actions) for part in self._constraints)

    def forbids_in(self, states: Any, actions: Actions, space: StateSpace) -> Any:
        """Return [...] True where a part forbids an action that begins in a state [..., n]."""
        return _any(part.forbids_in(states, actions, space) for part in self._constraints)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [...] of states to the nearest of the parts."""
        return np.min([part.distance(states, space) for part in self._constraints], axis=0)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Union:
        """Return the union of the parts, each less the margin, also where two parts adjoin."""
        return Union(self._name, [part.eroded(margin, space) for part in self._constraints])

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        parts = [part.to_json() for part in self._constraints]
        return {"kind": "union", "name": self._name, "constraints": parts}


def nowhere(values: Any) -> Any:
    """Return [...] False for values [..., k]."""
    return values.__array_namespace__().zeros(values.shape[:-1], bool)


def _any(masks: Iterable[Any]) -> Any:
    """Return [...] True where at least one of several masks [...] is True."""
    return functools.reduce(operator.or_, masks)


def check_constraints(
    constraints: Any, space: StateSpace, action_names: Sequence[str], where: str
) -> tuple[Constraint, ...]:
    """Return the constraints as a tuple after checking each against the states and actions.

    Raises:
      ValueError: if an item is not a Constraint or does not fit; `where` names the argument.
    """
    if isinstance(constraints, Constraint):
        raise ValueError(f"{where}: expected a list of constraints, got {constraints!r} alone")
    if not isinstance(constraints, Iterable):
        raise ValueError(f"{where}: expected a list of constraints, got {constraints!r}")
    checked = tuple(constraints)
    for k, constraint in enumerate(checked):
        if not isinstance(constraint, Constraint):
            raise ValueError(f"{where}[{k}]: expected a Constraint, got {constraint!r}")
        try:
            constraint.check(space, action_names)
        except ValueError as error:
            raise ValueError(f"{where}[{k}]: {error}") from None
    return checked


def step_enters(
    constraint: Constraint,
    starts: Any,
    ends: Any,
    space: StateSpace,
    between_states: bool,
    actions: Actions | None = None,
) -> Any:
    """Return [...] True where a step enters the constraint: the one rule of entering.

    A step enters a constraint where the segment between its two states meets the set or, if states
    alone are judged, where its end lies in the set; and where its action lies in the set.

    Args:
      constraint: the forbidden set.
      starts: [..., n] states in which steps begin, NumPy or JAX.
      ends: [..., n] states in which steps end.
      space: names, angles and bounds of the states.
      between_states: whether the segments between states count as well.
      actions: [..., m] actions of the steps; without actions the states alone are judged.
    """
    if between_states:
        hit = constraint.crosses(starts, ends, space)
    else:
        hit = constraint.contains(ends, space)
    if actions is None or not constraint.about_actions:
        return hit
    return hit | constraint.forbids_in(starts, actions, space)


def violates(
    constraint: Constraint,
    states: np.ndarray,
    space: StateSpace,
    between_states: bool,
    actions: Actions | None = None,
) -> np.ndarray:
    """Return [...] True where a trajectory enters the constraint, by a step or by its start.

    A single state, T = 0, is a trajectory too: it enters the constraint where it lies in the set.

    Args:
      constraint: the forbidden set.
      states: [..., T+1, n].
      space: names, angles and bounds of the states.
      between_states: whether the segments between states count as well.
      actions: [..., T, m], required if the constraint is about actions.
    """
    if states.shape[-2] <= 1:
        return constraint.contains(states, space).any(axis=-1)
    assert actions is not None or not constraint.about_actions
    starts, ends = states[..., :-1, :], states[..., 1:, :]
    hit = step_enters(constraint, starts, ends, space, between_states, actions).any(axis=-1)
    if between_states:  # the first segment includes the start
        return hit
    return hit | constraint.contains(states[..., :1, :], space).any(axis=-1)
