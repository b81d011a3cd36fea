"""What options of `infer`, `sample`, `fit-beta`, `watch`, `learn` and `demo` do to the answer.

`test_options.py` holds the table that says which test is of which option. Samples are made once:
options of judging are used on what a work folder holds.
"""

from __future__ import annotations

import io
import json
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import ROBOT, SOLVER, Run

from swerve import Evidence
from swerve.cli import demo as demo_command
from swerve.monitoring import foresee as foresight_training
from swerve.solvers.grid import grid as grid_solver
from swerve.work import settings

OTHER = ("--solver", "grid?num_points=30", "--samples", 400, "--method", "importance", "--seed", 5)
OTHER_FILE = "grid%3Fnum_points=30.seed5"


@pytest.fixture(scope="module")
def made(
    tmp_path_factory: pytest.TempPathFactory, demonstrations: list[Path]
) -> tuple[str, Path, list[Path]]:
    """A problem, its work folder with samples of all demonstrations, and the demonstrations."""
    from swerve.work.work import Work

    folder = tmp_path_factory.mktemp("options")
    (folder / "robot.py").write_text(ROBOT)
    (folder / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    sys.modules.pop("neighbour", None)
    problem = f"{folder}/robot.py:problem"
    rows = np.loadtxt(
        demonstrations[0].parent / "tasks.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3, 4)
    )
    from swerve import Task

    chosen = settings.Settings(SOLVER, num_trajectories=500)
    Work(problem, folder / "work", chosen).evidence(Task(rows[:, :2], rows[:, 2:]))
    return problem, folder / "work", demonstrations


@pytest.fixture
def ask(made: tuple[str, Path, list[Path]], run: Run) -> Any:
    """Return a function that infers from all demonstrations with more options, as JSON."""
    problem, work, files = made

    def ask(*more: object, files: list[Path] = files) -> dict[str, Any]:
        tasks = files[0].parent / "tasks.csv"
        common = ("--tasks", tasks, "--work", work, "--no-resolve", "--json")
        status, out, said = run("infer", problem, *files, *common, *more)
        assert status == 0, said
        return json.loads(out)

    return ask


def nats(answer: dict[str, Any]) -> dict[int, float]:
    """Return the scores of an answer by hypothesis."""
    return {row["index"]: row["log_likelihood"] for row in answer["ranking"]}


class TestJudging:
    def test_prior_none(self, ask: Any) -> None:
        half, most = (ask(*more)["none"]["posterior"] for more in ((), ("--prior-none", 0.9)))
        assert most / (1 - most) == pytest.approx(9.0 * half / (1 - half))
        assert ask("--prior-none", 0)["none"]["posterior"] == 0.0

    def test_tolerance(self, ask: Any) -> None:
        """What was struck out comes back, and nothing explains as much as before."""
        strict, lenient = nats(ask()), nats(ask("--tolerance", 0.1))
        assert set(strict) < set(lenient)
        assert all(lenient[index] <= strict[index] + 1e-9 for index in strict)

    def test_margin(self, ask: Any) -> None:
        strict, deep = ask(), ask("--margin.theta", 0.4, "--margin.omega", 0.6)
        assert set(nats(strict)) < set(nats(deep))

    def test_clearance(self, ask: Any) -> None:
        """Where all tasks lie within the clearance of everything, they tell nothing."""
        usual = nats(ask("--clearance", 0))
        assert max(usual.values()) > 0.5
        far = nats(ask("--clearance", 100.0))
        assert len(far) == 30
        assert set(far.values()) == {0.0}

    def test_score(self, ask: Any) -> None:
        average = ask("--score", "average")
        violated = [row["average_violation"] for row in average["ranking"]]
        assert violated == sorted(violated, reverse=True)
        assert (average["score"], ask()["score"]) == ("average", "likelihood")

    def test_tasks(self, ask: Any, made: Any, run: Run) -> None:
        """Of a demonstration alone the goal is its last state; the file says another one."""
        problem, _, files = made
        goals = [
            json.loads(run("infer", problem, files[0], *OTHER, "--json", *more)[1])["diagnostics"]
            for more in ((), ("--tasks", files[0].parent / "tasks.csv"))
        ]
        assert goals[0][0]["goal"] != goals[1][0]["goal"]
        assert len(ask(files=files[:2])["diagnostics"]) == 2

    def test_report(self, ask: Any, tmp_path: Path) -> None:
        ask("--report", tmp_path / "page.html")
        assert "<html" in (tmp_path / "page.html").read_text()

    def test_json(self, made: Any, run: Run) -> None:
        problem, work, files = made
        words = ("infer", problem, *files, "--tasks", files[0].parent / "tasks.csv", "--work", work)
        status, out, _ = run(*words, "--no-resolve")
        assert status == 0
        assert not out.startswith("{")
        assert "ranking" in json.loads(run(*words, "--no-resolve", "--json")[1])


def sampled(work: Path, method: str = "importance") -> Evidence:
    """Return the evidence of the other settings, from where these settings put it."""
    return Evidence.load(work / f"{OTHER_FILE}.{method}.400.evidence")


def check_sampled(work: Path, first: Evidence) -> None:
    """Assert that each of the other settings was used: solver, samples, method and seed."""
    found = sampled(work)
    assert found.solver == "Grid(num_points=(30, 30))"
    assert (found.num_trajectories, found.method, found.seed) == (400, "importance", 5)
    assert found.log_partition[0] != first.log_partition[0]


class TestLearningAndSampling:
    def test_infer(self, made: Any, run: Run, tmp_path: Path) -> None:
        problem, work, files = made
        (first,) = work.glob("*.smc.500.evidence")
        words = (problem, files[0], "--tasks", files[0].parent / "tasks.csv", *OTHER)
        assert run("infer", *words, "--work", tmp_path / "w")[0] == 0
        check_sampled(tmp_path / "w", Evidence.load(first))
        assert not list(work.glob(f"{OTHER_FILE}*"))

    def test_fit_beta(self, made: Any, run: Run, tmp_path: Path) -> None:
        problem, work, files = made
        (first,) = work.glob("*.smc.500.evidence")
        tasks = ("--tasks", files[0].parent / "tasks.csv")
        words = ("fit-beta", problem, *files, *OTHER, "--work", tmp_path / "w")
        answers = []
        for more in ((), ("--confidence", 0.05)):
            status, out, said = run(*words, *tasks, *more, "--json")
            assert status == 0, said
            answers.append(json.loads(out))
        check_sampled(tmp_path / "w", Evidence.load(first))
        assert [answer["confidence"] for answer in answers] == [0.95, 0.05]
        wide, narrow = ((answer["high"] or np.inf) - answer["low"] for answer in answers)
        assert narrow < wide
        status, out, _ = run(*words, *tasks)
        assert status == 0
        assert out.startswith("beta ")
        before = sampled(tmp_path / "w").num_tasks
        assert run(*words)[0] in (0, 1)  # with the last states as goals: other tasks
        assert sampled(tmp_path / "w").num_tasks > before

    def test_sample(self, made: Any, run: Run, tmp_path: Path) -> None:
        problem, work, files = made
        (first,) = work.glob("*.smc.500.evidence")
        tasks = ("--tasks", files[0].parent / "tasks.csv")
        words = ("sample", problem, "--work", tmp_path / "w", *OTHER, *tasks)
        status, out, said = run(*words, "--json")
        assert status == 0, said
        found = json.loads(out)
        assert found["num_trajectories"] == 400
        assert len(found["tasks"]) == len(files)
        check_sampled(tmp_path / "w", Evidence.load(first))
        assert run(*words)[1].startswith(f"{len(files)} tasks, 400 trajectories a task")

    def test_learn(self, made: Any, run: Run, tmp_path: Path) -> None:
        problem = made[0]
        words = ("learn", problem, "--work", tmp_path / "w", "--solver", "grid?num_points=30")
        assert run(*words, "--seed", 5)[0] == 0
        assert (tmp_path / "w" / f"{OTHER_FILE}.nominal").exists()


@pytest.fixture
def watched(made: Any, run: Run, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that watches the first demonstration with more options, by its lines."""
    problem, work, files = made
    quick = partial(foresight_training.foresee, num_trajectories=256, num_updates=20)
    monkeypatch.setattr(foresight_training, "foresee", quick)
    rows = np.loadtxt(files[0], delimiter=",", skiprows=1)[:, 1:3].tolist()

    def watch(*more: object, work: Path = work, name: str = files[0].stem) -> list[dict[str, Any]]:
        lines = [json.dumps({"theta": row[0], "omega": row[1], "id": name}) for row in rows]
        text = "\n".join([*lines, json.dumps({"end": True, "id": name}), ""])
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        status, out, said = run("watch", problem, "--work", work, *more)
        assert status == 0, said
        return [json.loads(line) for line in out.splitlines()]

    return watch


def entered(answers: list[dict[str, Any]]) -> set[int]:
    """Return the hypotheses that a demonstration entered, by all answers to it."""
    return {index for answer in answers for index in answer["struck_out"]}


class TestWatch:
    def test_judging(self, watched: Any, made: Any) -> None:
        tasks = ("--tasks", made[2][0].parent / "tasks.csv")
        usual = watched(*tasks)
        assert watched(*tasks, "--prior-none", 0.9)[-1]["none"] > usual[-1]["none"]
        assert watched(*tasks, "--tolerance", 0.2)[-1]["none"] != usual[-1]["none"]
        deep = watched(*tasks, "--margin.theta", 0.4, "--margin.omega", 0.6)
        assert entered(deep) < entered(usual)
        far = watched(*tasks, "--clearance", 100.0)[-1]
        assert far["none"] == pytest.approx(0.5)
        assert all(row["nats"] == 0.0 for row in far["likely"])

    def test_tasks(self, watched: Any, made: Any) -> None:
        """Ids are rows of the file; without a file they number the tasks of the work folder."""
        tasks = ("--tasks", made[2][0].parent / "tasks.csv")
        assert not any("error" in answer for answer in watched(*tasks))
        assert all("error" in answer for answer in watched())
        assert not any("error" in answer for answer in watched(name="0"))

    def test_learning_and_sampling(self, watched: Any, made: Any, tmp_path: Path) -> None:
        (first,) = made[1].glob("*.smc.500.evidence")
        tasks = ("--tasks", made[2][0].parent / "tasks.csv")
        watched(*tasks, *OTHER, work=tmp_path / "w")
        check_sampled(tmp_path / "w", Evidence.load(first))
        assert list((tmp_path / "w").glob("*.foresight"))


def test_demo(made: Any, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a problem that is quicker than the one it ships."""
    problem, _, files = made
    shutil.copytree(files[0].parent, tmp_path / "data")
    monkeypatch.setattr(demo_command, "FOLDER", tmp_path / "data")
    monkeypatch.setattr(demo_command, "PROBLEM", problem)
    monkeypatch.setattr(grid_solver, "DEFAULT_POINTS", {2: 40})
    monkeypatch.setattr(settings, "NUM_TRAJECTORIES", 500)
    monkeypatch.chdir(tmp_path)
    status, out, said = run("demo", "--work", tmp_path / "w", "--report", "mine.html")
    assert status == 0, said
    assert "hypothesis" in out
    assert (tmp_path / "mine.html").exists()
    assert not (tmp_path / "swerve-demo.html").exists()
    assert list((tmp_path / "w").glob("*.evidence"))
