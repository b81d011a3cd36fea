"""`swerve learn` and `swerve sample`: filling a work folder ahead of inference."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

from support.command import ROBOT, SOLVER, Run, infer

from swerve.base import store
from swerve.solvers.trained import checkpoints


def test_learn_and_sample_ahead_then_infer(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work, tasks = tmp_path / "work", demonstrations[0].parent / "tasks.csv"
    assert run("learn", robot, "--work", work, "--solver", SOLVER)[0] == 0
    status, out, said = run("sample", robot, "--work", work, "--tasks", tasks, "--samples", 500)
    assert status == 0
    assert "warning" not in said
    assert "in 20 parts" not in said
    assert out.startswith("4 tasks, 500 trajectories a task from Grid(")
    assert "spread  start -> goal" in out
    status, out, _ = run("sample", robot, "--work", work, "--tasks", tasks, "--json")
    assert status == 0
    assert {"distinct_share", "island_spread", "verdict"} <= json.loads(out)["tasks"][0].keys()
    few = ("--samples", 50, "--work", work, "--tasks", tasks)
    status, out, said = run("sample", robot, *few)
    assert status == 0
    assert "smc takes 60 trajectories a task, in 20 parts" in said
    assert out.startswith("4 tasks, 60 trajectories a task from Grid(")
    assert "warning: not to be trusted: the effective sample size is too low" in said
    before = {path: path.stat().st_mtime_ns for path in work.iterdir()}
    assert run(*infer(robot, demonstrations, work))[0] == 0
    assert {path: path.stat().st_mtime_ns for path in work.iterdir()} == before


def test_ctrl_c_while_training_keeps_a_checkpoint(robot: str, tmp_path: Path) -> None:
    work = tmp_path / "work"
    solver = "ppo?num_steps=4e6&num_lanes=16&segment=8&num_minibatches=2&width=8"
    arguments = [sys.executable, "-m", "swerve", "learn", robot, "--work", work, "--solver", solver]
    process = subprocess.Popen([*map(str, arguments)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not list(work.glob("*.checkpoint")) and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on" in said
    assert "Traceback" not in said
    [checkpoint] = work.glob("*.checkpoint")
    assert store.open_file(checkpoint, "swerve-ppo-checkpoint", checkpoints.VERSION).names
    assert not list(work.glob("*.nominal"))


def test_tasks_are_refused_before_learning(robot: str, run: Run, tmp_path: Path) -> None:
    walled = ROBOT.replace("between_states=between_states", "known=[swerve.Box(theta=(0, 1))]")
    (tmp_path / "walled.py").write_text("import swerve\n" + walled)
    (tmp_path / "x.csv").write_text("theta,omega\n2,0\n2.1,0\n")
    (tmp_path / "tasks.csv").write_text(
        "demo,start_theta,start_omega,goal_theta,goal_omega\nx,0.5,0,2,0\n"
    )
    arguments = ("--tasks", tmp_path / "tasks.csv", "--solver", "ppo")
    status, _, said = run("sample", f"{tmp_path}/walled.py:problem", *arguments, "--work", "w")
    assert status == 1
    assert "inside the known constraint theta [0, 1)" in said
    assert "learning" not in said
