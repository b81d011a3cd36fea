"""The record of a work folder: what it says, and what writing it moves aside."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.command import SOLVER
from support.evidence_parts import assert_equal, resolved
from support.synthetic import TASKS, make_evidence, make_record

from swerve.base import store
from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.schema import StoredEvidence
from swerve.work.folder import LONGEST_NAME, Reading, State, WorkFolder
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


def test_settings_that_no_file_name_holds_are_refused(tmp_path: Path) -> None:
    """The longest name of a result is one that a file system takes."""
    folder = WorkFolder(tmp_path, "pendulum")
    held, longer = (
        Settings(f"grid?num_points={'9' * num}", 0, "importance", 10_000) for num in (150, 200)
    )
    folder.result_path("evidence", held).write_text("")
    with pytest.raises(ValueError, match="fit in the name of a file, 230 characters, got 2"):
        folder.result_path("evidence", longer)
    for suffix in (".nominal", ".evidence", ".foresight", ".checkpoint", ".training.png"):
        (tmp_path / ("n" * LONGEST_NAME + suffix)).write_text("")


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


class TestAddEvidence:
    """Two processes have read the folder before either writes."""

    settings = Settings(SOLVER, 0, "importance", 400)

    def written(self, folder: Path, *parts: Evidence) -> Evidence:
        record = make_record()
        folder.mkdir(exist_ok=True)
        for part in parts:
            WorkFolder(folder, "pendulum").add_evidence(part, self.settings, record)
        found = WorkFolder(folder, "pendulum").read_evidence(self.settings, record)
        assert found is not None
        return found

    def test_tasks_come_after_what_is_stored(self, tmp_path: Path) -> None:
        whole = make_evidence()
        found = self.written(tmp_path, whole.select([2]), whole.select([0]), whole.select([1, 2]))
        assert_equal(found, whole.select([2, 0, 1]))

    def test_what_one_has_resolved_outlasts_what_the_other_writes(self, tmp_path: Path) -> None:
        known = make_evidence().select([0, 1])
        mine, theirs = resolved(known, 0, 3), resolved(known, 1, 5)
        found = self.written(tmp_path, known, mine, theirs, make_evidence())
        assert_equal(found, resolved(resolved(make_evidence(), 0, 3), 1, 5))

    def test_samples_are_read_once_however_often_ratios_are_added(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        known, parts, read = self.written(tmp_path, make_evidence()), [], StoredEvidence.read

        def counting(self: StoredEvidence, part: str, *more: str) -> list[np.ndarray]:
            parts.append(part)
            return read(self, part, *more)

        monkeypatch.setattr(StoredEvidence, "read", counting)
        for hypothesis in (3, 5, 7):
            known = resolved(known, 0, hypothesis)
            found = self.written(tmp_path, known)
        assert parts.count("samples") == 1
        assert_equal(found, known)

    def test_what_is_resolved_for_a_near_task_is_not_taken_over(self, tmp_path: Path) -> None:
        """Its samples are others, and so is its Z_0."""
        near = make_evidence(tasks=Task(TASKS.start + 1e-5, TASKS.goal))
        found = self.written(tmp_path, make_evidence(), resolved(near, 0, 3))
        assert_equal(found, make_evidence())

    @pytest.mark.parametrize("order", [1, -1])
    def test_what_is_resolved_goes_before_what_was_tried_in_vain(
        self, order: int, tmp_path: Path
    ) -> None:
        known = make_evidence()
        values = known.summary.log_ratio_error.copy()
        values[0, 3] = math.inf
        tried = dataclasses.replace(known, summary=known.summary._replace(log_ratio_error=values))
        assert_equal(self.written(tmp_path / "a", known, tried, known), tried)
        both = (tried, resolved(known, 0, 3))[::order]
        assert_equal(self.written(tmp_path / "b", *both), resolved(known, 0, 3))
