"""Work folders notice that a problem has changed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from support.command import ROBOT, SOLVER, Run, infer

from swerve.evidence.evidence import Evidence


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
    assert f"moved the old results of {work} to {work / 'outdated'}" in said
    assert Evidence.load(work / "outdated" / path.name).num_tasks == 1
    (tmp_path / "data.txt").write_text("1.0")
    run(*infer(robot, demonstrations[:3], work))
    assert Evidence.load(work / "outdated" / path.name).num_tasks == 2


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
