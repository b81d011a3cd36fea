"""Work folders: what is kept, what is refused."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from support.command import CONSTRAINT, SOLVER, SPACE, Run, infer
from support.evidence_parts import resolved

from swerve.base import interrupts, store
from swerve.base.space import Task
from swerve.demonstrations.demonstration import read_demonstrations
from swerve.evidence.evidence import Evidence
from swerve.sampling import sample as sampling
from swerve.work.folder import WorkFolder
from swerve.work.settings import Settings
from swerve.work.work import Work


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
        "from swerve.cli.app import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert json.loads(done.stdout) == json.loads(first)


def test_a_folder_with_files_of_others_is_left_alone(robot: str, run: Run, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    (work / "model.checkpoint").write_text("weeks of work")
    status, _, said = run("learn", robot, "--work", work, "--solver", SOLVER)
    assert status == 1
    assert "holds model.checkpoint but no problem.json" in said
    assert (work / "model.checkpoint").read_text() == "weeks of work"


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

    assert ask("--solver", SOLVER, "--samples", 500, "--seed", 3) == (500, "smc")
    assert ask("--samples", 700, "--method", "plain") == (700, "plain")
    assert ask() == (700, "plain")
    assert ask("--samples", 500) == (500, "plain")
    assert ask("--method", "smc") == (500, "smc")
    assert ask("--samples", 700) == (700, "plain")
    assert {unquote(path.name) for path in work.glob("*.evidence")} == {
        f"{SOLVER}.seed3.smc.500.evidence",
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


def interrupted_again_while_saving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the interrupt come again before the evidence is written, as where that takes long."""
    add = WorkFolder.add_evidence

    def slowly(self: WorkFolder, *arguments: Any) -> None:
        interrupts._expected.append(None)
        interrupts._interrupt(signal.SIGINT, None)
        add(self, *arguments)

    monkeypatch.setattr(interrupts, "_asked", [None])
    monkeypatch.setattr(interrupts, "_again", lambda seconds: None)
    monkeypatch.setattr(WorkFolder, "add_evidence", slowly)


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

    monkeypatch.setattr("swerve.sampling.sample.sample_each", interrupted)
    arguments = infer(robot, demonstrations, work, "--solver", SOLVER, "--json")
    with monkeypatch.context() as slow:
        interrupted_again_while_saving(slow)
        status, _, said = run(*arguments)
    assert status == 130
    assert "the same command goes on" in said
    [path] = work.glob("*.evidence")
    assert Evidence.load(path).num_tasks == 2
    asked = []

    def counting(nominal, tasks, *arguments, **settings):
        asked.append(len(tasks.start))
        return whole(nominal, tasks, *arguments, **settings)

    monkeypatch.setattr("swerve.sampling.sample.sample_each", counting)
    assert run(*arguments)[0] == 0
    assert asked == [2]
    assert Evidence.load(path).num_tasks == 4


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
    known = [work._stored_evidence(work.record) for work in works]
    assert known[0] is not None
    works[0]._save([resolved(known[0], 0, CONSTRAINT)])
    for work, task, evidence in zip(works, tasks[1:], known, strict=True):
        work._sample(Task.stack([task]), evidence)
    found = Work(robot, tmp_path / "work", settings).evidence(None)
    assert found.num_tasks == 3
    assert found.is_resolved.sum() == 1
    Work(robot, tmp_path / "later", settings).evidence(Task.stack(tasks[:2]))
    empty._sample(Task.stack(tasks[2:]), None)
    assert Work(robot, tmp_path / "later", settings).evidence(None).num_tasks == 3


def test_other_weights_need_no_other_samples(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "work"
    arguments = infer(robot, demonstrations[:2], work, "--solver", SOLVER, "--json")
    run(*arguments, "--method", "importance")
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


class TestBadInput:
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
