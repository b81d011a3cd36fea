"""The command as a user meets it: answers, work folders, and what it says of bad input."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from swerve import cli, sampling, store
from swerve.demonstrations import read_demonstrations
from swerve.evidence import Evidence
from swerve.settings import Settings
from swerve.space import TWO_PI, StateSpace, Task
from swerve.work import Work

ROBOT = """
import math
import neighbour
from swerve import Pendulum, Problem, grid

def problem(beta: float = 0.05, between_states: bool = True):
    cells = grid(theta=(0.0, 2 * math.pi, 6), omega=(-4.0, 4.0, 5))
    mdp = Pendulum(max_torque=neighbour.MAX_TORQUE, dt=0.4, num_steps=6)
    return Problem(mdp, cells, beta=beta, between_states=between_states)
"""
SOLVER = "grid?num_points=40"
CONSTRAINT = 17
SPACE = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-8.0, 8.0]]))

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def robot(tmp_path: Path) -> str:
    """A user's problem in a file of its own, with a neighbour that it imports."""
    (tmp_path / "robot.py").write_text(ROBOT)
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    sys.modules.pop("neighbour", None)
    return f"{tmp_path / 'robot.py'}:problem"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process; return status, standard output and standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        sys.modules.pop("neighbour", None)  # a new process would import it anew
        monkeypatch.setattr(sys, "argv", ["swerve", *map(str, arguments)])
        monkeypatch.setattr(os, "_exit", sys.exit)  # which would end the tests
        try:
            cli.main()
            status = 0
        except SystemExit as stop:
            status = stop.code if isinstance(stop.code, int) else 1
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Demonstrations of a constraint, made by the command itself."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "robot.py").write_text(ROBOT)
    (folder / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    sys.modules.pop("neighbour", None)
    cli.demonstrate(f"{folder}/robot.py:problem", constraint=CONSTRAINT, num=4, out=folder / "out")
    return sorted((folder / "out").glob("demo_*.csv"))


def infer(robot: str, files: list[Path], work: Path, *more: object) -> list[object]:
    """Return the arguments of an inference."""
    tasks = files[0].parent / "tasks.csv"
    return ["infer", robot, *files, "--tasks", tasks, "--work", work, "--samples", 500, *more]


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


def test_second_call_needs_neither_jax_nor_user_code(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    arguments = infer(robot, demonstrations, tmp_path / "work", "--json")
    status, first, _ = run(*arguments, "--solver", SOLVER)
    assert status == 0
    code = (
        "import sys\n"
        "for name in ('jax', 'equinox', 'neighbour', 'polars', 'rich.progress', 'matplotlib',\n"
        "             'numpy.ma'):\n"
        "    sys.modules[name] = None\n"  # importing it would raise
        f"sys.argv = {['swerve', *map(str, arguments)]!r}\n"
        "from swerve.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert json.loads(done.stdout) == json.loads(first)


@pytest.mark.parametrize("changed", ["robot.py", "neighbour.py"])
def test_a_changed_source_is_noticed(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path, changed: str
) -> None:
    arguments = infer(robot, demonstrations, tmp_path / "work", "--json")
    _, first, _ = run(*arguments, "--solver", SOLVER)
    source = tmp_path / changed
    source.write_text(source.read_text().replace("3.0", "2.0").replace("0.05", "0.2"))
    status, second, said = run(*arguments, "--solver", SOLVER)
    assert status == 0
    assert f"{changed} has changed" in said
    assert "working it out anew" in said
    partitions = [
        [task["log_partition"] for task in json.loads(text)["diagnostics"]]
        for text in (first, second)
    ]
    assert partitions[0] != partitions[1]
    status, third, said = run(*arguments)
    assert "has changed" not in said
    assert json.loads(third) == json.loads(second)


def test_learning_notices_a_changed_source(robot: str, run: Run, tmp_path: Path) -> None:
    arguments = ("learn", robot, "--work", tmp_path / "work", "--solver", SOLVER)
    assert run(*arguments)[0] == 0
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 2.0\n")
    status, _, said = run(*arguments)
    assert status == 0
    assert "neighbour.py has changed" in said
    assert "max_torque=2" in said


def test_a_folder_with_files_of_others_is_left_alone(robot: str, run: Run, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    (work / "model.checkpoint").write_text("weeks of work")
    status, _, said = run("learn", robot, "--work", work, "--solver", SOLVER)
    assert status == 1
    assert "holds model.checkpoint but no problem.json" in said
    assert (work / "model.checkpoint").read_text() == "weeks of work"


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
    ):
        arguments = ("--constraint", 3, "--out", tmp_path / out, *more)
        status, _, said = run("demonstrate", robot, *arguments)
        assert status == 1
        assert message in said
        assert "demonstrating" not in said


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
    assert "expected a swerve.Grid, got PPO(" in said


def test_new_tasks_are_added_to_what_is_there(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    run(*infer(robot, demonstrations[:2], work, "--solver", SOLVER))
    _, out, _ = run(*infer(robot, demonstrations, work, "--json"))
    together = {tuple(d["start"]): d["log_partition"] for d in json.loads(out)["diagnostics"]}
    _, out, _ = run(*infer(robot, demonstrations, tmp_path / "other", "--solver", SOLVER, "--json"))
    anew = {tuple(d["start"]): d["log_partition"] for d in json.loads(out)["diagnostics"]}
    assert together == pytest.approx(anew, abs=1e-4)


def test_other_settings_are_kept_beside_the_first_and_used_until_others_are_asked_for(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"

    def ask(*more: object) -> tuple[int, str]:
        status, out, said = run("infer", robot, demonstrations[0], "--work", work, "--json", *more)
        assert status == 0, said
        [diagnostics] = json.loads(out)["diagnostics"]
        return diagnostics["num_trajectories"], diagnostics["method"]

    assert ask("--solver", SOLVER, "--samples", 500, "--seed", 3) == (500, "importance")
    assert ask("--samples", 700, "--method", "plain") == (700, "plain")
    assert ask() == (700, "plain")
    assert ask("--samples", 500) == (500, "plain")
    assert ask("--method", "importance") == (500, "importance")
    assert ask("--samples", 700) == (700, "plain")
    assert {unquote(path.name) for path in work.glob("*.evidence")} == {
        f"{SOLVER}.seed3.importance.500.evidence",
        f"{SOLVER}.seed3.plain.500.evidence",
        f"{SOLVER}.seed3.plain.700.evidence",
    }
    assert len(list(work.glob("*.nominal"))) == 1


def test_the_seed_of_learning_is_remembered(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    run("learn", robot, "--work", work, "--solver", SOLVER, "--seed", 3)
    run(*infer(robot, demonstrations[:1], work))
    results = {path.name for path in work.iterdir()} - {"problem.json", ".lock"}
    assert len(results) == 2
    assert all(".seed3." in name for name in results)
    run(*infer(robot, demonstrations[:1], work, "--seed", 4))
    assert len(list(work.glob("*.nominal"))) == 2


def test_what_is_finished_is_kept_when_sampling_is_interrupted(
    robot: str,
    run: Run,
    demonstrations: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work, whole = tmp_path / "work", sampling.sample_each

    def interrupted(*arguments, **settings):
        yield from itertools.islice(whole(*arguments, **settings), 2)
        raise KeyboardInterrupt

    monkeypatch.setattr("swerve.sampling.sample_each", interrupted)
    arguments = infer(robot, demonstrations, work, "--solver", SOLVER, "--json")
    status, _, said = run(*arguments)
    assert status == 130
    assert "the same command goes on" in said
    [path] = work.glob("*.evidence")
    assert Evidence.load(path).num_tasks == 2
    asked = []

    def counting(nominal, tasks, *arguments, **settings):
        asked.append(len(tasks.start))
        return whole(nominal, tasks, *arguments, **settings)

    monkeypatch.setattr("swerve.sampling.sample_each", counting)
    assert run(*arguments)[0] == 0
    assert asked == [2]
    assert Evidence.load(path).num_tasks == 4


def test_nothing_is_said_to_go_on_without_a_work_folder(
    robot: str, run: Run, demonstrations: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("swerve.sampling.sample_each", interrupted)
    status, _, said = run("infer", robot, demonstrations[0], "--solver", SOLVER)
    assert status == 130
    assert said.endswith("interrupted\n")


def test_a_change_that_no_source_shows_is_noticed_when_the_problem_is_loaded(
    run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    """The problem reads a data file, whose hash is not recorded."""
    text = ROBOT.replace("neighbour.MAX_TORQUE", "float(pathlib.Path(DATA).read_text())")
    text = text.replace(
        "import neighbour", f"import pathlib\nDATA = {str(tmp_path / 'data.txt')!r}"
    )
    (tmp_path / "reads.py").write_text(text)
    (tmp_path / "data.txt").write_text("3.0")
    robot, work = f"{tmp_path / 'reads.py'}:problem", tmp_path / "work"
    run(*infer(robot, demonstrations[:1], work, "--solver", SOLVER))
    (tmp_path / "data.txt").write_text("2.0")
    status, out, said = run(*infer(robot, demonstrations[:2], work))
    assert status == 0
    assert "is out of date (the problem has changed)" in said
    assert "max_torque=2" in out
    [path] = work.glob("*.evidence")
    assert Evidence.load(path).num_tasks == 2


def test_a_predicate_is_not_judged_by_old_evidence(run: Run, tmp_path: Path) -> None:
    (tmp_path / "fast.py").write_text(
        ROBOT.replace(
            "neighbour.MAX_TORQUE", f"float(pathlib.Path({str(tmp_path)!r}, 'd').read_text())"
        )
        .replace("import neighbour", "import pathlib\nimport swerve")
        .replace("mdp, cells", "mdp, [swerve.Predicate('fast', lambda s: s[..., 1] > 1.0)]")
    )
    (tmp_path / "d").write_text("3.0")
    arguments = ("infer", f"{tmp_path / 'fast.py'}:problem", "--work", tmp_path / "work", "--json")
    _, first, _ = run(*arguments, "--solver", SOLVER, "--samples", 300)
    (tmp_path / "d").write_text("1.0")
    status, second, said = run(*arguments)
    assert status == 0
    assert "is out of date" in said
    assert json.loads(second)["ranking"] != json.loads(first)["ranking"]


def test_a_solver_that_is_refused_is_not_remembered(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    arguments = ("infer", robot, demonstrations[0], "--work", work)
    assert run(*arguments, "--solver", SOLVER, "--samples", 300)[0] == 0
    status, _, said = run(*arguments, "--solver", "grid?num_points=3")
    assert status == 1
    assert "expected at least 4 nodes" in said
    status, _, said = run(*arguments)
    assert status == 0
    assert "learning" not in said


def test_two_processes_add_to_one_folder(
    robot: str, demonstrations: list[Path], tmp_path: Path
) -> None:
    """Each has read the folder before the other has written what it found."""
    settings = Settings(SOLVER, num_trajectories=300)
    tasks = [read_demonstrations([path], SPACE)[0].task for path in demonstrations[:3]]
    Work(robot, tmp_path / "work", settings).evidence(Task.stack(tasks[:1]))
    works = [Work(robot, tmp_path / "work", settings) for _ in range(2)]
    empty = Work(robot, tmp_path / "later", settings)
    known = [work._stored_evidence() for work in works]
    for work, task, evidence in zip(works, tasks[1:], known, strict=True):
        work._sample(Task.stack([task]), evidence)
    found = Work(robot, tmp_path / "work", settings).evidence(None)
    assert found.num_tasks == 3
    Work(robot, tmp_path / "later", settings).evidence(Task.stack(tasks[:2]))
    empty._sample(Task.stack(tasks[2:]), None)
    assert Work(robot, tmp_path / "later", settings).evidence(None).num_tasks == 3


def test_other_weights_need_no_other_samples(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    arguments = infer(robot, demonstrations[:2], work, "--solver", SOLVER, "--json")
    run(*arguments)
    status, out, said = run(*arguments, "--method", "plain")
    assert status == 0
    assert "sampling" not in said
    _, anew, _ = run(
        *infer(robot, demonstrations[:2], tmp_path / "other", "--json"),
        "--solver",
        SOLVER,
        "--method",
        "plain",
    )
    assert json.loads(out)["ranking"] == json.loads(anew)["ranking"]


def test_a_module_of_another_folder_is_another_problem(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "mymodel.py").write_text(
            ROBOT.replace("neighbour.MAX_TORQUE", "3.0").replace("import neighbour", "")
        )
    arguments = ("learn", "mymodel:problem", "--work", tmp_path / "work", "--solver", SOLVER)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path / "a")
    assert run(*arguments)[0] == 0
    monkeypatch.setattr(sys, "path", [x for x in sys.path if not x.startswith(str(tmp_path))])
    monkeypatch.delitem(sys.modules, "mymodel")
    monkeypatch.chdir(tmp_path / "b")
    status, _, said = run(*arguments)
    assert status == 1
    assert f"holds the results of 'mymodel:problem in {tmp_path / 'a'}'" in said


def test_settings_of_a_newer_version_are_no_error(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    arguments = infer(robot, demonstrations[:1], work, "--solver", SOLVER)
    run(*arguments)
    data = store.read_json(work / "problem.json")
    data["settings"]["islands"], data["swerve"] = 3, "99.0"
    store.write_json(work / "problem.json", data)
    status, _, said = run(*arguments)
    assert status == 0
    assert "swerve was 99.0 and is" in said


def test_evidence_of_another_version_of_the_problem_is_refused(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    """As a process leaves it that was under way when a source changed."""
    works = tmp_path / "old", tmp_path / "new"
    run(*infer(robot, demonstrations[:1], works[0], "--solver", SOLVER))
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 2.0\n")
    run(*infer(robot, demonstrations[:1], works[1], "--solver", SOLVER))
    [old], [new] = (list(work.glob("*.evidence")) for work in works)
    new.write_bytes(old.read_bytes())
    status, _, said = run(*infer(robot, demonstrations[:1], works[1]))
    assert status == 1
    assert f"{new}: holds evidence of another version of the problem" in said


def test_old_results_are_there_until_new_ones_are_worked_out(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    run(*infer(robot, demonstrations[:1], work, "--solver", SOLVER))
    before = {path: path.read_bytes() for path in work.iterdir()}
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 2.0\n")
    (tmp_path / "x.csv").write_text("theta\n1\n2\n")
    assert run("infer", robot, tmp_path / "x.csv", "--work", work)[0] == 1
    assert run(*infer(robot, demonstrations[:1], work, "--solver", "magic"))[0] == 1
    assert {path: path.read_bytes() for path in work.iterdir()} == before


def test_learn_and_sample_ahead_then_infer(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work, tasks = tmp_path / "work", demonstrations[0].parent / "tasks.csv"
    assert run("learn", robot, "--work", work, "--solver", SOLVER)[0] == 0
    status, out, _ = run("sample", robot, "--work", work, "--tasks", tasks, "--samples", 500)
    assert status == 0
    assert "500 trajectories for each of 4 tasks" in out
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
        assert "expected one of pendulum" in said

    def test_unknown_parameter(self, run: Run) -> None:
        status, _, said = run("infer", "pendulum?torque=3")
        assert status == 1
        assert "no parameter 'torque'; there are max_torque" in said

    @pytest.mark.parametrize(
        ("option", "value", "message"),
        [
            ("--score", "best", "best"),
            ("--method", "magic", "method: expected one of importance, plain, got 'magic'"),
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

    def test_work_folder_of_another_problem(
        self, robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
    ) -> None:
        work = tmp_path / "work"
        run(*infer(robot, demonstrations[:1], work, "--solver", SOLVER))
        before = {path: path.read_bytes() for path in work.iterdir()}
        status, _, said = run(*infer(f"{robot}?beta=2", demonstrations[:1], work))
        assert status == 1
        assert "holds the results of" in said
        assert "another --work folder" in said
        assert {path: path.read_bytes() for path in work.iterdir()} == before

    def test_truncated_evidence(
        self, robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
    ) -> None:
        work = tmp_path / "work"
        arguments = infer(robot, demonstrations[:1], work, "--solver", SOLVER)
        run(*arguments)
        [path] = work.glob("*.evidence")
        path.write_bytes(path.read_bytes()[:-100])
        before = path.read_bytes()
        status, _, said = run(*arguments)
        assert status == 1
        assert f"{path}: cut short or altered" in said
        assert path.read_bytes() == before

    def test_read_only_folder_is_refused_before_the_work(
        self, robot: str, run: Run, demonstrations: list[Path], tmp_path: Path, nobody: None
    ) -> None:
        work = tmp_path / "locked" / "work"
        status, _, said = run(*infer(robot, demonstrations[:1], work, "--solver", SOLVER))
        assert status == 1
        assert "cannot write in" in said
        assert "choose a folder that you can write" in said
        assert "sampling" not in said


@pytest.fixture
def nobody(tmp_path: Path, demonstrations: list[Path]) -> Iterator[None]:
    """Run as a user who may read everything in the temporary folder and write nothing."""
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    for folder in (demonstrations[0].parent, *demonstrations[0].parents, tmp_path):
        if folder.stat().st_uid == os.geteuid() and folder.is_relative_to(tmp_path.parents[1]):
            folder.chmod(0o755)
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


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
    assert store.open_file(checkpoint, "swerve-ppo-checkpoint", 1).names
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
