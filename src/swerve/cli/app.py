"""The `swerve` command: a thin layer over the library.

Everything heavy is imported inside the command that needs it, so that `swerve infer` on a work
folder that holds the answer starts at once.
"""

from __future__ import annotations

import io
import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cyclopts
from cyclopts import Parameter

import swerve
from swerve.cli import demonstrate as cli_making
from swerve.cli import reproduce as cli_reproduce
from swerve.cli.options import (
    AS_BEFORE,
    AS_USUAL,
    AsJson,
    Choices,
    Judging,
    Problem,
    Score,
    Seed,
    SolverName,
    Tasks,
    WorkFolder,
    asked_tasks,
    check_judging,
    open_work,
    read_files,
    say,
)

if TYPE_CHECKING:
    import numpy as np

    from swerve.base.space import Task
    from swerve.evidence.evidence import Evidence
    from swerve.inference.greedy import Pick
    from swerve.inference.ranking import Inference
    from swerve.work.work import Work

app = cyclopts.App(
    name="swerve",
    help="Infer which constraint a demonstrator is obeying.",
    version=swerve.__version__,
    default_parameter=Parameter(negative=()),
    suppress_keyboard_interrupt=False,
)


@app.command
def infer(
    problem: Problem,
    /,
    *demonstrations: Path,
    tasks: Tasks = None,
    how: Choices = AS_BEFORE,
    score: Score = "likelihood",
    judged: Judging = AS_USUAL,
    work: WorkFolder = None,
    report: Path | None = None,
    no_resolve: bool = False,
    greedy: int | None = None,
    as_json: AsJson = False,
) -> None:
    """Rank the hypotheses of a problem by how well they explain demonstrations.

    Learns and samples whatever the work folder does not hold yet. Without demonstrations the
    ranking is the prior one: what unconstrained trajectories enter most often comes first.

    Args:
      demonstrations: CSV or Parquet files whose columns include the states' names.
      report: HTML page to write, with the picture, the ranking and the diagnostics.
      no_resolve: Leave the score of what next to no trajectory avoids at what the samples tell, a
        lower bound, instead of working out what avoiding it takes, which may need minutes.
      greedy: Pick up to this many constraints as well, one after another, each for what those
        before it leave to be explained.
    """
    from swerve.inference.ranking import infer as infer_constraints

    if report is not None:
        _check_report(report)
    if greedy is not None:
        _check_greedy(greedy, demonstrations)
    job = open_work(problem, work, how)
    check_judging(job.record, judged)
    found = read_files(job, demonstrations, tasks)
    asked = asked_tasks(job, found, tasks)
    evidence = job.evidence(asked)
    if not found and asked is not None:
        evidence = _only(evidence, asked)
    rank = partial(infer_constraints, demonstrations=found, score=score, **vars(judged))
    result = rank(evidence)
    if not no_resolve:
        result = rank(job.resolved(result))
    picks = None if greedy is None else _picks(job, result, greedy)
    _show(result, picks, greedy, report, as_json)


@app.command
def fit_beta(
    problem: Problem,
    /,
    *demonstrations: Path,
    tasks: Tasks = None,
    how: Choices = AS_BEFORE,
    confidence: float = 0.95,
    work: WorkFolder = None,
    as_json: AsJson = False,
) -> None:
    """Estimate beta, how strictly demonstrators follow the reward, by maximum likelihood.

    The demonstrations must be ones that no constraint but the known ones held back. Learns and
    samples whatever the work folder does not hold yet, at the problem's own beta.

    Args:
      demonstrations: CSV or Parquet files with the states and the actions.
      confidence: Of the interval.
    """
    from swerve.trust.doubts import data_warnings

    job = open_work(problem, work, how)
    found = read_files(job, demonstrations, tasks)
    if not found:
        raise ValueError("give at least one demonstration: beta is estimated from them")
    evidence = job.evidence(asked_tasks(job, found, tasks))
    for warning in data_warnings(swerve.infer(evidence, found)):
        say(f"warning: {warning}")
    fit = swerve.fit_beta(job.problem, evidence, found, confidence)
    print(json.dumps(fit.to_json()) if as_json else fit)


@app.command
def watch(
    problem: Problem,
    /,
    *,
    work: Path,
    tasks: Tasks = None,
    how: Choices = AS_BEFORE,
    judged: Judging = AS_USUAL,
) -> None:
    """Watch demonstrations state by state: JSON lines in, JSON lines out.

    A line in is an object such as {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "a"}, or an array
    of the states; {"end": true, "id": "a"} ends a demonstration. Learns whatever the work folder
    does not hold yet first.

    Args:
      tasks: CSV or Parquet file; a demonstration's id names its row, unless there is only one.
        [default: the task that the work folder holds, if it is only one]
    """
    from swerve.base.space import Task
    from swerve.cli.watch import Watch, foresight_of
    from swerve.cli.watch import watch as answer_lines
    from swerve.demonstrations.demonstration import read_tasks
    from swerve.monitoring.monitor import check_hypotheses

    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")  # so that broken bytes are answered, as a bad line
    job = open_work(problem, work, how)
    check_hypotheses(job.record)
    check_judging(job.record, judged)
    asked = asked_tasks(job, [], tasks)
    evidence = job.evidence(asked)
    if tasks is not None:
        named = read_tasks(tasks, job.record.space, job.record.goal_names)
    else:
        rows = zip(*evidence.tasks, strict=True)
        named = {str(k): Task(*row) for k, row in enumerate(rows)}
    watched = Watch(evidence, foresight_of(job, evidence), named, **vars(judged))
    say("watching: one state a line")
    answer_lines(sys.stdin, watched.answer, sys.stdout)


