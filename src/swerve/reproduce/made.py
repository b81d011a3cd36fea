"""Demonstrations by optimal control, made once and kept in a folder."""

from __future__ import annotations

import shutil
from pathlib import Path

from swerve.demonstrations.demonstration import (
    Demonstration,
    read_demonstrations,
    write_demonstrations,
)
from swerve.demonstrators.optimal_control import SPARE, Search, first_optima
from swerve.problem.problem import Problem
from swerve.problem.tasks import draw_tasks
from swerve.reproduce.keeping import Keeping


def kept_optima(
    keeping: Keeping, name: str, problem: Problem, truth: int, num: int, search: Search
) -> list[Demonstration]:
    """Return demonstrations that avoid a hypothesis, between states too.

    Tasks that cannot be done without entering it are left out.

    Args:
      keeping: where the folder of the demonstrations is, made there, all or none, unless it exists.
      name: of that folder.
      problem: whose MDP draws the tasks.
      truth: index of the hypothesis.
      num: how many.
      search: what is looked for.

    Raises:
      NoPathError: if more than half of the tasks cannot be done.
      ValueError: if the folder holds another number of demonstrations.
    """
    folder = keeping.folder / name
    if not folder.exists():
        with keeping.clock.timing(f"{name}: demonstrations"):
            made = _optima(keeping, problem, truth, num, search)
        partial = folder.with_name(f"{name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        names = problem.mdp.action_names
        write_demonstrations(partial, made, problem.mdp.space, action_names=names)
        partial.replace(folder)
    found = read_folder(folder, problem)
    if len(found) != num:
        raise ValueError(f"{folder}: expected {num} demonstrations, found {len(found)}: remove it")
    return found


def _optima(
    keeping: Keeping, problem: Problem, truth: int, num: int, search: Search
) -> list[Demonstration]:
    """Return as many demonstrations as asked for, of the first tasks that can be done."""
    constraint, seed = problem.hypotheses.constraint(truth), keeping.seed
    tasks = draw_tasks(problem, SPARE * num, avoid=[constraint], seed=1_000 * seed + truth)
    how = {"seed": seed, "progress": keeping.progress}
    optima = first_optima(problem, constraint, tasks, num, search, **how)
    return [optimum.demonstration for optimum in optima]


def read_folder(folder: Path, problem: Problem, most: int | None = None) -> list[Demonstration]:
    """Return the demonstrations of a folder of demo_*.csv and tasks.csv.

    Args:
      folder: where they are.
      problem: what they are of.
      most: how many at most.

    Raises:
      OSError: if there are none, or no tasks.
      ValueError: if a file cannot be understood.
    """
    files = sorted(folder.glob("demo_*.csv"))[:most]
    if not files:
        raise FileNotFoundError(f"{folder}: expected demo_*.csv and tasks.csv, found none")
    return read_demonstrations(files, problem.mdp.space, tasks=folder / "tasks.csv")
