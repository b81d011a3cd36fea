"""Compile functions of a problem once for each problem, and drop them with the problem.

JAX keeps what `jax.jit` compiled for as long as the function lives, with every object that an
argument holds beside its arrays. A function of a module lives for ever, and so would each problem
that it was called with. Here the compiled functions belong to the problem, and take arrays alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

from swerve.base.forked import check_process
from swerve.problem.problem import Problem

MOST = 64  # compiled functions that a problem keeps: policies without a common form may be many
GROWTH = 8  # factor between numbers of rows: few, since a function is compiled for each
_LOCK = threading.Lock()  # held while a function is added: threads may use the same problem
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def of_problem(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function compiled by JAX once for each problem and each form of its arguments.

    Args:
      function: its first argument is the problem, or a policy with a problem. Arrays inside its
        arguments are traced; everything else is fixed, and must be hashable.
    """

    @wraps(function)
    def call(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        check_process()
        first: Any = arguments[0]
        kept = (first if isinstance(first, Problem) else first.problem).compiled
        leaves, form = jax.tree.flatten((arguments, named))
        fixed = tuple(None if _is_array(leaf) else (type(leaf), leaf) for leaf in leaves)
        key = function, form, fixed
        run = kept.get(key)
        if run is None:
            run = _added(kept, key)
        return run([leaf for leaf in leaves if _is_array(leaf)])

    return call


def padded(rows: np.ndarray, least: int) -> np.ndarray:
    """Return rows [N, ...], repeated until their number is one of few: `least` * GROWTH^k."""
    size = least
    while size < len(rows):
        size *= GROWTH
    return np.resize(rows, (size, *rows.shape[1:]))


def _added(kept: dict[Any, Callable[..., Any]], key: tuple[Any, Any, tuple]) -> Callable[..., Any]:
    """Return the compiled function of a key, after adding the function unless a thread has."""
    with _LOCK:
        if key not in kept:
            if len(kept) >= MOST:
                kept.pop(next(iter(kept)))
            kept[key] = jax.jit(_of_arrays(*key))
        return kept[key]


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _of_arrays(function: Callable[..., Any], form: Any, fixed: tuple) -> Callable[[list], Any]:
    """Return a function of the arrays among the leaves of the arguments; the rest are fixed."""

    def run(arrays: list) -> Any:
        left = iter(arrays)
        leaves = [next(left) if item is None else item[1] for item in fixed]
        arguments, named = jax.tree.unflatten(form, leaves)
        return function(*arguments, **named)

    return run
