"""Where standard error is no terminal, long work writes lines to it, and none to the output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.command import SOLVER, Run

from swerve.base import progress

TRAINING = "ppo?num_steps=64&num_lanes=8&segment=1&width=4&num_minibatches=1"


def hurried(*words: object) -> tuple[str, list[str]]:
    """Return the output and the lines of errors of a command, with a line at each advance."""
    code = (
        "from swerve.base import progress\n"
        "progress.FIRST_LINE = progress.LINE_INTERVAL = progress.LINE_SHARE = 0.0\n"
        "from swerve.cli.app import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr.splitlines()


def check_lines(said: list[str], work: str) -> None:
    """Assert that there are lines on a work, with its share and how long it took."""
    lines = [line for line in said if line.startswith(f"{work}: ")]
    assert len(lines) >= 3
    assert all(" % done after " in line for line in lines[:-1])
    assert lines[-1].startswith(f"{work}: done in ")
    assert not any("\x1b" in line for line in said)


def test_learning_and_sampling_in_processes_of_their_own(robot: str, tmp_path: Path) -> None:
    out, said = hurried("learn", robot, "--work", tmp_path / "w", "--solver", TRAINING)
    assert out == ""
    check_lines(said, "training")
    words = ("sample", robot, "--work", tmp_path / "v", "--solver", SOLVER, "--samples", 60)
    out, said = hurried(*words, "--json")
    assert json.loads(out)["num_trajectories"] == 60
    check_lines(said, "sampling")


@pytest.mark.parametrize(
    ("words", "work"),
    [
        (("sample", "WORLD", "--work", "w", "--json"), "working out"),
        (("learn", "pendulum", "--work", "w", "--solver", "discrete?num_cells=20"), "making the"),
        (("demonstrate", "WORLD", "--constraint", 5, "--num", 3, "--out", "o"), "demonstrating"),
        (("reproduce", "gridworld", "--quick", "--out", "o"), "picking constraints"),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else words,
)
def test_other_work(
    words: tuple[object, ...],
    work: str,
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("FIRST_LINE", "LINE_INTERVAL", "HEARTBEAT"):
        monkeypatch.setattr(progress, name, 0.0)
    world = "gridworld?width=4&height=3&num_steps=6"
    status, out, said = run(*(world if word == "WORLD" else word for word in words))
    assert status == 0, said
    assert f"{work}" in said
    assert " % done after " in said or f"{work} table: done in " in said
    assert "done" not in out
