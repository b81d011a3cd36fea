"""The record of a work folder: what it says, and what writing it moves aside."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import pytest
from support.command import SOLVER

from swerve.base import store
from swerve.work.folder import Reading, State, WorkFolder
from swerve.work.settings import Settings
from swerve.work.work import Work


@pytest.fixture
def written(robot: str, tmp_path: Path) -> WorkFolder:
    """A folder that holds a nominal distribution of the problem."""
    Work(robot, tmp_path / "work", Settings(SOLVER)).nominal()
    return WorkFolder(tmp_path / "work", robot)


def test_a_record_is_absent_current_changed_or_of_another_format(
    written: WorkFolder, robot: str, tmp_path: Path
) -> None:
    assert WorkFolder(tmp_path / "nowhere", robot).read() == Reading(State.ABSENT)
    current = written.read()
    assert current.state is State.CURRENT
    assert current.record is not None
    assert current.settings == Settings(SOLVER, 0, "smc", 10_000)
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 2.0\n")
    changes = (f"{tmp_path / 'neighbour.py'} has changed",)
    assert written.read() == Reading(State.CHANGED, None, current.settings, changes)
    data = store.read_json(written.path / "problem.json")
    store.write_json(written.path / "problem.json", data | {"format": 2})
    assert written.read() == Reading(State.OTHER_FORMAT)


def test_only_results_of_another_problem_are_moved_aside(written: WorkFolder) -> None:
    found = written.read()
    assert found.record is not None
    [nominal] = written.path.glob("*.nominal")
    moved: list[Path] = []
    write = partial(written.write, is_current=False, moved=moved.append)
    write(found.record, found.settings, {})
    assert nominal.exists()
    assert not moved
    write(dataclasses.replace(found.record, beta=9.0), found.settings, {})
    assert moved == [written.path / "outdated"]
    assert not nominal.exists()
    assert (written.path / "outdated" / nominal.name).exists()


def test_the_latest_solver_of_a_name_and_seed(written: WorkFolder) -> None:
    assert written.latest_solver("grid", 0) == SOLVER
    assert written.latest_solver("grid", 1) is None
    assert written.latest_solver("soft-value", 0) is None


@pytest.mark.filterwarnings("ignore:training came no nearer to pi_0")  # a run this short
def test_settings_that_are_left_out_outlast_the_learning_of_a_teacher(
    robot: str, tmp_path: Path
) -> None:
    """The teacher notes its own settings in the record, in place of the student's."""
    sizes = "num_steps=2048&num_lanes=64&segment=8&width=8"
    text = f"distilled?{sizes}"
    Work(robot, tmp_path / "work", Settings(f"soft-value?{sizes}", seed=3)).nominal()
    Work(robot, tmp_path / "work", Settings(text, seed=3)).nominal()
    [nominal] = (tmp_path / "work").glob("distilled*.nominal")
    nominal.unlink()
    said: list[str] = []
    again = Work(robot, tmp_path / "work", say=said.append)
    asked = again.settings
    again.nominal()
    assert (asked.solver, asked.seed) == (str(Settings(text).solver), 3)
    assert again.settings == asked
    assert WorkFolder(tmp_path / "work", robot).read().settings == asked
    assert nominal.exists()
