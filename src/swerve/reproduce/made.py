"""Demonstrations by optimal control, made once and kept in a folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from swerve.constraints import Constraint
from swerve.demonstrations import Demonstration, read_demonstrations, write_demonstrations
from swerve.demonstrators.optimal_control import NoPathError, optimal_control
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.reproduce.clock import Clock
from swerve.space import Task
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
    """
    if not folder.exists():
        with how.clock.timing(f"{folder.name}: demonstrations"):
            made = _optima(problem, problem.hypotheses.constraint(truth), truth, num, how)
        partial = folder.with_name(f"{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        names = problem.mdp.action_names
        write_demonstrations(partial, made, problem.mdp.space, action_names=names)
        partial.replace(folder)
    return read_folder(folder, problem)


def _optima(
    problem: Problem, constraint: Constraint, truth: int, num: int, how: Making
) -> list[Demonstration]:
    """Return as many demonstrations as asked for, of the first tasks that can be done."""
    tasks = draw_tasks(problem, 2 * num, avoid=[constraint], seed=1_000 * how.seed + truth)
    made: list[Demonstration] = []
    with progress_bar("demonstrating", num, how.progress) as advance:
        for k, task in enumerate(zip(*tasks, strict=True)):
            try:
                (optimum,) = optimal_control(
                    problem,
                    constraint,
                    Task(*task),
                    names=[f"demo_{k:03d}"],
                    limits=how.limits,
                    goal_tolerance=how.goal_tolerance,
                    seed=how.seed,
                )
            except NoPathError:
                if k - len(made) >= num:
                    raise
                continue
            made.append(optimum.demonstration)
            advance(1)
            if len(made) == num:
                break
    return made


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
