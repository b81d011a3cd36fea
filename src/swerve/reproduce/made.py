"""Demonstrations by optimal control, made once and kept in a folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from swerve.constraints import Constraint
from swerve.demonstrations import Demonstration, read_demonstrations, write_demonstrations
from swerve.demonstrators.optimal_control import Settings, first_optima
from swerve.problem import Problem
from swerve.reproduce.clock import Clock
from swerve.tasks import draw_tasks


class Making(NamedTuple):
    """How demonstrations are made.

    Attributes:
      limits: of the actions, as for `optimal_control`.
      goal_tolerance: as for `optimal_control`.
      seed: of tasks and guesses.
      progress: whether to show a progress bar.
      clock: of what takes long.
    """

    limits: tuple[float, float] | None
    goal_tolerance: float
    seed: int
    progress: bool
    clock: Clock


def kept_optima(
    folder: Path, problem: Problem, truth: int, num: int, how: Making
) -> list[Demonstration]:
    """Return demonstrations that avoid a hypothesis, between states too.

    Tasks that cannot be done without entering it are left out.

    Args:
      folder: where they are kept; made there, all or none, unless it exists.
      problem: whose MDP draws the tasks.
      truth: index of the hypothesis.
      num: how many.
      how: they are made.

    Raises:
      NoPathError: if more than half of the tasks cannot be done.
      ValueError: if the folder holds another number of demonstrations.
    """
    if not folder.exists():
        with how.clock.timing(f"{folder.name}: demonstrations"):
            made = _optima(problem, problem.hypotheses.constraint(truth), truth, num, how)
        partial = folder.with_name(f"{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        names = problem.mdp.action_names
        write_demonstrations(partial, made, problem.mdp.space, action_names=names)
        partial.replace(folder)
    found = read_folder(folder, problem)
    if len(found) != num:
        raise ValueError(f"{folder}: expected {num} demonstrations, found {len(found)}: remove it")
    return found


def _optima(
    problem: Problem, constraint: Constraint, truth: int, num: int, how: Making
) -> list[Demonstration]:
    """Return as many demonstrations as asked for, of the first tasks that can be done."""
    tasks = draw_tasks(problem, 2 * num, avoid=[constraint], seed=1_000 * how.seed + truth)
    names = [f"demo_{k:03d}" for k in range(2 * num)]
    settings = Settings(limits=how.limits, goal_tolerance=how.goal_tolerance)
    found = first_optima(problem, constraint, tasks, num, names, settings, how.seed, how.progress)
    return [optimum.demonstration for optimum in found]


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