@app.command
def learn(
    problem: Problem,
    /,
    *,
    work: Path,
    solver: SolverName = None,
    seed: Seed = None,
) -> None:
    """Learn the nominal distribution of a problem into a work folder.

    Training that is interrupted goes on where it stopped when the same command is given again.
    A picture of how it went is written beside what was learned.
    """
    job = open_work(problem, work, Choices(solver=solver, seed=seed))
    nominal = job.nominal()
    say(f"learned with {nominal.solver!r}; next: swerve sample or swerve infer, --work {work}")


@app.command
def sample(
    problem: Problem,
    /,
    *,
    work: Path,
    tasks: Tasks = None,
    how: Choices = AS_BEFORE,
    as_json: AsJson = False,
) -> None:
    """Sample the nominal distribution for tasks, so that inference is instant afterwards."""
    from swerve.inference.ranking import infer as prior
    from swerve.presentation import sentences as wording
    from swerve.trust.doubts import data_warnings

    job = open_work(problem, work, how)
    evidence = job.evidence(asked_tasks(job, [], tasks))
    inference = prior(evidence)
    rows = inference.to_json()["diagnostics"]
    if as_json:
        print(json.dumps({"num_trajectories": evidence.num_trajectories, "tasks": rows}))
        return
    print(f"{wording.counted(evidence.num_tasks, 'task')}, {wording.samples(evidence)}")
    print(
        f"{'task':>4}  {'ESS':>8}  {'KL [nats]':>9}  {'log Z_0':>9}  {'spread':>6}  start -> goal"
    )
    for k, row in enumerate(rows):
        print(
            f"{k:>4}  {row['effective_sample_size']:>8.0f}  {row['kl']:>9.3f}  "
            f"{row['log_partition']:>9.3f}  {row['island_spread']:>6.3f}  "
            f"{_numbers(row['start'])} -> {_numbers(row['goal'])}"
        )
    for warning in data_warnings(inference):
        say(f"warning: {warning}")


@app.command
def demo(*, work: WorkFolder = None, report: Path = Path("swerve-demo.html")) -> None:
    """Show what Swerve does: bundled demonstrations, minutes of work, a report at the end.

    A pendulum is swung to its goals as if nothing were in the way, except that there is: find out
    where. The demonstrations were made by `swerve demonstrate`.
    """
    from swerve.cli.demo import FOLDER, PROBLEM

    files = sorted(FOLDER.glob("demo_*.csv"))
    say(f"{len(files)} demonstrations of {PROBLEM} in {FOLDER}")
    infer(PROBLEM, *files, tasks=FOLDER / "tasks.csv", work=work, report=report)


for command in (cli_making.demonstrate, cli_reproduce.reproduce):
    app.command(command)


def main() -> None:
    """Run the command; errors become one line and an exit status."""
    try:
        app(sys.argv[1:])
    except KeyboardInterrupt:
        kept = any(word.partition("=")[0] == "--work" for word in sys.argv)
        say("interrupted" + ("; the same command goes on from what --work holds" if kept else ""))
        os._exit(130)  # an ordinary exit crashes where JAX is compiling; every file is complete
    except BrokenPipeError:  # whoever read the output, such as head, has seen enough
        sys.stdout = None
    except (ValueError, OSError, ImportError) as error:
        say(f"swerve: error: {error}")
        sys.exit(1)


def _check_report(report: Path) -> None:
    """Make sure that the report can be written before the work that it is about."""
    from swerve.base.store import check_writable

    if report.is_dir():
        raise IsADirectoryError(f"--report {report} is a folder; name a file, such as report.html")
    if report.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"--report {report}: it is an HTML page; name a file such as report.html")
    check_writable(report.parent)


def _only(evidence: Evidence, tasks: Task) -> Evidence:
    """Return the part of evidence that is about these tasks."""
    indices = {evidence.match(type(tasks)(*task)) for task in zip(*tasks, strict=True)}
    return evidence.select(sorted(indices))


def _check_greedy(most: int, demonstrations: tuple[Path, ...]) -> None:
    """Make sure that there is something to pick from before the work."""
    if most < 1:
        raise ValueError(f"--greedy: expected a number of picks >= 1, got {most}")
    if not demonstrations:
        raise ValueError("--greedy: constraints are picked from demonstrations: give at least one")


def _picks(job: Work, result: Inference, most: int) -> list[Pick]:
    """Return what greedy selection picks from a result."""
    from swerve.inference.greedy import greedy

    nominal: Any = job.nominal() if result.evidence.is_exact else None
    return greedy(result, nominal, most=most)


def _show(
    result: Inference,
    picks: list[Pick] | None,
    most: int | None,
    report: Path | None,
    as_json: bool,
) -> None:
    """Print a result and what was picked, at most so many; write its report if one is asked for."""
    from swerve.presentation import text_tables as listing

    for warning in result.warnings:
        say(f"warning: {warning}")
    if as_json:
        picked = {} if picks is None else {"greedy": listing.picks_to_json(result, picks)}
        print(json.dumps(result.to_json() | picked))
    else:
        print(result.evidence.problem.summary)
        print(result.headline)
        print(result.belief)
        print(result.table())
        if picks is not None and most is not None:
            print(listing.picks_table(result, picks, most))
        print(result.verdicts())
    if report is not None:
        result.report(report, picks)
        say(f"report: {report}")


def _numbers(values: np.ndarray | list[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
