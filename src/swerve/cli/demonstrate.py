"""The command that makes demonstrations: `swerve demonstrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from swerve.cli.options import ProblemText, TasksFile, open_work, say, tell
from swerve.cli.values import convert_limit

if TYPE_CHECKING:
    from swerve.base.space import Task
    from swerve.constraints.base import Constraint
    from swerve.demonstrations.demonstration import Demonstration
    from swerve.demonstrators.optimal_control import Optimum
    from swerve.problem.problem import Problem

NUM = 10  # demonstrations, unless --num or --tasks say otherwise
MOST = 100_000  # demonstrations, a file each


@Parameter(name="*")
@dataclass(frozen=True)
class ControlOptions:
    """Options of demonstrations by optimal control alone."""

    max_action: Annotated[
        float | None,
        Parameter(
            help="Of optimal-control: largest action in either direction, inf for any. [default: "
            "the range of the MDP's actions]",
            converter=convert_limit,
        ),
    ] = None
    num_steps: Annotated[
        int | None,
        Parameter(
            help="Of optimal-control: steps to the last state. [default: the horizon of the MDP]"
        ),
    ] = None
    goal_tolerance: Annotated[
        float | None,
        Parameter(
            help="Of optimal-control: how far from the goal a demonstration may end. [default: "
            "0.05]"
        ),
    ] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `swerve.optimal_control` that these options ask for."""
        from swerve.base.arguments import positive_number, whole_number

        if self.max_action is not None and not self.max_action > 0.0:
            raise ValueError(f"--max-action: expected a number > 0, got {self.max_action}")
        if self.num_steps is not None:
            whole_number(self.num_steps, "--num-steps", 1)
        if self.goal_tolerance is not None:
            positive_number(self.goal_tolerance, "--goal-tolerance")
        limits = None if self.max_action is None else (-self.max_action, self.max_action)
        found = {
            "limits": limits,
            "num_steps": self.num_steps,
            "goal_tolerance": self.goal_tolerance,
        }
        return {name: value for name, value in found.items() if value is not None}


NO_OPTIONS = ControlOptions()


def demonstrate(
    problem: ProblemText,
    /,
    *,
    constraint: int,
    out: Path,
    num: int | None = None,
    tasks: TasksFile = None,
    by: Literal["boltzmann", "optimal-control"] = "boltzmann",
    solver: str | None = None,
    control: ControlOptions = NO_OPTIONS,
    seed: int = 0,
) -> None:
    """Make demonstrations that obey one of the hypotheses.

    Args:
      constraint: Index of the hypothesis to obey.
      out: Folder to write demo_000.csv, demo_001.csv, ... and tasks.csv into.
      num: How many, of tasks sampled from the MDP. [default: 10, or one for each of --tasks]
      by: boltzmann samples pi_c, the distribution that the model expects of demonstrators.
        optimal-control takes the best path that avoids the constraint, by any actions, not only
        the MDP's own; it needs the extra 'control' (CasADi, IPOPT).
      solver: Of boltzmann: grid, tabular or soft-value, with settings as in 'grid?num_points=81'.
        [default: tabular if the MDP is, else grid]
    """
    from swerve.base.arguments import seed_number
    from swerve.base.files import check_writable
    from swerve.base.space import Task
    from swerve.demonstrations.demonstration import new_files, read_tasks, write_demonstrations

    sought, seed = control.arguments(), seed_number(seed, "--seed")
    _check_choices(num, tasks, by, solver, sought)
    job = open_work(problem, None)
    record, forbidden = job.record, job.record.hypotheses.constraint(constraint)
    check_writable(out if out.exists() else out.parent)
    given = None if tasks is None else read_tasks(tasks, record.space, record.goal_names)
    names = [f"demo_{k:03d}" for k in range(num or NUM)]
    if given is not None:
        names = [f"demo_{row.removeprefix('demo_')}" for row in given]
    new_files(out, names)  # before the work
    batch = None if given is None else Task.stack(list(given.values()))
    if by == "boltzmann":
        made = _boltzmann(job.problem, forbidden, batch, names, solver, seed)
    else:
        made = _optimal(job.problem, forbidden, batch, names, sought, seed)
    columns = {"action_names": record.action_names, "goal_names": record.goal_names}
    write_demonstrations(out, made, record.space, **columns)
    say(f"wrote {len(made)} demonstrations that avoid {forbidden.name} to {out}")


