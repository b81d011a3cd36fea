"""The benchmark of training: its rows, its reference and its picture."""

from __future__ import annotations

import importlib
import json
import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from matplotlib.figure import Figure

from swerve import PPO, SoftValue
from swerve.solvers.trained.probe import Progress

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = ["seconds", "steps", "median_kl", "worst_kl", "median_error", "worst_error"]


@pytest.fixture
def training(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The benchmark with small solvers, and log Z_0 of its tasks made up."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "benchmarks")])  # as when it is run
    module = importlib.import_module("benchmarks.training")
    small = (
        SoftValue(num_lanes=16, segment=8, width=8),
        PPO(num_lanes=16, segment=8, num_minibatches=2, width=8),
    )
    monkeypatch.setattr(module, "SOLVERS", small)
    monkeypatch.setattr(
        module, "exact_log_partition", lambda problem, tasks: np.array([-3.0, -4.0])
    )
    return module


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two demonstrations of the pendulum, at rest, with exact probabilities that are made up."""
    rows = "\n".join([f"{math.pi},0.0"] * 301)
    tasks = ["demo,start_theta,start_omega,goal_theta,goal_omega"]
    for name in ("0", "1"):
        (tmp_path / f"demo_{name}.csv").write_text(f"theta,omega\n{rows}\n")
        tasks.append(f"{name},{math.pi},0.0,{math.pi},0.0")
    (tmp_path / "tasks.csv").write_text("\n".join(tasks) + "\n")
    exact = [",".join([name, *["0.25"] * 100]) for name in ("1", "0")]
    (tmp_path / "exact_violation_torque10.csv").write_text("\n".join(exact) + "\n")
    return tmp_path


@pytest.mark.filterwarnings("ignore:training came no nearer to pi_0")  # runs this short
def test_prints_and_draws_how_far_each_solver_is(
    training: ModuleType,
    data: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, dpi: drawn.append(self))
    monkeypatch.setattr(training, "steps_per_second", lambda solver, truth: 5_000.0)
    given = ["--data", data, "--seconds", 0.256, "--every", 4, "--samples", 60, "--json"]
    figure = data / "curves.png"
    monkeypatch.setattr("sys.argv", ["training.py", *map(str, [*given, "--figure", figure])])
    training.main()
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row.pop("solver") for row in rows] == ["soft-value"] * 3 + ["ppo"] * 3
    assert [row["steps"] for row in rows] == [512, 1024, 1280] * 2  # of 10 chunks 4, 8 and the last
    for row in rows:
        assert list(row) == COLUMNS
        assert row["median_kl"] <= row["worst_kl"]
        assert 0.0 < row["median_error"] <= row["worst_error"] <= 1.0
    panels = drawn[0].axes
    assert [axes.get_ylabel().partition(" ")[0] for axes in panels] == ["KL,", "error"]
    assert [axes.get_xlabel() for axes in panels] == ["time [s]"] * 2
    lines = {str(line.get_label()): line for line in panels[1].lines}
    ys = np.asarray(lines["ppo, worst task"].get_ydata())
    np.testing.assert_allclose(ys, [row["worst_error"] for row in rows[3:]])
    assert lines["ppo, worst task"].get_linestyle() == "--"


def test_compares_with_the_truth(training: ModuleType, data: Path) -> None:
    """With the same task twice, only the made-up exact values differ."""
    truth = training.read_truth(data, "10")
    run = training.new_run(training.SOLVERS[1], truth)
    nominal = training.TrainedNominal(truth.problem, training.SOLVERS[1], run.policy, np.ones((1,)))
    found = training.row(nominal, Progress(1.5, 64.0, *[0.0] * 4), truth, 60)
    assert found["seconds"] == 1.5
    assert found["steps"] == 64
    assert found["worst_kl"] - found["median_kl"] == pytest.approx(0.5)  # log Z_0 is -3 and -4
    assert found["worst_error"] == found["median_error"]
    late = truth._replace(violation=truth.violation * np.array([[1.0], [0.0]]))
    assert training.row(nominal, Progress(1.5, 64.0, *[0.0] * 4), late, 60) != found


def test_takes_about_the_time_that_is_asked_for(
    training: ModuleType, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = training.read_truth(data, "10")
    solver = training.SOLVERS[0]
    seconds = iter([1.0, 3.0])  # the first chunk does not count
    monkeypatch.setattr(training.Run, "advance", lambda self: Progress(next(seconds), *[0.0] * 5))
    rate = training.steps_per_second(solver, truth)
    assert rate == training.TIMED * solver.num_lanes * solver.segment / 2.0
    longer = training.with_steps(solver, 7 * solver.chunk_steps)
    assert longer.num_steps == 7 * solver.chunk_steps
    assert longer.width == solver.width


def test_a_missing_file_is_named(training: ModuleType, data: Path) -> None:
    with pytest.raises(SystemExit, match=r"no exact_violation_torque7\.csv"):
        training.read_truth(data, "7")
