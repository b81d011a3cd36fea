"""What options of `swerve reproduce` do to a result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import Run

from swerve.reproduce.gridworld import measure as gridworld


def test_the_seed_is_that_of_the_result(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The demonstrations that are sampled hang on --seed alone."""
    worlds: list[Any] = []

    def measured(world: Any, *, progress: bool) -> None:
        worlds.append(world)
        raise ValueError("enough")

    monkeypatch.setattr(gridworld, "measure", measured)
    for seed in (0, 1, 0):
        words = ("reproduce", "gridworld", "--out", tmp_path, "--quick", "--seed", seed)
        assert run(*words)[0] == 1
    first, other, again = (world.sets[0][0].states for world in worlds)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
