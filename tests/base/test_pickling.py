"""Dataclasses are pickled by their fields alone."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass
from functools import cached_property

from swerve.base.pickling import PickledByFields


@dataclass(frozen=True)
class Row(PickledByFields):
    length: int

    @cached_property
    def values(self) -> list[int]:
        return [0] * self.length


def test_what_was_computed_is_computed_anew() -> None:
    row = Row(3)
    assert row.values == [0, 0, 0]
    for again in (pickle.loads(pickle.dumps(row)), copy.copy(row)):  # noqa: S301
        assert vars(again) == {"length": 3}
        assert again == row
        assert again.values == row.values
