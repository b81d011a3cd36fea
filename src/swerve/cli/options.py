"""Options that several commands share, and ways to open the problem, files and tasks they name."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from swerve.base.phrases import shown_lines
from swerve.base.solver_kinds import solver_names

if TYPE_CHECKING:
    from swerve.base.space import Task
    from swerve.problem.record import ProblemRecord
    from swerve.work.work import Work

# names of solvers that are sampled by importance unless another method is asked for
BY_IMPORTANCE = ", ".join(solver_names(lambda kind: kind.default_method == "importance"))
ProblemText = Annotated[
    str,
    Parameter(
        help="A shipped problem with its parameters, such as 'pendulum?max_torque=10', or "
        "path/to/file.py:name, or package.module:name."
    ),
]
TasksFile = Annotated[
    Path | None,
    Parameter(help="CSV or Parquet file with columns demo, start_STATE..., goal_STATE..."),
]
WORK_HELP = "Folder that keeps what was learned and sampled for the next call."
WorkPath = Annotated[Path | None, Parameter(help=WORK_HELP)]
NamedWork = Annotated[Path, Parameter(help=WORK_HELP)]  # where a folder must be named
SolverName = Annotated[
    str | None,
    Parameter(
        help=f"One of {', '.join(solver_names())}, with settings as in 'ppo?num_steps=2e7'. "
        "[default: what the work folder holds, else tabular where states are finitely many, grid "
        "for up to 3 states, else soft-value]"
    ),
]
NumSamples = Annotated[
    int | None,
    Parameter(
        help="Trajectories for each task, for solvers that are sampled; smc rounds it up to a "
        "multiple of 20. [default: 10000]"
    ),
]
Method = Annotated[
    str | None,
    Parameter(
        help="smc, importance or plain, for solvers that are sampled. "
        f"[default: smc, but importance for {BY_IMPORTANCE}]"
    ),
]
Seed = Annotated[int | None, Parameter(help="Seed of everything random. [default: 0]")]
Score = Annotated[
    Literal["likelihood", "average"],
    Parameter(help="likelihood, or average: the paper's average violation probability."),
]
AsJson = Annotated[bool, Parameter(name="--json", help="Print one JSON object.")]


@Parameter(name="*")
@dataclass(frozen=True)
class Choices:
    """Options of how to learn and sample, of every command that may do so."""

    solver: SolverName = None
    samples: NumSamples = None
    method: Method = None
    seed: Seed = None


@Parameter(name="*")
@dataclass(frozen=True)
class Judging:
    """Options of how demonstrations are judged: arguments of `swerve.infer` and of a monitor."""

    prior: Annotated[
        float,
        Parameter(
            name="--prior-none",
            help="Probability of no constraint before any demonstration; the hypotheses share the "
            "rest.",
        ),
    ] = 0.5
    tolerance: Annotated[
        float, Parameter(help="Probability with which a demonstration ignores the constraint.")
    ] = 0.0
    margin: Annotated[
        dict[str, float] | None,
        Parameter(
            help="How deep inside a hypothesis a demonstration must be to have entered it, for "
            "states measured with noise: --margin.x 0.05, in the state's unit.",
            negative=(),
        ),
    ] = None
    clearance: Annotated[
        float | None,
        Parameter(
            help="Leave a hypothesis out for tasks that start or end within this distance of it."
        ),
    ] = None


AS_USUAL = Judging()
AS_BEFORE = Choices()  # no option given: values of the work folder's record, else the defaults


def open_work(problem: str, folder: Path | None, how: Choices = AS_BEFORE) -> Work:
    """Return the work on a problem, in a folder unless `folder` is None."""
    from swerve.work.settings import Settings
    from swerve.work.work import Work

    settings = Settings(how.solver, how.seed, how.method, how.samples)
    return Work(problem, folder, settings, say=say, progress=True)


def check_judging(record: ProblemRecord, judged: Judging) -> None:
    """Make sure, before the work, that demonstrations can be judged by these options.

    Raises:
      ValueError: if an option is of the wrong kind or range, or a hypothesis does not allow it.
    """
    import numpy as np

    from swerve.base.space import Task
    from swerve.inference import likelihood, posterior

    hypotheses, space = record.hypotheses, record.space
    likelihood.checked_tolerance(judged.tolerance)
    posterior.checked_prior(judged.prior, len(hypotheses))
    left = hypotheses if judged.margin is None else hypotheses.eroded(judged.margin, space)
    nobody = Task(np.zeros((0, len(space.names))), np.zeros((0, len(record.goal_names))))
    likelihood.is_counted(record, nobody, judged.clearance, left)


def read_files(job: Work, paths: tuple[Path, ...], tasks: Path | None) -> list[Any]:
    """Read demonstration files, with the states, actions and goals of the problem."""
    from swerve.demonstrations.demonstration import read_demonstrations

    if not paths:
        return []
    record = job.record
    return read_demonstrations(
        paths,
        record.space,
        tasks=tasks,
        goal_names=record.goal_names,
        action_names=record.action_names,
        goal_of=job.goal_of if tasks is None else None,
    )


def asked_tasks(job: Work, demonstrations: list[Any], tasks: Path | None) -> Task | None:
    """Return the tasks of the demonstrations if there are any, else of the file, else None."""
    from swerve.base.space import Task
    from swerve.demonstrations.demonstration import read_tasks

    if demonstrations:
        return Task.stack([demonstration.task for demonstration in demonstrations])
    if tasks is None:
        return None
    return Task.stack(list(read_tasks(tasks, job.record.space, job.record.goal_names).values()))


def say(text: str) -> None:
    """Print text to stderr; results alone go to stdout."""
    if sys.stderr is None:  # closed, as by 2>&-: `print` would take stdout
        return
    with contextlib.suppress(OSError, ValueError):  # a log that is full or closed stops no work
        print(shown_lines(text), file=sys.stderr, flush=True)


def tell(result: object) -> None:
    """Print a result to stdout, as text without control characters: its names are of others."""
    print(shown_lines(str(result)))