def _check_choices(
    num: int | None, tasks: Path | None, by: str, solver: str | None, sought: dict[str, Any]
) -> None:
    """Raise ValueError if options do not go together, or are out of range."""
    from swerve.base.arguments import whole_number
    from swerve.base.solver_kinds import check_solver_name

    if tasks is not None and num is not None:
        raise ValueError("give --num or --tasks, not both: there is one demonstration a task")
    if num is not None:
        whole_number(num, "--num", 1, MOST)
    if by == "boltzmann" and sought:
        raise ValueError(
            "--max-action, --num-steps and --goal-tolerance are for --by optimal-control: leave "
            "them out"
        )
    if by == "optimal-control" and solver is not None:
        raise ValueError("--solver is for --by boltzmann: leave one of them out")
    if solver is not None:
        check_solver_name(solver.partition("?")[0])


def _boltzmann(
    problem: Problem,
    forbidden: Constraint,
    tasks: Task | None,
    names: list[str],
    solver: str | None,
    seed: int,
) -> list[Demonstration]:
    """Return demonstrations sampled from pi_c.

    Args:
      problem: the problem.
      forbidden: the constraint c.
      tasks: one for each name; None samples tasks from the MDP.
      names: names of the demonstrations.
      solver: specification of the solver that learns pi_c, or None for the default.
      seed: seed of the tasks and of the demonstrations.
    """
    from swerve.demonstrators.boltzmann import demonstrate as sample_demonstrations
    from swerve.problem.tasks import draw_tasks

    if tasks is None:
        tasks = draw_tasks(problem, len(names), avoid=[forbidden], seed=seed)
    settings = {"names": names, "solver": solver, "seed": seed, "progress": True}
    return sample_demonstrations(problem, forbidden, tasks, **settings)


def _optimal(
    problem: Problem,
    forbidden: Constraint,
    tasks: Task | None,
    names: list[str],
    sought: dict[str, Any],
    seed: int,
) -> list[Demonstration]:
    """Return demonstrations by optimal control, and print the optima that were found.

    Args:
      problem: the problem.
      forbidden: the constraint to avoid.
      tasks: one for each name; None samples tasks from the MDP.
      names: names of the demonstrations.
      sought: arguments of `swerve.optimal_control`.
      seed: seed of the tasks and of the guesses.
    """
    from swerve.demonstrators.optimal_control import SPARE, first_optima, optimal_control
    from swerve.demonstrators.path_search import Search
    from swerve.problem.tasks import draw_tasks

    how = {"seed": seed, "progress": True}
    if tasks is None:
        num = len(names)
        candidates = draw_tasks(problem, SPARE * num, avoid=[forbidden], seed=seed)
        optima = first_optima(problem, forbidden, candidates, num, Search(**sought), **how)
    else:
        optima = optimal_control(problem, forbidden, tasks, names=names, **sought, **how)
    _print_optima(optima)
    return [optimum.demonstration for optimum in optima]


def _print_optima(optima: Sequence[Optimum]) -> None:
    """Print for each demonstration the best rewards and how many local optima were found."""
    tell(f"{'demonstration':<16} {'reward':>10} {'next best':>10} {'local optima':>13}")
    for optimum in optima:
        runner_up = f"{optimum.rewards[1]:.4g}" if len(optimum.rewards) > 1 else "-"
        tell(
            f"{optimum.demonstration.name:<16} {optimum.reward:>10.4g} {runner_up:>10} "
            f"{len(optimum.rewards):>13}"
        )
