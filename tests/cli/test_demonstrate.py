"""`swerve demonstrate`: both ways to make demonstrations, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from support.command import CONSTRAINT, SOLVER, Run

import swerve


def test_demonstrate_refuses_before_the_work(robot: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "demo_001.csv").write_text("theta\n")
    (tmp_path / "loose").symlink_to(tmp_path / "gone")
    tasks = tmp_path / "tasks.csv"
    row = "5,0,5.5,0\n"
    tasks.write_text(f"demo,start_theta,start_omega,goal_theta,goal_omega\n9,{row}demo_9,{row}")
    for out, more, message in (
        ("made", (), "demo_001.csv exists already"),
        ("made", ("--num", 3, "--tasks", tasks), "--num or --tasks, not both"),
        ("new", ("--tasks", tasks), "more than one demonstration would be '9'"),
        ("made/demo_001.csv/x", (), "cannot write in"),
        ("loose", (), "loose is a link that leads nowhere; remove it or choose another"),
        ("new", ("--max-action", 3), "are for --by optimal-control: leave"),
        ("new", ("--by", "optimal-control", "--solver", "grid"), "--solver is for --by boltzmann"),
        ("new", ("--by", "optimal-control", "--max-action", 0), "--max-action: expected a number"),
    ):
        arguments = ("--constraint", 3, "--out", tmp_path / out, *more)
        status, _, said = run("demonstrate", robot, *arguments)
        assert status == 1
        assert message in said
        assert "demonstrating" not in said


def test_demonstrate_by_optimal_control(
    robot: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tasks.csv").write_text(
        "demo,start_theta,start_omega,goal_theta,goal_omega\n0,5,0,5.5,0\n1,5,0,6,0.5\n"
    )
    arguments = ("--constraint", CONSTRAINT, "--tasks", tmp_path / "tasks.csv")
    arguments = ("demonstrate", robot, *arguments, "--by", "optimal-control", "--max-action", "inf")
    status, printed, said = run(*arguments, "--out", tmp_path / "made")
    assert status == 0, said
    assert printed.splitlines()[0].split() == [
        "demonstration",
        "reward",
        "next",
        "best",
        "local",
        "optima",
    ]
    assert len(printed.splitlines()) == 3
    made = swerve.read_demonstrations(
        sorted((tmp_path / "made").glob("demo_*.csv")), swerve.Pendulum().space
    )
    assert [item.states[0].tolist() for item in made] == [[5.0, 0.0], [5.0, 0.0]]
    np.testing.assert_allclose(made[1].states[-1], [6.0, 0.5], atol=0.05)
    for name in ("symbolic", "transcription"):
        monkeypatch.delitem(sys.modules, f"swerve.demonstrators.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "casadi", None)
    status, _, said = run(*arguments, "--out", tmp_path / "none")
    assert status == 1
    assert "pip install 'swerve[control]'" in said


def test_demonstrate_with_tasks_of_ones_own(robot: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "tasks.csv").write_text(
        "demo,start_theta,start_omega,goal_theta,goal_omega\nleft,5,0,5.5,0\ndemo_9,5,0,6,0.5\n"
    )
    arguments = ("--constraint", CONSTRAINT, "--out", tmp_path / "made", "--solver", SOLVER)
    status, _, _ = run("demonstrate", robot, "--tasks", tmp_path / "tasks.csv", *arguments)
    assert status == 0
    files = {path.name for path in (tmp_path / "made").iterdir()}
    assert files == {"demo_left.csv", "demo_9.csv", "tasks.csv"}
    status, _, said = run("demonstrate", robot, *arguments[:2], "--out", "x", "--solver", "ppo")
    assert status == 1
    assert "expected one of grid, soft-value, tabular" in said


def test_num_of_demonstrations(robot: str, run: Run) -> None:
    status, _, said = run("demonstrate", robot, "--constraint", 3, "--num", 0, "--out", "x")
    assert status == 1
    assert "--num: expected a whole number from 1 to 100,000, got 0" in said
