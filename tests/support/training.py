"""What holds of every solver that trains."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swerve import Nominal
from swerve.solvers.trained.checkpoints import Checkpoint


class Interrupted(KeyboardInterrupt):
    """Ctrl-C at a chosen moment."""


def assert_resumes(
    train: Callable[..., Nominal], path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training that is interrupted and goes on gives the same numbers; another seed does not.

    Args:
      train: takes a seed and a checkpoint.
      path: a checkpoint.
      monkeypatch: what interrupts.
    """
    seed, other = 3, 4
    save, calls = Checkpoint.save, []

    def save_and_stop(self: Checkpoint, arrays: dict[str, np.ndarray]) -> None:
        save(self, arrays)
        calls.append(1)
        if len(calls) == 7:
            raise Interrupted

    monkeypatch.setattr(Checkpoint, "save", save_and_stop)
    with pytest.raises(Interrupted):
        train(seed=seed, checkpoint=path)
    monkeypatch.setattr(Checkpoint, "save", save)
    resumed = weights(train(seed=seed, checkpoint=path))
    expected, different = (weights(train(seed=number)) for number in (seed, other))
    for name, array in expected.items():
        np.testing.assert_array_equal(array, resumed[name])
    learned_arrays = [name for name, array in expected.items() if array.ndim]
    assert all((expected[name] != different[name]).any() for name in learned_arrays)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=rf"checkpoint of another run: its seed is {seed}.*remove"):
        train(seed=other, checkpoint=path)
    assert path.read_bytes() == before


def weights(nominal: Nominal) -> dict[str, np.ndarray]:
    """Return what was learned, without how long it took."""
    return {name: array for name, array in nominal.arrays().items() if name != "history"}
