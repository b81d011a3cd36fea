"""Outdated results are moved aside all or none, whenever the process is killed."""

from __future__ import annotations

import dataclasses
import os
from functools import partial
from pathlib import Path

import pytest
from support.kills import killed_at
from support.synthetic import make_record

from swerve.base import files
from swerve.work import outdated
from swerve.work.folder import State, WorkFolder
from swerve.work.settings import Settings

NAMES = [f"{name}.seed0.{kind}" for name in ("a", "b") for kind in ("nominal", "smc.20.evidence")]
OLD = make_record()
NEW = dataclasses.replace(OLD, beta=9.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Flushing to the disk is most of the time, and tells nothing here."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def folder_with_results(path: Path) -> WorkFolder:
    """A folder with results of OLD, and in `outdated` results that are older still."""
    folder = WorkFolder(path, "pendulum")
    path.mkdir()
    write(folder, dataclasses.replace(OLD, beta=8.0))
    for name in NAMES:
        (path / name).write_text(f"older {name}")
    write(folder, OLD)
    for name in NAMES:
        (path / name).write_text(name)
    return folder


def write(folder: WorkFolder, record: object) -> None:
    settings = Settings("grid", 0, "smc", 20)
    change = partial(folder.write, is_current=False, moved=lambda aside: None)
    change(record, settings, {})  # pyright: ignore[reportArgumentType]


def contents(folder: Path) -> dict[str, str]:
    """Return the results in a folder."""
    return {path.name: path.read_text() for path in folder.glob("*.seed0.*")}


def number_of_operations(tmp_path: Path) -> int:
    folder = folder_with_results(tmp_path / "counted")
    with killed_at(None, folder.path) as watch:
        write(folder, NEW)
    return watch.done


def test_a_kill_at_any_operation_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next process finds all results in the folder, or all in `outdated`, and no leftovers."""
    results, older = {name: name for name in NAMES}, {name: f"older {name}" for name in NAMES}
    found = []
    num = number_of_operations(tmp_path)
    for number in range(num):
        folder = folder_with_results(tmp_path / str(number))
        with killed_at(number, folder.path) as watch:
            write(folder, NEW)
        assert watch.is_dead
        monkeypatch.setattr(files, "_SWEPT", set())  # as in another process
        record = folder.read().record
        assert record is not None
        now = contents(folder.path), contents(folder.path / "outdated")
        assert now in [(results, older), ({}, results)]
        assert now == ({}, results) or record.beta == OLD.beta
        found.append(now == ({}, results))
        write(folder, NEW)
        assert (contents(folder.path), contents(folder.path / "outdated")) == ({}, results)
        written = folder.read().record
        assert written is not None
        assert written.beta == NEW.beta
        expected = {".lock", outdated.RECORD, outdated.OUTDATED}
        assert {path.name for path in folder.path.iterdir()} == expected
        aside = folder.path / outdated.OUTDATED
        assert {path.name for path in aside.iterdir()} == {*NAMES, outdated.RECORD}
    assert found == sorted(found)  # one operation counts: before it none is moved, after it all
    assert {True, False} == set(found)
    assert num > 20


def test_a_kill_while_taking_back_loses_nothing(tmp_path: Path) -> None:
    """Killed while it moved results, then killed again at each operation of the next process."""
    results = {name: name for name in NAMES}
    for first in range(0, number_of_operations(tmp_path), 3):
        for second in range(100):
            folder = folder_with_results(tmp_path / f"{first}-{second}")
            with killed_at(first, folder.path):
                write(folder, NEW)
            with killed_at(second, folder.path) as watch:
                folder.read()
            folder.read()
            kept = contents(folder.path), contents(folder.path / "outdated")
            assert results in kept
            if not watch.is_dead:
                break


def test_two_folders_of_one_name_are_not_mixed(tmp_path: Path) -> None:
    """A link in place of a folder is no unfinished move; what it leads to stays as it is."""
    folder = folder_with_results(tmp_path / "work")
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / outdated.OLDER).mkdir(parents=True)
    (elsewhere / "precious").write_text("")
    (folder.path / outdated.OUTDATING).symlink_to(elsewhere)
    assert folder.read().state is State.CURRENT
    with pytest.raises(OSError, match=r"cannot write outdating in .*: File exists"):
        write(folder, NEW)
    (folder.path / outdated.OUTDATING).unlink()
    files.remove(folder.path / outdated.OUTDATED)
    (folder.path / outdated.OUTDATED).symlink_to(elsewhere)
    assert folder.read().state is State.CURRENT
    write(folder, NEW)
    assert {path.name for path in elsewhere.iterdir()} == {outdated.OLDER, "precious"}
    assert not (folder.path / outdated.OUTDATED).is_symlink()
    assert set(contents(folder.path / outdated.OUTDATED)) == set(NAMES)
