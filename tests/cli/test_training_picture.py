"""Commands that train say so and write a picture of the training."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.brief_training import READ
from support.command import Run

from swerve.solvers.trained.checkpoints import Checkpoint
from swerve.solvers.trained.probe import Probe


@pytest.fixture
def brief(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str | Path, ...]:
    """Arguments for training briefly into a folder, with readings that take no time."""
    monkeypatch.setattr(Probe, "read", lambda self, policies: READ)
    solver = "ppo?num_steps=64&num_lanes=8&segment=1&width=4&num_minibatches=1"
    return "--work", tmp_path, "--solver", solver


class TestCommand:
    def test_learn_writes_a_picture(
        self, robot: str, run: Run, tmp_path: Path, brief: tuple[str | Path, ...]
    ) -> None:
        status, _, said = run("learn", robot, *brief)
        assert status == 0
        (picture,) = tmp_path.glob("*.training.png")
        (nominal,) = tmp_path.glob("*.nominal")
        assert picture.name.removesuffix(".training.png") == nominal.name.removesuffix(".nominal")
        assert f"how training went: {picture}" in said

    def test_infer_draws_what_it_trains_and_says_where_it_goes_on(
        self,
        robot: str,
        run: Run,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        brief: tuple[str | Path, ...],
    ) -> None:
        arguments = (robot, *brief, "--samples", 200)
        save = Checkpoint.save

        def save_and_stop(self: Checkpoint, arrays: dict[str, np.ndarray]) -> None:
            save(self, arrays)
            raise KeyboardInterrupt

        monkeypatch.setattr(Checkpoint, "save", save_and_stop)
        status, _, said = run("infer", *arguments)
        assert status == 130
        assert "going on from" not in said
        monkeypatch.setattr(Checkpoint, "save", save)
        status, _, said = run("infer", *arguments)
        assert status == 0
        assert re.search(r"going on from .*\.checkpoint", said)
        (picture,) = tmp_path.glob("*.training.png")
        assert f"how training went: {picture}" in said

    def test_nothing_is_drawn_where_nothing_is_trained(
        self, robot: str, run: Run, tmp_path: Path
    ) -> None:
        work = tmp_path / "work"
        status, _, said = run("learn", robot, "--work", work, "--solver", "grid?num_points=9")
        assert status == 0
        assert "how training went" not in said
        assert not list(work.glob("*.png"))
