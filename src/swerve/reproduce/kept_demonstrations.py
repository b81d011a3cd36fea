"""Folders of demonstrations: made by optimal control and kept, or read."""

from __future__ import annotations

from pathlib import Path

from swerve.base import files
from swerve.base.interrupts import saving
from swerve.demonstrations.demonstration import (
    Demonstration,
    read_demonstrations,
    write_demonstrations,
)
from swerve.demonstrators.optimal_control import SPARE, first_optima
from swerve.demonstrators.path_search import Search
from swerve.problem.problem import Problem
from swerve.problem.tasks import draw_tasks
from swerve.reproduce.keeping import Keeping


def kept_optima(
    keeping: Keeping, name: str, problem: Problem, truth: int, num: int, settings: Search
) -> list[Demonstration]:
    """Return demonstrations that avoid a hypothesis, between states too.

    Tasks that cannot be done without entering the hypothesis are left out. Where the folder exists,
    the demonstrations are read from it; otherwise they are made and written, all or none.

    Args:
      keeping: parent folder and settings.
      name: name of the folder of the demonstrations.
      problem: the problem; its MDP samples the tasks.
      truth: index of the hypothesis.
      num: number of demonstrations.
      settings: settings of the search.

    Raises:
      NoPathError: if more than half of the tasks cannot be done.
      ValueError: if the folder holds another number of demonstrations.
    """
    folder = keeping.folder / name
    if not folder.exists():
        files.check_link(folder)  # before the work
        with keeping.clock.timing(f"{name}: demonstrations"):
            made = _optima(keeping, problem, truth, num, settings)
        names = problem.mdp.action_names
        with saving(), files.whole_folder(folder) as partial:
            write_demonstrations(partial, made, problem.mdp.space, action_names=names)
    found = read_folder(folder, problem)
    if len(found) != num:
        raise ValueError(f"{folder}: expected {num} demonstrations, found {len(found)}: remove it")
    return found


def _optima(
    keeping: Keeping, problem: Problem, truth: int, num: int, settings: Search
) -> list[Demonstration]:
    """Return `num` demonstrations, of the first tasks that can be done."""
    constraint, seed = problem.hypotheses.constraint(truth), keeping.seed
    tasks = draw_tasks(problem, SPARE * num, avoid=[constraint], seed=1_000 * seed + truth)
    how = {"seed": seed, "progress": keeping.progress}
    optima = first_optima(problem, constraint, tasks, num, settings, **how)
    return [optimum.demonstration for optimum in optima]


def read_folder(folder: Path, problem: Problem, most: int | None = None) -> list[Demonstration]:
    """Return the demonstrations of a folder of demo_*.csv and tasks.csv.

    Args:
      folder: the folder.
      problem: the problem of the demonstrations.
      most: largest number of demonstrations to read; None for all.

    Raises:
      OSError: if there is no demonstration, or no tasks.csv.
      ValueError: if a file cannot be understood.
    """
    paths = sorted(folder.glob("demo_*.csv"))[:most]
    if not paths:
        raise FileNotFoundError(f"{folder}: expected demo_*.csv and tasks.csv, found none")
    return read_demonstrations(paths, problem.mdp.space, tasks=folder / "tasks.csv")
