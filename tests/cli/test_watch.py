"""`swerve watch`: learns once, then starts without JAX."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import SOLVER, Run

from swerve import Evidence
from swerve.monitoring import foresee as foresight_training


def test_hypotheses_about_actions_are_refused_before_the_work(run: Run, tmp_path: Path) -> None:
    (tmp_path / "pushy.py").write_text(
        "from swerve import ActionBox, Pendulum, Problem\n"
        "def problem():\n    return Problem(Pendulum(), [ActionBox(torque=(1.0, 2.0))])\n"
    )
    problem = f"{tmp_path / 'pushy.py'}:problem"
    status, out, err = run("watch", problem, "--work", tmp_path / "work")
    assert (status, out) == (1, "")
    assert "hypotheses: some are about actions, and a monitor sees states alone" in err
    assert not list((tmp_path / "work").glob("*.evidence"))


def lines_of(demonstration: Path) -> list[str]:
    """Return the states of a demonstration file, and its end, as lines of JSON."""
    states = np.loadtxt(demonstration, delimiter=",", skiprows=1)[:, :3]
    lines = [
        json.dumps({"t": t, "theta": theta, "omega": omega, "id": demonstration.stem})
        for t, theta, omega in states.tolist()
    ]
    return [*lines, json.dumps({"end": True, "id": demonstration.stem})]


def answers_without_jax(arguments: list[object], text: bytes) -> list[dict[str, Any]]:
    """Return what the command answers in a process that cannot import JAX."""
    code = "import sys; sys.modules['jax'] = None; from swerve.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        input=text,
        capture_output=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_the_command_learns_once_and_then_starts_without_jax(
    run: Run,
    robot: str,
    demonstrations: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = partial(foresight_training.foresee, num_trajectories=256, num_updates=20)
    monkeypatch.setattr(foresight_training, "foresee", quick)
    work, tasks = tmp_path / "work", demonstrations[0].parent / "tasks.csv"
    lines = lines_of(demonstrations[0])
    text = "\n".join(lines) + "\n"
    arguments = ["watch", robot, "--work", work, "--tasks", tasks]
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    status, out, err = run(*arguments, "--solver", SOLVER, "--samples", 500)
    assert status == 0, err
    assert "learning to look ahead" in err
    answers = [json.loads(line) for line in out.splitlines()]
    assert len(answers) == len(lines)
    assert not any("error" in answer for answer in answers)
    assert [answer["flags"] for answer in answers] == [[]] * len(lines)
    written = [path.stat().st_mtime_ns for path in work.iterdir()]
    for option, message in (("--tolerance", "tolerance"), ("--clearance", "clearance")):
        status, _, err = run(*arguments, option, -1)
        assert status == 1
        assert f"{message}: expected" in err
        assert err.count("\n") == 1  # before anything else
    assert [path.stat().st_mtime_ns for path in work.iterdir()] == written
    (path,) = work.glob("*.foresight")
    assert path.stem == next(work.glob("*.evidence")).stem

    broken, *others = answers_without_jax(arguments, b"\xff\n" + text.encode())
    assert "expected UTF-8 text (invalid start byte): the line is left out" in broken["error"]
    assert broken["line"] == 1
    assert others == answers
    check_last_answer(run, [robot, demonstrations[0], "--tasks", tasks, "--work", work], answers)
    assert Evidence.load(next(work.glob("*.evidence"))).num_tasks == len(demonstrations)


def check_last_answer(run: Run, arguments: list[object], answers: list[dict[str, Any]]) -> None:
    """Assert that the answer at the end of a demonstration is that of `swerve infer`."""
    status, out, _ = run("infer", *arguments, "--json", "--no-resolve")
    assert status == 0
    ranked = {row["index"]: row["log_likelihood"] for row in json.loads(out)["ranking"]}
    for row in answers[-1]["likely"]:
        assert row["nats"] == pytest.approx(ranked[row["index"]], abs=1e-5)
