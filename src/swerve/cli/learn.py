"""The commands that fill a work folder ahead of inference: `swerve learn` and `swerve sample`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from swerve.cli.options import (
    AS_BEFORE,
    AsJson,
    Choices,
    NamedWork,
    ProblemText,
    Seed,
    SolverName,
    TasksFile,
    asked_tasks,
    open_work,
    say,
    tell,
)


def learn(
    problem: ProblemText,
    /,
    *,
    work: NamedWork,
    solver: SolverName = None,
    seed: Seed = None,
) -> None:
    """Learn the nominal distribution of a problem into a work folder.

    To continue a training that was interrupted, give the same command again. A picture of how
    training went is written beside what was learned.
    """
    job = open_work(problem, work, Choices(solver=solver, seed=seed))
    nominal = job.nominal()
    say(f"learned with {nominal.solver!r}; next: swerve sample or swerve infer, --work {work}")


def sample(
    problem: ProblemText,
    /,
    *,
    work: NamedWork,
    tasks: TasksFile = None,
    how: Choices = AS_BEFORE,
    as_json: AsJson = False,
) -> None:
    """Sample the nominal distribution for tasks, so that inference is instant afterwards."""
    from swerve.answer import infer
    from swerve.base import phrases
    from swerve.presentation import sentences
    from swerve.trust.doubts import data_warnings

    job = open_work(problem, work, how)
    evidence = job.evidence(asked_tasks(job, [], tasks))
    prior = infer(evidence)
    rows = prior.to_json()["diagnostics"]
    if as_json:
        print(json.dumps({"num_trajectories": evidence.num_trajectories, "tasks": rows}))
        return
    tell(f"{phrases.counted(evidence.num_tasks, 'task')}, {sentences.samples(evidence)}")
    _print_table(rows)
    for warning in data_warnings(prior):
        say(f"warning: {warning}")


def _print_table(rows: list[dict[str, Any]]) -> None:
    """Print the diagnostics of each task, one row a task."""
    tell(f"{'task':>4}  {'ESS':>8}  {'KL [nats]':>9}  {'log Z_0':>9}  {'spread':>6}  start -> goal")
    for k, row in enumerate(rows):
        tell(
            f"{k:>4}  {row['effective_sample_size']:>8.0f}  {row['kl']:>9.3f}  "
            f"{row['log_partition']:>9.3f}  {row['island_spread']:>6.3f}  "
            f"{_numbers(row['start'])} -> {_numbers(row['goal'])}"
        )


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
