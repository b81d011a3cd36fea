"""What is fuzzed: something that makes an input from its number, and tries the input."""

from __future__ import annotations

import abc
import contextlib
import os
import resource
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from random import Random

SECONDS = 20.0  # that one input may take: a shared machine may stand still for a while
MEMORY = 2**30  # bytes by which the memory may grow, whatever the inputs


class Target(abc.ABC):
    """A reader of inputs by others.

    Args:
      folder: empty folder to write the inputs to.
    """

    name: str
    share: int
    """Inputs of this target among a hundred: quick targets have more."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @abc.abstractmethod
    def run(self, random: Random) -> None:
        """Make an input and try it; raise an exception if anything is wrong with the answer."""
        ...


class FuzzError(Exception):
    """An input that was not answered as it should have been."""


def try_inputs(target: Target, numbers: range) -> Iterator[int]:
    """Try inputs by their numbers, and yield each number after its input was tried.

    Raises:
      FuzzError: if an input is answered by an exception that is no refusal, or by a wrong value, or
        takes too long or too much memory, or something is written.
    """
    held = _memory()
    for number in numbers:
        began = time.monotonic()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                target.run(Random(number))
        except Exception as error:
            raise FuzzError(f"input {number} of {target.name}: {error!r}") from error
        took = time.monotonic() - began
        if took > SECONDS:
            raise FuzzError(f"input {number} of {target.name}: took {took:.1f} s")
        if _memory() - held > MEMORY:
            raise FuzzError(f"input {number} of {target.name}: took {_memory() - held:,} bytes")
        yield number
    left = sorted(path.name for path in target.folder.iterdir())
    if len(left) > 1:
        raise FuzzError(f"{target.name}: files were written: {left}")


def _memory() -> int:
    """Return the most memory that this process has held [bytes]."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most * (1 if os.uname().sysname == "Darwin" else 1024)


@contextlib.contextmanager
def refusing(kind: type[Exception], most: int | None = None) -> Iterator[None]:
    """Accept the exception by which an input is refused, where it says why.

    Args:
      kind: the exception.
      most: characters that its message may have; None for any number.
    """
    try:
        yield
    except kind as error:
        length = len(str(error).strip())
        if not 0 < length <= (most or length):
            raise AssertionError(f"refused by {length} characters: {str(error)[:200]!r}") from error
