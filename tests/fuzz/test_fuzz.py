"""20,000 inputs that others might send; `make fuzz` tries a million."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.target import FuzzError, Target, try_inputs
from fuzz.targets import TARGETS

NUM_INPUTS = 20_000


def test_every_input_has_a_target() -> None:
    assert sum(kind.share for kind in TARGETS) == 100


@pytest.mark.parametrize("kind", TARGETS, ids=lambda kind: kind.name)
def test_inputs_are_read_or_refused(kind: type[Target], tmp_path: Path) -> None:
    num = NUM_INPUTS * kind.share // 100
    assert sum(1 for _ in try_inputs(kind(tmp_path), range(num))) == num


class Failing(Target):
    """A reader that fails at its third input."""

    name, share = "failing", 0

    def __init__(self, folder: Path, how: str) -> None:
        super().__init__(folder)
        self.how, self.count = how, 0

    def run(self, random: object) -> None:
        """Fail in one of the ways that are looked for."""
        self.count += 1
        if self.count == 3 and self.how == "raise":
            raise KeyError("x")
        if self.how == "write":
            for name in "ab":
                (self.folder / name).touch()


@pytest.mark.parametrize(
    ("how", "message"), [("raise", "input 2 of failing: KeyError"), ("write", "files were written")]
)
def test_failures_are_found(how: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(FuzzError, match=message):
        list(try_inputs(Failing(tmp_path, how), range(5)))
