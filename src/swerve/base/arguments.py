"""Checks of single arguments at public entries."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np

MOST_SEED = 2**32 - 1  # JAX takes the last 32 bits, so that larger seeds would be smaller ones


def whole_number(value: Any, name: str, least: int, most: int | None = None) -> int:
    """Return a value as an int.

    Raises:
      ValueError: if the value is not a whole number (2.0 and True do not count as one), less than
        `least`, or more than `most`.
    """
    expected = f">= {least}" if most is None else f"from {least} to {most:,}"
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool):
        raise ValueError(f"{name}: expected a whole number {expected}, got {value!r}")
    if number < least or (most is not None and number > most):
        raise ValueError(f"{name}: expected a whole number {expected}, got {number}")
    return number


def seed_number(value: Any, name: str = "seed") -> int:
    """Return a seed as an int.

    Raises:
      ValueError: if the value is not a whole number from 0 to MOST_SEED.
    """
    return whole_number(value, name, 0, MOST_SEED)


def real_numbers(values: Any, name: str) -> np.ndarray:
    """Return real numbers of any kind and shape as float64.

    Raises:
      ValueError: if the values are complex, or not made of numbers: text and dates are no numbers.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf" or (array.dtype.kind == "O" and _are_numbers(array)):
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: expected numbers, got {values!r}") from error
    expected = "real numbers" if array.dtype.kind == "c" else "numbers"
    raise ValueError(f"{name}: expected {expected}, got {values!r}")


def _are_numbers(objects: np.ndarray) -> bool:
    """Return whether all objects are real numbers, such as a Decimal or a Fraction."""
    durations = np.timedelta64  # NumPy says that they are whole numbers
    return all(
        isinstance(item, Real | Decimal | np.bool_) and not isinstance(item, durations)
        for item in objects.flat
    )


def number_or_nan(value: Any) -> float:
    """Return a value as a float; NaN if the value is no real number, such as text, True, a list."""
    try:
        return (
            math.nan
            if isinstance(value, bool) or np.ndim(value)
            else float(real_numbers(value, ""))
        )
    except (TypeError, ValueError, OverflowError):
        return math.nan


def numbers(values: Any, count: int) -> list[float] | None:
    """Return values as `count` floats, NaN for each non-number; None for another count."""
    try:
        items = [] if isinstance(values, str) else list(values)
    except TypeError:
        return None
    return [number_or_nan(item) for item in items] if len(items) == count else None


def two_names(value: Any, name: str) -> tuple[str, str]:
    """Return the names of two states.

    Raises:
      ValueError: if the value is not a list of two different names.
    """
    names = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else ()
    if len(names) != 2 or not all(isinstance(item, str) for item in names) or names[0] == names[1]:
        raise ValueError(
            f"{name}: expected the names of two states, got {value!r}: give them as in ('x', 'y')"
        )
    return names


def positive_number(value: Any, name: str) -> float:
    """Return a value as a float.

    Raises:
      ValueError: if the value is not a finite number above 0.
    """
    number = number_or_nan(value)
    if not (math.isfinite(number) and number > 0.0):
        raise ValueError(f"{name}: expected a finite number > 0, got {value!r}")
    return number


def instance(value: Any, kind: type, name: str, remedy: str) -> None:
    """Raise ValueError if a value is not an instance of a class.

    Args:
      value: value of the argument.
      kind: the expected class.
      name: name of the argument.
      remedy: what the caller should do instead.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{name}: expected a swerve.{kind.__name__}, got {value!r}: {remedy}")
