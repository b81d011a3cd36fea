"""A process that moves outdated results aside again and again, until it is killed."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path

from support.synthetic import make_record

from swerve.base import files, store
from swerve.work.folder import WorkFolder
from swerve.work.settings import Settings

NAMES = [f"{name}.seed0.{kind}" for name in ("a", "b") for kind in ("nominal", "smc.20.evidence")]
SETTINGS = Settings("grid", 0, "smc", 20)


def write(folder: WorkFolder, number: int) -> None:
    """Write the record of a problem, after moving aside the results of another one."""
    record = dataclasses.replace(make_record(), beta=float(number))
    folder.write(record, SETTINGS, {}, is_current=False, moved=lambda aside: None)


def run(path: Path, first: int) -> None:
    """Write records and results of one problem after another."""
    folder = WorkFolder(path, "pendulum")
    for number in itertools.count(first):
        write(folder, number)
        for name in NAMES:
            files.write_text(path / name, str(number))


def check(path: Path) -> int:
    """Check a folder whose process was killed; return the number of the problem in its record.

    The results of the problem before are complete, in the folder or aside. Results of the problem
    itself that were not written yet are written, so that the next check knows what there must be.
    """
    folder = WorkFolder(path, "pendulum")
    folder.read()
    number = int(store.read_json(path / "problem.json")["record"]["beta"])
    aside = {name: (path / "outdated" / name).read_text() for name in NAMES} if number > 1 else {}
    here = {name: (path / name).read_text() for name in NAMES if (path / name).exists()}
    if len(set(aside.values())) > 1:
        raise AssertionError(f"results of several problems are aside: {aside}")
    moved = set(aside.values()) == {str(number)}  # and the next record was not written yet
    expected = {} if moved else dict.fromkeys(here, str(number))
    if here != expected or not (moved or set(aside.values()) <= {str(number - 1)}):
        raise AssertionError(f"problem {number}: {here} here, {aside} aside")
    for name in () if moved else NAMES:  # what the process was killed before it wrote
        files.write_text(path / name, str(number))
    return number


if __name__ == "__main__":
    run(Path(sys.argv[1]), int(sys.argv[2]))
