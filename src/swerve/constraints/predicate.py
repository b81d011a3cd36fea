"""Define constraints by a Python function of states, for sets that no other constraint describes.

Shapes: n state dimensions, ... any batch dimensions.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from swerve.base.arguments import whole_number
from swerve.base.forked import check_process
from swerve.base.space import StateSpace, single, wide
from swerve.base.user_code import untraceable
from swerve.constraints.base import Constraint


class Predicate(Constraint):
    """The states for which a function that you write returns True.

    Args:
      name: name of the predicate, in tables.
      function: maps states [..., n] to booleans [...]; written with operators and
        `states.__array_namespace__()` or `jax.numpy`, so that JAX can trace the function too. The
        states are float32 always, sampled or recorded.
      num_points: number of evenly spaced points that are tried on a segment between two states.

    Raises:
      ValueError: if the name is not a text, the function cannot be called, or `num_points` is below
        1.
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
        self._needs_jax = False  # until it answers NumPy's arrays by one of JAX's

    def __repr__(self) -> str:
        """Return for example "Predicate('disc', in_disc, num_points=8)", without addresses."""
        function = getattr(self.function, "__name__", type(self.function).__name__)
        return f"Predicate({self.name!r}, {function}, num_points={self.num_points})"

    @property
    def name(self) -> str:
        """The name that the predicate was given."""
        return self._name

    def contains(self, states: Any, space: StateSpace) -> Any:
        """Return [...] True where a state [..., n] lies in the set.

        Raises:
          ValueError: if the function does not give one boolean a state.
          RuntimeError: in a process that was forked after JAX had begun to run, if the function is
            written with jax.numpy.
        """
        if self._needs_jax:
            check_process()
        try:
            inside = self.function(single(states))
        except Exception as error:
            mended = untraceable(error)
            if not mended:
                raise
            raise ValueError(f"Predicate {self.name!r}: {mended}") from error
        shape, kind = (
            getattr(inside, "shape", None),
            str(getattr(inside, "dtype", type(inside).__name__)),
        )
        if shape != states.shape[:-1] or kind != "bool":
            raise ValueError(
                f"Predicate {self.name!r}: expected one boolean a state, shape "
                f"{states.shape[:-1]}, got {kind} of shape {shape}"
            )
        self._needs_jax |= "jax" in sys.modules and isinstance(inside, sys.modules["jax"].Array)
        return inside

    def crosses(self, starts: Any, ends: Any, space: StateSpace) -> Any:
        """Return [...] True where one of `num_points` points of the segment lies in the set."""
        hit = self.contains(starts, space) | self.contains(ends, space)
        starts = wide(single(starts))
        steps = space.difference(starts, wide(single(ends)))
        for k in range(1, self.num_points):
            hit = hit | self.contains(starts + steps * (k / self.num_points), space)
        return hit

    def to_json(self) -> dict[str, Any]:
        """Return JSON data: the name without the function, since code is never stored."""
        return {"kind": "predicate", "name": self.name, "num_points": self.num_points}


def missing_function(name: str) -> Callable[[Any], Any]:
    """Return a function that raises ValueError, for a predicate that was read from a file."""
    return partial(_raise_missing, name)


def _raise_missing(name: str, states: Any) -> Any:
    raise ValueError(
        f"predicate {name!r} was read from a file, which holds its name and not its code: "
        "load the problem that defines it"
    )
