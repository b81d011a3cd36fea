"""The command as a user meets it: answers, and what it says of bad input."""

from __future__ import annotations

import inspect
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.command import CONSTRAINT, ROBOT, SOLVER, Run, infer

import swerve
from swerve.base import store
from swerve.cli import app as cli
from swerve.solvers.trained import checkpoints


def test_from_demonstrations_to_a_ranking(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    report = tmp_path / "report.html"
    arguments = infer(robot, demonstrations, tmp_path / "work", "--solver", SOLVER, "--json")
    status, out, _ = run(*arguments, "--report", report)
    assert status == 0
    answer = json.loads(out)
    ranking = answer["ranking"]
    assert CONSTRAINT in [entry["index"] for entry in ranking]
    assert {"index", "name", "log_likelihood", "standard_error"} <= set(ranking[0])
    nats = [entry["log_likelihood"] for entry in ranking]
    assert nats == sorted(nats, reverse=True)
    assert len(answer["diagnostics"]) == 4
    assert all(d["effective_sample_size"] > 250 for d in answer["diagnostics"])
    assert "<html" in report.read_text()
    status, out, _ = run(*arguments[:-1])
    assert status == 0
    assert ranking[0]["name"] in out
    assert "uniform measure" in out


def test_several_constraints_one_after_another(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    """The first pick is the first of the ranking; the next gains less than it has alone."""
    arguments = infer(robot, demonstrations, tmp_path / "work", "--solver", SOLVER, "--greedy", 2)
    status, out, _ = run(*arguments, "--json")
    assert status == 0
    answer = json.loads(out)
    first, second = answer["greedy"]
    best = answer["ranking"][0]
    assert (first["index"], first["name"]) == (best["index"], best["name"])
    assert first["total_gain"] == pytest.approx(best["log_likelihood"])
    assert first["gain"] == pytest.approx(first["total_gain"] / 4)
    assert first["log_odds"] == pytest.approx(answer["none"]["log_bayes_factor"])
    assert second["standard_error"] > 0.0
    status, out, _ = run(*arguments)
    assert status == 0
    assert "pick  index      nats   a demo     +-  log odds  hypothesis" in out
    assert f"    2 {second['index']:>6}  {second['total_gain']:>8.2f}" in out
    assert "as many as asked for: 2" in out
    status, out, _ = run(*arguments[:-1], 40)
    assert status == 0
    assert "no other explains 0.1 nats a demonstration, the least to be picked" in out
    for more, message in (
        (("--greedy", 0, demonstrations[0]), "--greedy: expected a number of picks >= 1, got 0"),
        (("--greedy", 2), "--greedy: constraints are picked from demonstrations"),
    ):
        status, _, said = run("infer", robot, *more)
        assert status == 1
        assert message in said


def test_exact_answers_are_worked_out_anew_for_each_pick(run: Run, tmp_path: Path) -> None:
    rows = ["x,y,dx,dy", "0,0,0,1", "0,1,1,1", "1,2,1,0", "2,2,1,-1", "3,1,0,-1", "3,0,0,0"]
    (tmp_path / "round.csv").write_text("\n".join(rows))
    problem = "gridworld?width=4&height=3&num_steps=6"
    status, out, _ = run("infer", problem, tmp_path / "round.csv", "--greedy", 3, "--json")
    assert status == 0
    picks = json.loads(out)["greedy"]
    assert len(picks) == 3
    assert [pick["standard_error"] for pick in picks] == [0.0] * 3


def test_a_reader_that_stops_early_is_no_error(robot: str) -> None:
    command = [sys.executable, "-m", "swerve", "demonstrate", "--help"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.wait(timeout=60)
    assert "Broken pipe" not in process.stderr.read()
    process.stderr.close()


def test_demonstrate_refuses_before_the_work(robot: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "demo_001.csv").write_text("theta\n")
    tasks = tmp_path / "tasks.csv"
    row = "5,0,5.5,0\n"
    tasks.write_text(f"demo,start_theta,start_omega,goal_theta,goal_omega\n9,{row}demo_9,{row}")
    for out, more, message in (
        ("made", (), "demo_001.csv exists already"),
        ("made", ("--num", 3, "--tasks", tasks), "--num or --tasks, not both"),
        ("new", ("--tasks", tasks), "more than one demonstration would be '9'"),
        ("made/demo_001.csv/x", (), "cannot write in"),
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
    assert "expected one of grid, tabular, soft-value" in said


def test_nothing_is_said_to_go_on_without_a_work_folder(
    robot: str, run: Run, demonstrations: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("swerve.sampling.sample.sample_each", interrupted)
    status, _, said = run("infer", robot, demonstrations[0], "--solver", SOLVER)
    assert status == 130
    assert said.endswith("interrupted\n")


def test_learn_and_sample_ahead_then_infer(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work, tasks = tmp_path / "work", demonstrations[0].parent / "tasks.csv"
    assert run("learn", robot, "--work", work, "--solver", SOLVER)[0] == 0
    status, out, said = run("sample", robot, "--work", work, "--tasks", tasks, "--samples", 500)
    assert status == 0
    assert "warning" not in said
    assert out.startswith("4 tasks, 500 trajectories a task from Grid(")
    assert "spread  start -> goal" in out
    status, out, _ = run("sample", robot, "--work", work, "--tasks", tasks, "--json")
    assert status == 0
    assert {"distinct_share", "island_spread", "verdict"} <= json.loads(out)["tasks"][0].keys()
    few = ("--samples", 60, "--work", work, "--tasks", tasks)
    status, _, said = run("sample", robot, *few)
    assert status == 0
    assert "warning: not to be trusted: the effective sample size is too low" in said
    before = {path: path.stat().st_mtime_ns for path in work.iterdir()}
    assert run(*infer(robot, demonstrations, work))[0] == 0
    assert {path: path.stat().st_mtime_ns for path in work.iterdir()} == before


def test_without_demonstrations_the_ranking_is_the_prior_one(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    tasks = demonstrations[0].parent / "tasks.csv"
    common = ("--solver", SOLVER, "--samples", 500, "--work", tmp_path / "work", "--json")
    status, out, _ = run("infer", robot, "--tasks", tasks, *common)
    assert status == 0
    answer = json.loads(out)
    assert answer["num_demonstrations"] == 0
    assert len(answer["ranking"]) == 30
    violated = [entry["average_violation"] for entry in answer["ranking"]]
    assert violated[0] > 0.5
    status, out, _ = run("infer", robot, *common)
    assert status == 0
    assert len(json.loads(out)["diagnostics"]) == 4


def test_works_without_a_work_folder(robot: str, run: Run, demonstrations: list[Path]) -> None:
    status, out, _ = run("infer", robot, demonstrations[0], "--solver", SOLVER, "--samples", 200)
    assert status == 0
    assert "hypothesis" in out


def test_fit_beta(robot: str, run: Run, demonstrations: list[Path], tmp_path: Path) -> None:
    """With what `infer` has sampled; the demonstrators' beta is 0.05, the problem's."""
    assert run(*infer(robot, demonstrations, tmp_path / "work", "--solver", SOLVER))[0] == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").iterdir()}
    _, *arguments = infer(robot, demonstrations, tmp_path / "work")
    status, out, _ = run("fit-beta", *arguments, "--json")
    assert status == 0
    answer = json.loads(out)
    assert answer["low"] < 0.05 < (answer["high"] or np.inf)
    status, out, _ = run("fit-beta", *arguments, "--confidence", 0.5)
    assert status == 0
    assert out.startswith("beta ")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "work").iterdir()} == before
    status, _, said = run("fit-beta", robot)
    assert status == 1
    assert "give at least one demonstration" in said


class TestBadInput:
    def test_missing_column(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "x.csv").write_text("t,theta\n0,1\n1,2\n")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "no column omega" in said

    def test_empty_file(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "x.csv").write_text("")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "x.csv: the file is empty" in said

    def test_nan(self, run: Run, tmp_path: Path) -> None:
        rows = [f"{0.1 * k},1,{'nan' if k == 16 else 0}" for k in range(30)]
        (tmp_path / "x.csv").write_text("t,theta,omega\n" + "\n".join(rows))
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "row 17" in said
        assert "omega" in said

    @pytest.mark.parametrize(
        ("task", "message"),
        [
            ("1,0,1,55", "goal omega = 55 is outside the bounds"),
            (
                "2,0,1,0",
                "first state is theta = 1, omega = 0, but the task starts at theta = 2",
            ),
        ],
        ids=["goal outside", "starts elsewhere"],
    )
    def test_a_task_that_does_not_fit(
        self, run: Run, tmp_path: Path, task: str, message: str
    ) -> None:
        (tmp_path / "x.csv").write_text("theta,omega\n1,0\n1,0.1\n")
        tasks = tmp_path / "tasks.csv"
        tasks.write_text(f"demo,start_theta,start_omega,goal_theta,goal_omega\nx,{task}\n")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv", "--tasks", tasks)
        assert status == 1
        assert message in said

    def test_enters_every_hypothesis(self, robot: str, run: Run, tmp_path: Path) -> None:
        omega = np.linspace(-3.9, 3.9, 5)
        theta = np.linspace(0.0, 6.2, 60)
        rows = [f"{angle},{speed}" for speed in omega for angle in (*theta, *theta[::-1])]
        (tmp_path / "x.csv").write_text("theta,omega\n" + "\n".join(rows))
        status, out, said = run(
            "infer", robot, tmp_path / "x.csv", "--solver", SOLVER, "--samples", 100
        )
        assert status == 0
        assert "no hypothesis is left" in said
        assert "x alone enters 30" in said
        assert "No hypothesis is left" in out

    def test_unknown_problem(self, run: Run) -> None:
        status, _, said = run("infer", "pendulun")
        assert status == 1
        assert "expected one of car" in said

    def test_unknown_parameter(self, run: Run) -> None:
        status, _, said = run("infer", "pendulum?torque=3")
        assert status == 1
        assert "no parameter 'torque'; there are max_torque" in said

    @pytest.mark.parametrize(
        ("option", "value", "message"),
        [
            ("--score", "best", "best"),
            ("--method", "magic", "method: expected one of smc, importance, plain, got 'magic'"),
            ("--samples", 0, "samples: expected a whole number >= 2, got 0"),
            ("--seed", -1, "seed: expected a whole number >= 0, got -1"),
            ("--solver", "grid?num_points", "expected name=value after '?'"),
            ("--report", ".", "is a folder; name a file"),
            ("--report", "/proc/none/x.html", "cannot write in /proc/none"),
        ],
    )
    def test_options_are_refused_before_the_work(
        self, robot: str, run: Run, option: str, value: object, message: str
    ) -> None:
        status, out, said = run("infer", robot, option, value)
        assert status in (1, 2)
        assert message in out + said
        assert "learning" not in said

    def test_tasks_are_refused_before_learning(self, robot: str, run: Run, tmp_path: Path) -> None:
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

    def test_num_of_demonstrations(self, robot: str, run: Run) -> None:
        status, _, said = run("demonstrate", robot, "--constraint", 3, "--num", 0, "--out", "x")
        assert status == 1
        assert "--num: expected at least 1, got 0" in said

    def test_unknown_solver(self, robot: str, run: Run) -> None:
        status, _, said = run("infer", robot, "--solver", "magic")
        assert status == 1
        assert "no solver named 'magic'; there are grid, ppo" in said


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


def test_importing_swerve_loads_nothing_heavy() -> None:
    code = (
        "import sys, swerve\n"
        "heavy = {'numpy', 'jax', 'equinox', 'scipy', 'polars', 'matplotlib', 'rich', 'cyclopts'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "assert set(swerve.__all__) <= set(dir(swerve))\n"
        "for name in swerve.__all__: getattr(swerve, name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_unknown_attribute() -> None:
    import swerve

    with pytest.raises(AttributeError, match="has no attribute 'infur'"):
        swerve.infur  # noqa: B018


@pytest.mark.parametrize("command", ["infer pendulum a.csv", "watch pendulum --work w"])
def test_options_of_judging_are_arguments_of_infer_and_of_a_monitor(command: str) -> None:
    words = f"{command} --prior-none 0.25 --tolerance 0.1"
    words += " --margin.theta 0.05 --margin.omega 0.2 --clearance 0.3"
    _, bound, _ = cli.app.parse_args(words.split())
    margin = {"theta": 0.05, "omega": 0.2}
    judged = {"prior": 0.25, "tolerance": 0.1, "margin": margin, "clearance": 0.3}
    assert vars(bound.arguments["judged"]) == judged
    for accepts in (swerve.infer, swerve.Monitor):
        assert set(judged) <= set(inspect.signature(accepts).parameters)
