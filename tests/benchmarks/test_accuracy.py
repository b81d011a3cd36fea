"""The benchmark of accuracy: what it holds results against, and what it says of time."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from rich.console import Console
from support import reference

from benchmarks import accuracy
from swerve import Evidence, Grid, Task, learn, sample

TEXT = f"{reference.__file__}:short_pendulum"
SOLVER = "grid?num_points=9"


@pytest.fixture(scope="module")
def exact() -> reference.Exact:
    return reference.enumerate_exactly(reference.short_pendulum(), *reference.PENDULUM_TASK)


def evidence(solver: Grid) -> Evidence:
    tasks = Task.stack([reference.PENDULUM_TASK])
    return sample(learn(reference.short_pendulum(), solver), tasks, 200)


class TestReference:
    def test_is_the_default_grid_also_for_a_coarse_one(self, exact: reference.Exact) -> None:
        coarse = evidence(Grid(num_points=4))
        found = accuracy.reference_log_partition(TEXT, coarse)
        assert found == pytest.approx(exact.log_partition, abs=0.005)
        assert abs(coarse.log_partition[0] - exact.log_partition) > 0.05

    def test_is_of_other_samples_also_for_the_default_grid(self, exact: reference.Exact) -> None:
        fine = evidence(Grid())
        found = accuracy.reference_log_partition(TEXT, fine)
        assert found == pytest.approx(exact.log_partition, abs=0.005)
        assert found != fine.log_partition


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """One demonstration of the pendulum, at rest, with exact probabilities that are made up."""
    (tmp_path / "demo_0.csv").write_text(
        "theta,omega\n" + "\n".join([f"{math.pi},0.0"] * 301) + "\n"
    )
    (tmp_path / "tasks.csv").write_text(
        f"demo,start_theta,start_omega,goal_theta,goal_omega\n0,{math.pi},0.0,{math.pi},0.0\n"
    )
    row = ",".join(["0", *["0.25"] * 100])
    (tmp_path / "exact_violation_torque1.csv").write_text(f"{row}\n")
    return tmp_path


def test_time_is_told_only_where_all_was_done(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*more: str) -> str:
        given = ["--data", data, "--solver", SOLVER, "--method", "importance"]
        given += ["--samples", 50, "--work", data / "work"]
        monkeypatch.setattr("sys.argv", ["accuracy.py", *map(str, given), "--truth", "0", *more])
        accuracy.main()
        return capsys.readouterr().out

    monkeypatch.setattr(accuracy, "reference_log_partition", lambda _, given: given.log_partition)
    first, again = (json.loads(run("--json")) for _ in range(2))
    assert all(row["seconds"] > 0 for row in first["accuracy"])
    assert [row.pop("seconds") for row in again["accuracy"]] == [None, None]
    for row in first["accuracy"]:
        del row["seconds"]
    assert first == again
    monkeypatch.setattr(accuracy, "Console", lambda width: Console(width=200))
    assert run().count(" stored ") == 2


def test_results_of_another_solver_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "grid.evidence").touch()
    (tmp_path / "grid%3Fnum_points=20.0.seed0.nominal").touch()
    assert accuracy.holds_results(tmp_path, "grid")
    assert accuracy.holds_results(tmp_path, "grid?num_points=20")
    assert not accuracy.holds_results(tmp_path, "grid?num_points=2")
    assert not accuracy.holds_results(tmp_path, "ppo")
    assert not accuracy.holds_results(None, "grid")
