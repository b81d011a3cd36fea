"""A process may be killed at any moment: nothing is lost, nothing is left behind, the same answer.

The kills are simulated (`support.kills`): they happen before a file operation, of which there are a
few dozen in each scenario, in a process that has JAX and a compiled problem at hand and goes on
afterwards. Loading the problem is replaced by one that is loaded already. Learning, sampling,
inferring and all writing are real. `test_sigkill.py` has real kills.

Every operation of every scenario is killed once. The other kills come in pairs: the next process is
killed as well, at a random operation, while it takes up the work. `make kill` runs more of them.
"""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from support.kills import killed_at

import swerve
from swerve.answer import infer
from swerve.base import files
from swerve.base.space import TWO_PI, Task
from swerve.demonstrations.demonstration import Demonstration, write_demonstrations
from swerve.problem.problem import Problem
from swerve.work import stages
from swerve.work.folder import WorkFolder
from swerve.work.outdated import OLDER, OUTDATED, OUTDATING
from swerve.work.settings import Settings
from swerve.work.work import Work

NUM_KILLS = int(os.environ.get("SWERVE_KILLS", "200"))
TEXT, SOLVER = "pendulum", "enumeration"  # the text is a name alone: see `loaded`
STARTS, GOALS = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[1.0, 0.0], [1.0, 0.0]])


class Pair(NamedTuple):
    """A problem as it is now, and as it was."""

    now: Problem
    old: Problem


@pytest.fixture(scope="module")
def problems() -> Pair:
    cells = swerve.grid(theta=(0.0, TWO_PI, 4))
    mdp = swerve.Pendulum(num_steps=3, dt=0.3)
    return Pair(Problem(mdp, cells, beta=0.5), Problem(mdp, cells, beta=0.4))


@pytest.fixture(autouse=True)
def loaded(problems: Pair, monkeypatch: pytest.MonkeyPatch) -> Callable[[Problem], None]:
    """Load one of the two problems whatever is named, without its source files."""

    def load(problem: Problem) -> None:
        monkeypatch.setattr(stages, "load_problem", lambda text: problem)

    monkeypatch.setattr(stages, "source_hashes", lambda problem: {})
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # takes most of the time
    load(problems.now)
    return load


def demonstrations(num: int) -> list[Demonstration]:
    """Return demonstrations that rest at the start of their tasks."""
    return [Demonstration(f"d{k}", STARTS[[k, k]], Task(STARTS[k], GOALS[k])) for k in range(num)]


def answer(folder: Path, num_tasks: int) -> str:
    """Learn, sample and infer what the folder does not hold; write and return the answer."""
    tasks = Task(STARTS[:num_tasks], GOALS[:num_tasks])
    job = Work(TEXT, folder / "work", Settings(SOLVER))
    result = infer(job.evidence(tasks), demonstrations(1))
    text = json.dumps(result.to_json())
    files.write_text(folder / "answer.json", text)
    return text


def demonstrated(folder: Path, into: str) -> str:
    """Write demonstrations, as `swerve demonstrate` does once they are made."""
    place = folder / into
    if (place / "tasks.csv").exists() and into == "new":
        return "done"  # a whole folder is there: the command would refuse to write it again
    for path in place.glob("*.csv"):  # as the command's message asks for
        path.unlink()
    write_demonstrations(place, demonstrations(2), swerve.Pendulum().space)
    return "done"


class Scenario(NamedTuple):
    """Something that a process does to a folder.

    Attributes:
      prepare: makes the folder as it was before.
      run: does it, or what is still to be done; returns the answer.
    """

    prepare: Callable[[Path], object]
    run: Callable[[Path], str]


