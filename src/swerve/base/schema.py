"""Check that a stored file holds what files of its kind hold, after its checksum.

A checksum shows an accident and no intent: a file of others may be whole and yet hold anything.
Records are checked against types (msgspec), arrays against an `ArrayRule` each. Whatever does not
fit is a `StoreError`, before anything is computed from it.

Letters of shapes: each stands for one length in all arrays of a file; * for any length.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from swerve.base.files import AnyPath
from swerve.base.store import StoredFile, StoreError

Kind = TypeVar("Kind")

MOST = 2**31 - 1  # of any number of steps, actions or trajectories
Finite = Annotated[float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=sys.float_info.max)]
Count = Annotated[int, msgspec.Meta(ge=1, le=MOST)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Names = list[str]
_OTHERS = {"nan": np.isnan, "inf": np.isposinf, "-inf": np.isneginf}


class Data(msgspec.Struct, forbid_unknown_fields=True):
    """Base of the types of records: every field is known, and has its type."""


class ArrayRule(NamedTuple):
    """What an array holds.

    Attributes:
      kinds: kinds of dtype, such as "f" or "iu".
      shape: letters of its lengths, such as "KN", or words.
      holds: function that returns whether the numbers are in range.
      expected: the range, in words.
    """

    kinds: str
    shape: Sequence[str]
    holds: Callable[[np.ndarray], bool]
    expected: str


def numbers(
    kinds: str,
    shape: Sequence[str],
    low: float = -math.inf,
    high: float = math.inf,
    also: Sequence[str] = (),
) -> ArrayRule:
    """Return the rule of an array of finite numbers from low to high.

    Args:
      kinds: kinds of dtype.
      shape: letters of the lengths.
      low: least number.
      high: largest number.
      also: what else there may be: "nan", "inf" or "-inf".
    """

    def holds(array: np.ndarray) -> bool:
        fine = np.isfinite(array) & (array >= low) & (array <= high)
        for name in also:
            fine |= _OTHERS[name](array)
        return bool(fine.all())

    limits = [f"from {low:g}"] * (low > -math.inf) + [f"to {high:g}"] * (high < math.inf)
    expected = " ".join(["finite numbers", *limits, *(f"or {name}" for name in also)])
    return ArrayRule(kinds, shape, holds, expected)


def checked(path: AnyPath, data: Any, kind: type[Kind]) -> Kind:
    """Return JSON data as an object of a type.

    Raises:
      StoreError: if a field is missing, unknown, or of another type or range.
    """
    try:
        return msgspec.convert(data, kind)
    except (msgspec.ValidationError, RecursionError) as error:
        raise _wrong(path, str(error)) from error


@contextlib.contextmanager
def contents(path: AnyPath) -> Iterator[None]:
    """Turn any error of a block that rebuilds objects from checked data into a StoreError.

    The types of the data are right, so that what still fails are the checks of the objects: a box
    whose low is above its high, a state that the problem does not have.
    """
    try:
        yield
    except (StoreError, OSError, MemoryError):
        raise
    except Exception as error:  # numbers that nobody wrote end in any of a dozen types
        raise _wrong(path, str(error) or type(error).__name__) from error


def checked_arrays(
    stored: StoredFile, rules: Mapping[str, ArrayRule], lengths: dict[str, int]
) -> dict[str, np.ndarray]:
    """Read arrays of a file and check each against its rule.

    Args:
      stored: the file.
      rules: the rule of each array, by the array's name.
      lengths: what the letters of shapes stand for, as far as that is known; the first array with
        an unknown letter says what the letter stands for.

    Raises:
      StoreError: if an array is missing or altered, or breaks its rule.
    """
    arrays = {}
    for name, rule in rules.items():
        array = stored.array(name)
        if array.dtype.kind not in rule.kinds:
            raise _wrong(stored.path, f"array {name!r} is of type {array.dtype}")
        if array.ndim == len(rule.shape):
            for letter, length in zip(rule.shape, array.shape, strict=True):
                lengths.setdefault(letter, length)
        expected = tuple(
            array.shape[k] if letter == "*" and k < array.ndim else lengths.get(letter)
            for k, letter in enumerate(rule.shape)
        )
        if array.shape != expected:
            raise _wrong(
                stored.path, f"array {name!r} has shape {array.shape}, expected {expected}"
            )
        if not rule.holds(array):
            raise _wrong(stored.path, f"array {name!r}: expected {rule.expected}")
        arrays[name] = array
    return arrays


def check_most(stored: StoredFile, name: str, array: np.ndarray, most: int) -> None:
    """Raise StoreError where a number of an array is above the largest that it may be."""
    if array.max(initial=0) > most:
        raise _wrong(stored.path, f"array {name!r}: expected at most {most}, got {array.max()}")


def check_names(stored: StoredFile, *parts: Mapping[str, Any]) -> None:
    """Raise StoreError unless a file holds the arrays of the parts, and no others."""
    expected = {name for part in parts for name in part}
    for name in stored.names:
        if name not in expected:
            raise _wrong(stored.path, f"array {name!r} does not belong there")
    for name in expected:
        if name not in stored.names:
            raise _wrong(stored.path, f"array {name!r} is missing")


def _wrong(path: AnyPath, problem: str) -> StoreError:
    return StoreError(path, f"holds wrong contents: {problem}", "make it again")
