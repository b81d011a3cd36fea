"""What holds of every solver that trains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swerve import Nominal, learn
from swerve.nominal import Solver
from swerve.solvers.checkpoints import Checkpoint


class Interrupted(KeyboardInterrupt):
    """Ctrl-C at a chosen moment."""


def assert_resumes(
    whole: Nominal, seed: int, other: int, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training that is interrupted and goes on gives the same numbers; another seed does not.

    Args:
      whole: what was learned with the seed without interruption.
      seed: of that run.
      other: another seed.
      path: a checkpoint.
      monkeypatch: what interrupts.
    """
    problem, solver = whole.problem, whole.solver
    save, calls = Checkpoint.save, []

    def save_and_stop(self: Checkpoint, arrays: dict[str, np.ndarray]) -> None:
        save(self, arrays)
        calls.append(1)
        if len(calls) == 7:
            raise Interrupted

    monkeypatch.setattr(Checkpoint, "save", save_and_stop)
    with pytest.raises(Interrupted):
        learn(problem, solver, seed=seed, checkpoint=path)
    monkeypatch.setattr(Checkpoint, "save", save)
    resumed = learned(problem, solver, seed, path)
    expected, different = weights(whole), learned(problem, solver, other, None)
    for name, array in expected.items():
        np.testing.assert_array_equal(array, resumed[name])
    learned_arrays = [name for name, array in expected.items() if array.ndim]
    assert all((expected[name] != different[name]).any() for name in learned_arrays)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=rf"checkpoint of another run: its seed is {seed}.*remove"):
        learn(problem, solver, seed=other, checkpoint=path)
    assert path.read_bytes() == before


def learned(problem, solver: Solver, seed: int, path: Path | None) -> dict[str, np.ndarray]:
    return weights(learn(problem, solver, seed=seed, checkpoint=path))


def weights(nominal: Nominal) -> dict[str, np.ndarray]:
    """Return what was learned, without how long it took."""
    return {name: array for name, array in nominal.arrays().items() if name != "history"}
