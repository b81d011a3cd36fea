"""The form of a mutant."""

from __future__ import annotations

from typing import NamedTuple


class Mutant(NamedTuple):
    """One place where the library is broken.

    Attributes:
      what: the mistake, in words.
      file: the file to break, below src/swerve.
      right: a text that the file holds exactly once.
      wrong: the text that replaces it.
      tests: a test module below tests/, with -k where few of its tests are enough, as in
        "base/test_space -k difference".
    """

    what: str
    file: str
    right: str
    wrong: str
    tests: str
