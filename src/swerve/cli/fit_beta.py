"""The command that estimates beta: `swerve fit-beta`."""

from __future__ import annotations

import json
from pathlib import Path

from swerve.cli.options import (
    AS_BEFORE,
    AsJson,
    Choices,
    ProblemText,
    TasksFile,
    WorkPath,
    asked_tasks,
    open_work,
    read_files,
    say,
    tell,
)


def fit_beta(
    problem: ProblemText,
    /,
    *demonstrations: Path,
    tasks: TasksFile = None,
    how: Choices = AS_BEFORE,
    confidence: float = 0.95,
    work: WorkPath = None,
    as_json: AsJson = False,
) -> None:
    """Estimate beta, how strictly demonstrators follow the reward, by maximum likelihood.

    Give demonstrations in which no constraint but the known ones was in force. Learns and samples
    whatever the work folder does not hold yet, at the problem's own beta.

    Args:
      demonstrations: CSV or Parquet files with the states and the actions.
      confidence: Of the interval.
    """
    from swerve.fitting.beta import check_confidence
    from swerve.fitting.beta import fit_beta as fit
    from swerve.inference.ranking import Ranking
    from swerve.trust.doubts import data_warnings

    check_confidence(confidence)
    job = open_work(problem, work, how)
    found = read_files(job, demonstrations, tasks)
    if not found:
        raise ValueError("give at least one demonstration: beta is estimated from them")
    evidence = job.evidence(asked_tasks(job, found, tasks))
    for warning in data_warnings(Ranking.of(evidence, found)):
        say(f"warning: {warning}")
    fitted = fit(job.problem, evidence, found, confidence)
    tell(json.dumps(fitted.to_json()) if as_json else fitted)
