"""The slow parts of the car's result, each kept in a file: nominal, evidence, foresight.

A file that exists is loaded and checked; a file that does not exist is made and timed.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from swerve.answer import infer
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrators.driver import START
from swerve.evidence.evidence import Evidence
from swerve.monitoring.foresee import foresee
from swerve.monitoring.foresight import Foresight
from swerve.problem.problem import Problem
from swerve.reproduce.keeping import Keeping
from swerve.sampling.resolve import resolve
from swerve.sampling.sample import sample
from swerve.solvers.base import Nominal
from swerve.solvers.learn import learn, load_nominal, save_nominal
from swerve.solvers.trained.soft_value import SoftValue

TASK = Task(np.array(START), np.zeros(0))  # the task of every drive


def nominal(keeping: Keeping, name: str, problem: Problem, solver: SoftValue) -> Nominal:
    """Return the nominal of a problem."""
    path, checkpoint = (keeping.folder / f"{name}.{kind}" for kind in ("nominal", "checkpoint"))
    if not path.exists():
        how = {"seed": keeping.seed, "progress": keeping.progress, "checkpoint": checkpoint}
        with keeping.clock.timing(f"{name}: learn"):
            found = learn(problem, solver, tasks=Task.stack([TASK]), **how)
        save_nominal(path, found)
        checkpoint.unlink(missing_ok=True)
    return load_nominal(path, problem)


def evidence(
    keeping: Keeping, name: str, source: Nominal, num: int, beta: float | None = None
) -> Evidence:
    """Return evidence of TASK; at another beta than the nominal's, if given, by tempering."""
    path = keeping.folder / f"{name}.evidence"
    if not path.exists():
        how = {"beta": beta, "seed": keeping.seed, "progress": keeping.progress}
        with keeping.clock.timing(f"{name}: sample"):
            found = sample(source, TASK, num, **how)
        found.save(path)
    wanted = source.problem if beta is None else dataclasses.replace(source.problem, beta=beta)
    return _loaded(path, wanted)


def _loaded(path: Path, problem: Problem) -> Evidence:
    """Return stored evidence of a problem.

    Raises:
      ValueError: if the evidence is of another problem.
    """
    found = Evidence.load(path)
    if found.problem.fingerprint != problem.record.fingerprint:
        raise ValueError(
            f"{path}: expected evidence of {problem.record.summary}, got evidence of "
            f"{found.problem.summary}: remove the file"
        )
    return found


def resolved(
    keeping: Keeping, source: Nominal, sampled: Evidence, made: list[Demonstration]
) -> Evidence:
    """Return evidence with the pairs resolved that the ranking by a single drive depends on."""
    path, found = keeping.folder / "resolved.evidence", sampled
    if path.exists():
        found = _loaded(path, source.problem)
    with keeping.clock.timing("resolve"):
        for drive in made:
            inference = infer(found, [drive])
            if inference.is_open.any():
                found = resolve(
                    source,
                    inference,
                    seed=keeping.seed,
                    progress=keeping.progress,
                    keep=lambda better: better.save(path),
                )
    return found


def foresight(
    keeping: Keeping, source: Nominal, resolved_evidence: Evidence, num: int, num_updates: int
) -> Foresight:
    """Return the foresight of each region, learned from `num` rollouts."""
    path = keeping.folder / "foresight"
    if not path.exists():
        with keeping.clock.timing("foresee"):
            found = foresee(
                source,
                resolved_evidence,
                num_trajectories=num,
                num_updates=num_updates,
                seed=keeping.seed,
                progress=keeping.progress,
            )
        found.save(path)
    loaded = Foresight.load(path, source.problem)
    if loaded.learned_from != resolved_evidence.digest:
        raise ValueError(f"{path}: was learned from other evidence: remove the file")
    return loaded
