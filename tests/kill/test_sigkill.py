"""Real kills: SIGKILL at random moments of real processes."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support import moving_results
from support.stored_files import child_environment

from swerve.base import files
from swerve.work.outdated import OUTDATED, RECORD

NUM_KILLS = max(8, int(os.environ.get("SWERVE_KILLS", "200")) // 20)
NUM_COMMANDS = max(2, int(os.environ.get("SWERVE_KILLS", "200")) // 200)
ROBOT = """
import swerve

def problem(beta: float = 0.5):
    cells = swerve.grid(theta=(0.0, 6.0, 3))
    return swerve.Problem(swerve.Pendulum(num_steps=3, dt=0.4), cells, beta=beta)
"""


def killed_after(seconds: float, *command: object) -> bool:
    """Run a command and kill it; return whether it was still running."""
    words = [str(word) for word in command]
    with subprocess.Popen(words, env=child_environment(), stdout=subprocess.DEVNULL) as child:
        try:
            child.wait(seconds)
        except subprocess.TimeoutExpired:
            child.send_signal(signal.SIGKILL)
        return child.wait() == -signal.SIGKILL


def test_results_that_move_aside_are_never_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(0)
    number = 1
    for _ in range(NUM_KILLS):
        monkeypatch.setattr(files, "_SWEPT", set())  # as in another process: it clears the folder
        if (tmp_path / RECORD).exists():
            number = moving_results.check(tmp_path) + 1
        script = moving_results.__file__
        begun = time.monotonic()
        command = [sys.executable, script, str(tmp_path), str(number)]
        with subprocess.Popen(command, env=child_environment()) as child:
            before = tmp_path / RECORD
            stamp = before.stat().st_mtime_ns if before.exists() else None
            while not before.exists() or before.stat().st_mtime_ns == stamp:
                assert time.monotonic() < begun + 120
                time.sleep(0.01)
            time.sleep(rng.uniform(0.0, 0.3))
            child.send_signal(signal.SIGKILL)
            assert child.wait() == -signal.SIGKILL
    assert moving_results.check(tmp_path) > NUM_KILLS  # moved more than once between two kills
    monkeypatch.setattr(files, "_SWEPT", set())
    files.write_text(tmp_path / "last", "")
    known = {*moving_results.NAMES, RECORD, OUTDATED, "last", ".lock"}
    assert {path.name for path in tmp_path.iterdir()} <= known


def test_a_command_that_was_killed_gives_the_same_answer(tmp_path: Path) -> None:
    """Killed while it starts, loads, learns, samples or writes; then run to its end."""
    (tmp_path / "robot.py").write_text(ROBOT)
    robot, command = f"{tmp_path}/robot.py:problem", [sys.executable, "-m", "swerve", "infer"]

    def words(work: str) -> list[object]:
        return [*command, robot, "--work", tmp_path / work, "--solver", "enumeration", "--json"]

    def answer(work: str) -> object:
        run = subprocess.run(
            [str(word) for word in words(work)],
            env=child_environment(),
            capture_output=True,
            text=True,
            check=True,
        )
        return json.loads(run.stdout)

    begun = time.monotonic()
    expected = answer("undisturbed")
    whole = time.monotonic() - begun
    names = {path.name for path in (tmp_path / "undisturbed").iterdir()}
    rng = random.Random(1)
    for _ in range(NUM_COMMANDS):
        killed_after(rng.uniform(0.3, 1.0) * whole, *words("work"))
        assert answer("work") == expected
        assert {path.name for path in (tmp_path / "work").iterdir()} == names
        files.remove(tmp_path / "work")
