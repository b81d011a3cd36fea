"""The command that makes demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import swerve
from swerve.cli.options import Problem, Tasks, open_work, say

NUM = 10  # demonstrations, unless told otherwise

if TYPE_CHECKING:
    from swerve.base.space import Task
    from swerve.constraints.base import Constraint
    from swerve.demonstrations.demonstration import Demonstration
    from swerve.demonstrators.optimal_control import Optimum


def demonstrate(
    problem: Problem,
    /,
    *,
    constraint: int,
    out: Path,
    num: int | None = None,
    tasks: Tasks = None,
    by: Literal["boltzmann", "optimal-control"] = "boltzmann",
    solver: str | None = None,
    max_action: float | None = None,
    num_steps: int | None = None,
    goal_tolerance: float | None = None,
    seed: int = 0,
) -> None:
    """Make demonstrations that obey one of the hypotheses.

    Args:
      constraint: Index of the hypothesis to obey.
      out: Folder to write demo_000.csv, demo_001.csv, ... and tasks.csv into.
      num: How many, of tasks drawn from the MDP. [default: 10, or one for each of --tasks]
      by: boltzmann draws from pi_c, what the model holds a demonstrator to do; optimal-control
        takes the best path, of any actions rather than those of the MDP, that keeps out, and needs
        the extra 'control' (CasADi, IPOPT).
      solver: Of boltzmann: grid, tabular or soft-value, with settings as in 'grid?num_points=81'.
        [default: tabular if the MDP is, else grid]
      max_action: Of optimal-control: largest action in either direction, inf for any.
        [default: the range of the MDP's actions]
      num_steps: Of optimal-control: steps to the last state. [default: the horizon of the MDP]
      goal_tolerance: Of optimal-control: how far from its goal one may end. [default: 0.05]
    """
    from swerve.base.store import check_writable
    from swerve.demonstrations.demonstration import new_files, read_tasks, write_demonstrations

    if tasks is not None and num is not None:
        raise ValueError("give --num or --tasks, not both: there is one demonstration a task")
    if num is not None and num < 1:
        raise ValueError(f"--num: expected at least 1, got {num}")
    sought = {"limits": _limits(max_action), "num_steps": num_steps}
    sought |= {} if goal_tolerance is None else {"goal_tolerance": goal_tolerance}
    if by == "boltzmann" and any(value is not None for value in sought.values()):
        raise ValueError(
            "--max-action, --num-steps and --goal-tolerance are for --by optimal-control: leave "
            "them out"
        )
    if by == "optimal-control" and solver is not None:
        raise ValueError("--solver is for --by boltzmann: leave one of them out")
    check_writable(out)
    job = open_work(problem, None)
    record, forbidden = job.record, job.record.hypotheses.constraint(constraint)
    given = None if tasks is None else read_tasks(tasks, record.space, record.goal_names)
    names = [f"demo_{k:03d}" for k in range(num or NUM)]
    if given is not None:
        names = [f"demo_{row.removeprefix('demo_')}" for row in given]
    new_files(out, names)  # before the work
    batch = None if given is None else swerve.Task.stack(list(given.values()))
    if by == "boltzmann":
        made = _drawn(job.problem, forbidden, batch, names, solver, seed)
    else:
        made = _optimal(job.problem, forbidden, batch, names, sought, seed)
    write_demonstrations(
        out, made, record.space, action_names=record.action_names, goal_names=record.goal_names
    )
    say(f"wrote {len(made)} demonstrations that avoid {forbidden.name} to {out}")


def _drawn(
    problem: swerve.Problem,
    forbidden: Constraint,
    tasks: Task | None,
    names: list[str],
    solver: str | None,
    seed: int,
) -> list[Demonstration]:
    """Return demonstrations drawn from pi_c, of these tasks or of some that the MDP draws."""
    from swerve.problem.tasks import draw_tasks

    if tasks is None:
        tasks = draw_tasks(problem, len(names), avoid=[forbidden], seed=seed)
    settings = {"names": names, "solver": solver, "seed": seed, "progress": True}
    return swerve.demonstrate(problem, forbidden, tasks, **settings)


def _optimal(
    problem: swerve.Problem,
    forbidden: Constraint,
    tasks: Task | None,
    names: list[str],
    sought: dict[str, Any],
    seed: int,
) -> list[Demonstration]:
    """Return demonstrations by optimal control, and print what was found."""
    from swerve.demonstrators.optimal_control import SPARE, Search, first_optima, optimal_control
    from swerve.problem.tasks import draw_tasks

    how = {"seed": seed, "progress": True}
    if tasks is None:
        num = len(names)
        drawn = draw_tasks(problem, SPARE * num, avoid=[forbidden], seed=seed)
        optima = first_optima(problem, forbidden, drawn, num, Search(**sought), **how)
    else:
        optima = optimal_control(problem, forbidden, tasks, names=names, **sought, **how)
    _say_of_optima(optima)
    return [optimum.demonstration for optimum in optima]


def _limits(max_action: float | None) -> tuple[float, float] | None:
    if max_action is None:
        return None
    if not max_action > 0.0:
        raise ValueError(f"--max-action: expected a number > 0, got {max_action}")
    return (-max_action, max_action)


def _say_of_optima(optima: Sequence[Optimum]) -> None:
    """Print what was found for each demonstration: local optima, the best taken."""
    print(f"{'demonstration':<16} {'reward':>10} {'next best':>10} {'local optima':>13}")
    for optimum in optima:
        runner_up = f"{optimum.rewards[1]:.4g}" if len(optimum.rewards) > 1 else "-"
        print(
            f"{optimum.demonstration.name:<16} {optimum.reward:>10.4g} {runner_up:>10} "
            f"{len(optimum.rewards):>13}"
        )
