"""Regions of state space that a trajectory may be forbidden to enter, and actions not to take.

A constraint c is a set of states, of actions, or of both. A trajectory violates it when one of its
states lies in c, or, unless states alone are judged, when the straight segment between two
consecutive states crosses c (along the shorter arc for angles); and when one of its actions lies in
c. All tests work alike on NumPy and JAX arrays: the same code judges demonstrations and masks the
actions of a policy.

Shapes: n state dimensions, m action dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import functools
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import number_or_nan, whole_number
from swerve.base.space import Actions, StateSpace


class Constraint(ABC):
    """A forbidden set of states and actions."""

    about_actions = False
    """Whether it forbids actions, so that judging it needs them."""

    needs_code = False
    """Whether judging it needs functions that no file can hold."""

    @property
    def parts(self) -> tuple[Constraint, ...]:
        """The constraints that it consists of: itself, unless it is a union."""
        return (self,)

    @property
    @abstractmethod
    def name(self) -> str:
        """What tables and pictures call it."""

    @abstractmethod
    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set."""

    @abstractmethod
    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where the segment from start to end [..., n] meets the set."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return JSON data from which `constraint_from_json` rebuilds it."""

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """For each state that it names an interval that it lies in, open sides +-inf."""
        return {}

    def forbids(self, actions: Actions) -> Any:
        """Return [...] True where an action is forbidden everywhere; none unless overridden."""
        return nowhere(actions.values)

    def forbids_in(self, states: Any, actions: Actions, space: StateSpace) -> Any:
        """Return [...] True where an action begun in a state [..., n] lies in the set."""
        del states, space
        return self.forbids(actions)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [...] from states [..., n] to the set, 0 inside.

        It is Euclidean over the states that the set names, in their own units, angles by the
        shorter arc.

        Raises:
          ValueError: if there is no telling, as for predicates.
        """
        del states, space
        raise ValueError(
            f"{self.name}: expected a constraint on states with a shape, such as Box, to tell "
            f"distances to, got {type(self).__name__}"
        )

    def eroded(self, margin: Mapping[str, float], space: StateSpace) -> Constraint:
        """Return the set of states deeper inside than measurement noise explains.

        Args:
          margin: for some states, how deep, in the state's unit.
          space: what the states are: an interval that goes round an angle has no ends to lose.

        Raises:
          ValueError: if a margin is negative or no number, or is of no state, if nothing is left,
            or there is no telling, as for predicates.
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
        """Return what `eroded` does, of a margin that has been checked."""
        del margin, space
        raise ValueError(
            f"{self.name}: a {type(self).__name__} cannot be made smaller by a margin: use "
            "constraints with a shape, such as Box"
        )

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where the constraint does not fit the states or the actions."""


class Union(Constraint):
    """What at least one of several constraints forbids.

    Args:
      name: what tables call it.
      constraints: its parts.

    Raises:
      ValueError: if there is none, or one is no constraint.
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
        """Return Python that makes this union again."""
        return f"Union({self._name!r}, {list(self._constraints)!r})"

    @property
    def name(self) -> str:
        """The name it was given."""
        return self._name

    @property
    def parts(self) -> tuple[Constraint, ...]:
        """The constraints that are no unions, of all its unions."""
        return tuple(part for constraint in self._constraints for part in constraint.parts)

    def check(self, space: StateSpace, action_names: Sequence[str]) -> None:
        """Raise ValueError where a part does not fit."""
        for part in self._constraints:
            part.check(space, action_names)

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """For each state that a part names an interval that holds those of the parts."""
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
        """Return [...] True where an action begun in a state lies in one of the parts."""
        return _any(part.forbids_in(states, actions, space) for part in self._constraints)

    def distance(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return the distance [...] of states to the nearest of the parts."""
        return np.min([part.distance(states, space) for part in self._constraints], axis=0)

    def _eroded(self, margin: Mapping[str, float], space: StateSpace) -> Union:
        """Return the union of the parts, each less the margin, also where one adjoins another."""
        return Union(self._name, [part.eroded(margin, space) for part in self._constraints])

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        parts = [part.to_json() for part in self._constraints]
        return {"kind": "union", "name": self._name, "constraints": parts}


class Predicate(Constraint):
    """The states for which a function of yours says True.

    Args:
      name: what tables call it.
      function: maps states [..., n] to booleans [...]; written with operators and
        `states.__array_namespace__()` or `jax.numpy`, so that it also works while JAX traces it.
      num_points: how many evenly spaced points of a segment between two states are tried.

    Raises:
      ValueError: if the name is no text, the function none, or the number not 1 or more.
    """

    needs_code = True

    def __init__(self, name: str, function: Callable[[Any], Any], num_points: int = 8) -> None:
        if not isinstance(name, str):
            raise ValueError(f"Predicate: expected a name first, got {name!r}")
        if not callable(function):
            raise ValueError(f"Predicate {name!r}: expected a function of states, got {function!r}")
        self._name = name
        self.function = function
        self.num_points = whole_number(num_points, f"Predicate {name!r}: num_points", 1)

    def __repr__(self) -> str:
        """Return for example "Predicate('disc', in_disc, num_points=8)", without addresses."""
        function = getattr(self.function, "__name__", type(self.function).__name__)
        return f"Predicate({self.name!r}, {function}, num_points={self.num_points})"

    @property
    def name(self) -> str:
        """The name it was given."""
        return self._name

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set."""
        inside = self.function(states)
        shape, kind = (
            getattr(inside, "shape", None),
            str(getattr(inside, "dtype", type(inside).__name__)),
        )
        if shape != states.shape[:-1] or kind != "bool":
            raise ValueError(
                f"Predicate {self.name!r}: expected one boolean a state, shape "
                f"{states.shape[:-1]}, got {kind} of shape {shape}"
            )
        return inside

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where one of `num_points` points of the segment lies in the set."""
        steps = space.difference(starts, ends)
        hit = self.contains(starts, space)
        for k in range(1, self.num_points + 1):
            hit = hit | self.contains(starts + steps * (k / self.num_points), space)
        return hit

    def to_json(self) -> dict[str, Any]:
        """Return JSON data: the name alone, since code is never stored."""
        return {"kind": "predicate", "name": self.name, "num_points": self.num_points}


def nowhere(values: Any) -> Any:
    """Return [...] False for values [..., k]."""
    return values.__array_namespace__().zeros(values.shape[:-1], bool)


def _any(masks: Iterable[Any]) -> Any:
    """Return where at least one of some masks is True."""
    return functools.reduce(operator.or_, masks)


def missing_function(name: str) -> Callable[[Any], Any]:
    """Return what stands for the function of a predicate that was read from a file."""

    def function(states: Any) -> Any:
        raise ValueError(
            f"predicate {name!r} was read from a file, which holds its name and not its code: "
            "load the problem that defines it"
        )

    return function


def check_constraints(
    constraints: Any, space: StateSpace, action_names: Sequence[str], where: str
) -> tuple[Constraint, ...]:
    """Return the constraints as a tuple after checking each against the states and actions.

    Raises:
      ValueError: if one is no Constraint or does not fit; `where` names the argument.
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


def violates(
    constraint: Constraint,
    states: np.ndarray,
    space: StateSpace,
    between_states: bool,
    actions: Actions | None = None,
) -> np.ndarray:
    """Return [...] True where a trajectory enters the constraint.

    A single state, T = 0, is a trajectory too: it is judged as it is.

    Args:
      constraint: what it is not to enter.
      states: [..., T+1, n].
      space: what the n components are.
      between_states: whether the segments between states count as well.
      actions: [..., T, m], which must be there if the constraint is about actions.
    """
    if between_states and states.shape[-2] > 1:
        hit = constraint.crosses(states[..., :-1, :], states[..., 1:, :], space).any(axis=-1)
    else:
        hit = constraint.contains(states, space).any(axis=-1)
    if not constraint.about_actions:
        return hit
    assert actions is not None
    return hit | constraint.forbids_in(states[..., :-1, :], actions, space).any(axis=-1)
