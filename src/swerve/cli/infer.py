"""The command that ranks hypotheses: `swerve infer`."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from swerve.cli.options import (
    AS_BEFORE,
    AS_USUAL,
    AsJson,
    Choices,
    Judging,
    ProblemText,
    Score,
    TasksFile,
    WorkPath,
    asked_tasks,
    check_judging,
    open_work,
    read_files,
    say,
    tell,
)
from swerve.cli.values import convert_limit

if TYPE_CHECKING:
    from swerve.answer import Inference
    from swerve.base.space import Task
    from swerve.evidence.evidence import Evidence
    from swerve.inference.greedy import Picks
    from swerve.work.work import Work


def infer(
    problem: ProblemText,
    /,
    *demonstrations: Path,
    tasks: TasksFile = None,
    how: Choices = AS_BEFORE,
    score: Score = "likelihood",
    judged: Judging = AS_USUAL,
    work: WorkPath = None,
    report: Path | None = None,
    no_resolve: bool = False,
    resolve_seconds: Annotated[float, Parameter(converter=convert_limit)] = 300.0,
    greedy: int | None = None,
    threshold: float | None = None,
    as_json: AsJson = False,
) -> None:
    """Rank the hypotheses of a problem by how well they explain demonstrations.

    Learns and samples whatever the work folder does not hold yet. Without demonstrations the
    ranking is the prior one: the hypothesis that unconstrained trajectories enter most often comes
    first.

    Args:
      demonstrations: CSV or Parquet files whose columns include the states' names.
      report: HTML page to write, with the picture, the ranking and the diagnostics.
      no_resolve: For a hypothesis that hardly any trajectory avoids, report a lower bound of the
        score, which is all that the samples tell. Without this option the score is worked out.
      resolve_seconds: Time after which no further score of this kind is worked out, in seconds; inf
        for no limit. The hypotheses that rank first come first, and what is left is named.
      greedy: Pick up to this many constraints as well, one by one, while one more is more probable
        than no more. Each explains most of what earlier picks leave unexplained.
      threshold: With --greedy, pick while a pick explains this many nats a demonstration or more.
    """
    from swerve.answer import infer as infer_constraints

    check_report(report)
    _check_seconds(resolve_seconds)
    _check_greedy(greedy, threshold, demonstrations)
    job = open_work(problem, work, how)
    check_judging(job.record, judged)
    found = read_files(job, demonstrations, tasks)
    asked = asked_tasks(job, found, tasks)
    evidence = _only(job.evidence(asked), None if found else asked)
    rank = partial(infer_constraints, demonstrations=found, score=score, **vars(judged))
    result = rank(evidence)
    result = _bounded(result) if no_resolve else rank(job.resolved(result, resolve_seconds))
    picks = None if greedy is None else _picks(job, result, greedy, threshold)
    _show(result, picks, report, as_json)


def check_report(report: Path | None) -> None:
    """Make sure, before the work, that the report can be written, if one is asked for."""
    from swerve.base.files import check_writable

    if report is None:
        return
    if report.is_dir():
        raise IsADirectoryError(f"--report {report} is a folder; name a file, such as report.html")
    if report.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"--report {report}: it is an HTML page; name a file such as report.html")
    check_writable(report.parent)


def _check_seconds(seconds: float) -> None:
    """Make sure, before the work, that there is time to resolve a hypothesis."""
    if not seconds > 0.0:
        raise ValueError(
            f"--resolve-seconds: expected a number > 0, got {seconds:g}: to work out nothing, give "
            "--no-resolve"
        )


def _check_greedy(
    most: int | None, threshold: float | None, demonstrations: tuple[Path, ...]
) -> None:
    """Make sure, before the work, that constraints can be picked, if they are asked for."""
    if most is None:
        if threshold is not None:
            raise ValueError("--threshold: it tells when --greedy ends: give --greedy as well")
        return
    from swerve.inference.greedy import checked_threshold

    checked_threshold(threshold)
    if most < 1:
        raise ValueError(f"--greedy: expected a number of picks >= 1, got {most}")
    if not demonstrations:
        raise ValueError("--greedy: constraints are picked from demonstrations: give at least one")


def _bounded(result: Inference) -> Inference:
    """Return the result as it is, and say which scores --no-resolve alone leaves open."""
    from swerve.base.phrases import some_names
    from swerve.base.solver_kinds import kind_stored
    from swerve.inference.unresolved import worth_resolving

    is_asked = result.demonstrations and result.score_name == "likelihood"
    if is_asked and kind_stored(result.evidence.solver).adapts:
        left = worth_resolving(result).tolist()
        names = some_names([f"{k} ({result.hypothesis_name(k)})" for k in left])
        if left:
            say(
                f"hardly any trajectory avoids {names}: --no-resolve leaves their scores as "
                "bounds; without it they are worked out"
            )
    return result


def _only(evidence: Evidence, tasks: Task | None) -> Evidence:
    """Return the part of evidence that is about these tasks; all of it for None."""
    from swerve.evidence.matching import match_each

    if tasks is None:
        return evidence
    names = ["the task"] * len(tasks.start)
    return evidence.select(
        sorted(set(match_each(evidence.problem, evidence.tasks, tasks, names).tolist()))
    )


def _picks(job: Work, result: Inference, most: int, threshold: float | None) -> Picks:
    """Return the constraints that greedy selection picks from a result."""
    from swerve.inference.greedy import greedy

    nominal: Any = job.nominal() if result.evidence.is_exact else None
    return greedy(result, nominal, threshold=threshold, most=most)


def _show(result: Inference, picks: Picks | None, report: Path | None, as_json: bool) -> None:
    """Print a result and write its report.

    Args:
      result: result of `swerve.infer`.
      picks: constraints that were picked; None if no picks were asked for.
      report: HTML file to write, or None.
      as_json: whether to print JSON.
    """
    from swerve.presentation import text_tables

    for warning in result.warnings:
        say(f"warning: {warning}")
    if as_json:
        picked = {} if picks is None else text_tables.picks_to_json(result, picks)
        print(json.dumps(result.to_json() | picked))
    else:
        tell(result.evidence.problem.summary)
        tell(result.headline)
        tell(result.belief)
        tell(result.table())
        if picks is not None:
            tell(text_tables.picks_table(result, picks))
        tell(result.verdicts())
    if report is not None:
        result.report(report, picks)
        say(f"report: {report}")
