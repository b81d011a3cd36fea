"""The command that watches demonstrations while they happen: `swerve watch`."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from swerve.cli.options import (
    AS_BEFORE,
    AS_USUAL,
    Choices,
    Judging,
    NamedWork,
    ProblemText,
    asked_tasks,
    check_judging,
    open_work,
    say,
)


def watch(
    problem: ProblemText,
    /,
    *,
    work: NamedWork,
    tasks: Annotated[
        Path | None,
        Parameter(
            help="CSV or Parquet file with columns demo, start_STATE..., goal_STATE...; a "
            "demonstration's id names its row, unless there is only one row. [default: the task "
            "that the work folder holds, if there is only one]"
        ),
    ] = None,
    how: Choices = AS_BEFORE,
    judged: Judging = AS_USUAL,
) -> None:
    """Watch demonstrations state by state: JSON lines in, JSON lines out.

    A line in is an object such as {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "a"}, or an array
    of the states; {"end": true, "id": "a"} ends a demonstration. A line that cannot be used is
    answered with its error, and changes nothing; a blank line is passed over.
    Before the first line, learns whatever the work folder does not hold yet.
    """
    from swerve.base.space import Task
    from swerve.cli.json_lines import Watch, answer_lines
    from swerve.demonstrations.demonstration import read_tasks
    from swerve.monitoring.monitor import check_hypotheses

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
    watched = Watch(evidence, job.foresight(evidence), named, **vars(judged))
    say("watching: one state a line")
    source = io.BytesIO() if sys.stdin is None else sys.stdin.buffer
    answer_lines(source, watched.answer, sys.stdout)