@pytest.fixture
def scenarios(
    problems: Pair, loaded: Callable[[Problem], None], tmp_path: Path
) -> dict[str, Scenario]:
    """The scenarios by name; folders that they begin with are made once and copied."""
    kept = {name: tmp_path / f"kept-{name}" for name in ("one task", "old", "older")}
    answer(kept["one task"], 1)
    loaded(problems.old)
    answer(kept["old"], 1)
    shutil.copytree(kept["old"], kept["older"])
    loaded(problems.now)
    answer(kept["older"], 1)  # moves the results of the old problem aside
    loaded(problems.old)
    answer(kept["older"], 1)  # and these results too: now `outdated` holds those of another problem
    loaded(problems.now)

    def copy(name: str) -> Callable[[Path], object]:
        return lambda folder: shutil.copytree(kept[name], folder)

    def with_other_file(folder: Path) -> None:
        (folder / "used").mkdir(parents=True)
        (folder / "used" / "notes.txt").write_text("of the user")

    return {
        "from nothing": Scenario(Path.mkdir, lambda folder: answer(folder, 2)),
        "one task more": Scenario(copy("one task"), lambda folder: answer(folder, 2)),
        "changed": Scenario(copy("old"), lambda folder: answer(folder, 1)),
        "changed again": Scenario(copy("older"), lambda folder: answer(folder, 1)),
        "new demonstrations": Scenario(Path.mkdir, lambda folder: demonstrated(folder, "new")),
        "demonstrations": Scenario(with_other_file, lambda folder: demonstrated(folder, "used")),
    }


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file in a folder, except those of locks."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def check_nothing_lost(folder: Path, before: dict[str, bytes], after: dict[str, bytes]) -> None:
    """Check that each file of before is there, or is what it becomes; here, or moved aside."""
    now = contents(folder)
    for name, content in before.items():
        places = [name, name.replace(OUTDATED, f"{OUTDATING}/{OLDER}")]
        places += [name.replace("work/", f"work/{folder}/") for folder in (OUTDATED, OUTDATING)]
        kept = {now.get(place) for place in places}
        assert content in kept or after.get(name) in kept, name


class Killer:
    """Runs a scenario with kills and checks what is left, against an undisturbed run."""

    def __init__(self, scenario: Scenario, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._scenario, self._folder, self._patch = scenario, folder, monkeypatch
        self._number = 0
        place = self._fresh()
        self._before = contents(place)
        with killed_at(None, place) as watch:
            self._answer = scenario.run(place)
        self._after, self.num_operations = contents(place), watch.done

    def run(self, *kills: int) -> int:
        """Kill one process after another at these operations; return how many were killed."""
        place, killed = self._fresh(), 0
        for number in kills:
            self._patch.setattr(files, "_SWEPT", set())  # as in another process
            with killed_at(number, place) as watch:
                self._scenario.run(place)
            killed += watch.is_dead
            check_nothing_lost(place, self._before, self._after)
        self._patch.setattr(files, "_SWEPT", set())
        assert self._scenario.run(place) == self._answer
        assert contents(place) == self._after
        shutil.rmtree(place)
        return killed

    def _fresh(self) -> Path:
        self._number += 1
        place = self._folder / str(self._number)
        self._scenario.prepare(place)
        return place


def test_a_kill_at_any_operation_changes_nothing(
    scenarios: dict[str, Scenario], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killers = {}
    for name, scenario in scenarios.items():
        (tmp_path / name).mkdir()
        killers[name] = Killer(scenario, tmp_path / name, monkeypatch)
    singles = [(name, k) for name, x in killers.items() for k in range(x.num_operations)]
    rng = random.Random(0)
    killed = sum(killers[name].run(number) for name, number in singles)
    assert killed == len(singles) > 80
    while killed < NUM_KILLS:
        name = rng.choice(list(killers))
        most = killers[name].num_operations
        killed += killers[name].run(rng.randrange(most), rng.randrange(most))


def test_a_folder_that_is_read_while_results_move_is_whole(
    scenarios: dict[str, Scenario], tmp_path: Path
) -> None:
    """Killed while it moved results aside, and read by a process that does not write."""
    place = tmp_path / "read"
    for number in range(0, 40, 4):
        scenarios["changed"].prepare(place)
        with killed_at(number, place):
            scenarios["changed"].run(place)
        WorkFolder(place / "work", TEXT).read()
        names = {path.name for path in (place / "work").iterdir()}
        assert "outdating" not in names
        shutil.rmtree(place)
