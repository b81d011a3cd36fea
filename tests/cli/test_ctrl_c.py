"""Ctrl-C at any moment of a command: status 130, one line, nothing half-written, nothing lost."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import pytest
from support.command import CONSTRAINT, ROBOT, SOLVER, infer

from swerve.base.files import TEMPORARY
from swerve.base.version import VERSION

NUM_MOMENTS = 20
START = "from swerve.cli.start import main; print('go', flush=True); main()"


def started(arguments: list[object]) -> subprocess.Popen[str]:
    """Start a command, and return when it begins to import Swerve."""
    command = [sys.executable, "-c", START, *map(str, arguments)]
    cache = str(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]
    told = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    pipe: Any = subprocess.PIPE
    run = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=told)
    assert run.stdout is not None
    assert run.stdout.readline() == "go\n"
    return run


def completed(arguments: list[object]) -> tuple[str, float]:
    """Run a command to its end; return what it printed, and for how long it ran [s]."""
    with started(arguments) as run:
        began = time.monotonic()
        told, errors = run.communicate()
        assert run.returncode == 0, errors
        return told, time.monotonic() - began


@pytest.fixture
def arguments(tmp_path: Path, demonstrations: list[Path]) -> list[object]:
    """An inference that learns, samples and resolves, all but its work folder."""
    (tmp_path / "robot.py").write_text(ROBOT)
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    words = infer(f"{tmp_path}/robot.py:problem", demonstrations, tmp_path)
    place = words.index("--work")
    return [*words[:place], *words[place + 2 :], "--solver", SOLVER, "--json", "--work"]


@pytest.mark.slow
def test_at_any_moment(arguments: list[object], tmp_path: Path) -> None:
    completed([*arguments, tmp_path / "first"])  # with everything still to be compiled
    expected, cold = completed([*arguments, tmp_path / "whole"])
    _, warm = completed([*arguments, tmp_path / "whole"])
    moments, num_interrupted, seconds = random.Random(0), 0, cold
    for k in range(NUM_MOMENTS):
        folder = tmp_path / f"work_{k // 4}"
        with started([*arguments, folder]) as run:
            time.sleep(moments.uniform(0.0, 0.9 * seconds))
            run.send_signal(signal.SIGINT)
            _, errors = run.communicate(timeout=60)
        assert run.returncode in (0, 130), errors
        num_interrupted += run.returncode == 130
        seconds = warm if run.returncode == 0 else seconds  # nothing is left to do
        assert "Traceback" not in errors
        assert "Exception ignored" not in errors
        if run.returncode == 130:
            assert "interrupted" in errors.splitlines()[-1]
        left = [path for path in folder.rglob("*") if TEMPORARY.fullmatch(path.name)]
        assert left == []
        if k % 4 == 3:
            assert completed([*arguments, folder])[0] == expected
            seconds = cold  # in the next folder
    assert num_interrupted >= NUM_MOMENTS // 3
    assert f'"index": {CONSTRAINT}' in expected


def test_while_importing() -> None:
    """Where the machine is busy the signal may come late, but not each time."""
    statuses = set()
    for seconds in (0.0, 0.0, 0.01, 0.05):
        with started(["--version"]) as run:
            time.sleep(seconds)
            run.send_signal(signal.SIGINT)
            _, errors = run.communicate(timeout=30)
        assert (run.returncode, errors) in ((130, "interrupted\n"), (0, ""))
        statuses.add(run.returncode)
    assert 130 in statuses


def test_while_python_ends() -> None:
    """All is done by then, and the command has succeeded."""
    code = (
        "import os, signal, sys\n"
        "from swerve.cli import start\n"
        "class Late:\n"
        "    def __del__(self, kill=os.kill, pid=os.getpid(), number=signal.SIGINT):\n"
        "        kill(pid, number)\n"
        "late = Late()\n"
        "sys.argv = ['swerve', '--version']\n"
        "start.main()\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (run.returncode, run.stderr) == (0, b"")


def test_a_command_that_is_to_ignore_it_goes_on() -> None:
    """Such as one that a script began with &: the Ctrl-C is for the commands in front."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which the command inherits
    try:
        run = started(["--version"])
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    with run:
        while run.poll() is None:
            run.send_signal(signal.SIGINT)
            time.sleep(0.01)
        told, errors = run.communicate()
    assert (run.returncode, told, errors) == (0, f"{VERSION}\n", "")
