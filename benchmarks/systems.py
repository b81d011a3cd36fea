"""Measure soft value networks where no grid fits: the car and the double pendulum.

    python benchmarks/systems.py [--system car] [--steps 20000000] [--work DIR] [--json]

Two tables are printed for each system, and a third for the car. The first measures the system
itself, on tasks sampled from its MDP: least and median ESS of importance weights as a share of the
trajectories, the largest KL(pi || pi_0) by their own log Z_0 [nats], the largest difference between
any two of the 20 islands' log Z_0 by sequential Monte Carlo [nats], and the time to learn and to
sample [s]. The second measures a coarse version of 8 steps, small enough to enumerate all A^8
action sequences: the errors of log Z_0 [nats] and of the worst violation probability, and the exact
KL. The third measures the paper's beta for the car, where rewards span 100,000 nats, reached by
tempering from the beta of the nominal: the effective trajectories of one task, and the verdict.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from swerve import (
    Car,
    DoublePendulum,
    Nominal,
    Problem,
    SoftValue,
    Task,
    infer,
    learn,
    load_nominal,
    load_problem,
    sample,
    save_nominal,
)
from swerve.evidence.estimators import NothingLeftError
from swerve.problem.tasks import draw_tasks
from swerve.sampling.tempering import TemperingError

NUM_TASKS = 8
COARSE_STEPS = 2_000_000
NUM_TEMPERED = 1_000
TITLES = (
    "soft values, tasks sampled from the system",
    "soft values against enumeration",
    "what tempering leaves",
)


class System(NamedTuple):
    """A system and its coarse version.

    Attributes:
      name: name of the shipped problem.
      coarse: the coarse version, an MDP with 8 long steps.
      beta: beta of the coarse version.
      task: task of the coarse version.
      explore: share of the lanes that begin at any state, see `SoftValue`.
      sharp: beta to reach by tempering; None for none.
    """

    name: str
    coarse: Any
    beta: float
    task: Task
    explore: float = 0.5
    sharp: float | None = None


SYSTEMS = (
    System("car", Car(dt=0.5, num_steps=8), 0.03, Task([0.0, 4.0, 0.0, 1.0], []), sharp=200.0),
    System(
        "double-pendulum",
        DoublePendulum(dt=0.2, num_steps=8),
        1.0,
        Task([0.3, -0.2, 0.0, 0.5], [-0.4, 0.5, 0.0, 0.0]),
        explore=0.25,
    ),
)


def learned(problem: Problem, solver: SoftValue, file: Path | None) -> tuple[Nominal, float | None]:
    """Return the nominal, and the time to learn [s]; None if a part was learned before."""
    if file is None:
        began = time.perf_counter()
        return learn(problem, solver, progress=True), time.perf_counter() - began
    if file.exists():
        stored = load_nominal(file, problem)
        if stored.solver != solver:
            raise SystemExit(f"{file}: learned by {stored.solver}, not by {solver}: remove it")
        return stored, None
    checkpoint = file.with_suffix(".checkpoint")
    is_new, began = not checkpoint.exists(), time.perf_counter()
    nominal = learn(problem, solver, progress=True, checkpoint=checkpoint)
    seconds = time.perf_counter() - began
    save_nominal(file, nominal)
    checkpoint.unlink()
    return nominal, seconds if is_new else None


def measure(system: System, nominal: Nominal, seconds: float | None, num: int) -> dict[str, Any]:
    """Return the row of a system in the first table."""
    tasks = draw_tasks(nominal.problem, NUM_TASKS)
    weighed = sample(nominal, tasks, num, method="importance", progress=True)
    began = time.perf_counter()
    resampled = sample(nominal, tasks, num, method="smc", progress=True)
    sampling = time.perf_counter() - began
    share = weighed.effective_sample_size / num
    return {
        "system": system.name,
        "least_ess": float(share.min()),
        "median_ess": float(np.median(share)),
        "worst_kl": float(weighed.kl.max()),
        "islands_apart": float(np.ptp(resampled.island_log_partition, axis=1).max()),
        "learning_seconds": "stored" if seconds is None else seconds,
        "sampling_seconds": sampling,
    }


def measure_tempered(system: System, nominal: Nominal, num: int) -> dict[str, Any]:
    """Return the row of a system in the third table, at its sharp beta."""
    task = draw_tasks(nominal.problem, 1)
    began = time.perf_counter()
    row = {"system": f"{system.name} at beta {system.sharp:g}", "trajectories": num}
    try:
        evidence = sample(nominal, task, num, beta=system.sharp, progress=True)
    except (NothingLeftError, TemperingError) as error:
        return row | {"seconds": time.perf_counter() - began, "verdict": str(error)}
    return row | {
        "effective": float(evidence.effective_sample_size[0]),
        "distinct_share": float(evidence.distinct_share[0]),
        "island_spread": float(evidence.island_spread[0]),
        "seconds": time.perf_counter() - began,
        "verdict": infer(evidence).verdict(0),
    }


def measure_coarse(system: System, num: int) -> dict[str, Any]:
    """Return the row of a system in the second table: its errors against enumeration."""
    full = load_problem(system.name)
    problem = dataclasses.replace(full, mdp=system.coarse, beta=system.beta)
    exact = sample(learn(problem, "enumeration"), system.task)
    solver = SoftValue(num_steps=COARSE_STEPS, segment=8, num_minibatches=2)
    nominal = learn(problem, solver, progress=True)
    weighed = sample(nominal, system.task, num, method="importance")
    resampled = sample(nominal, system.task, num, method="smc")
    truth = exact.violation_probability[0]
    return {
        "system": f"{system.name}, 8 steps of {system.coarse.dt:g} s",
        "log_z_error": float(abs(resampled.log_partition[0] - exact.log_partition[0])),
        "worst_error": float(np.abs(resampled.violation_probability[0] - truth).max()),
        "exact_kl": float(exact.log_partition[0] - weighed.importance_log_weight[0].mean()),
        "cells_between": int(np.count_nonzero((truth > 0.05) & (truth < 0.95))),
    }


def show(rows: list[dict[str, Any]], title: str) -> None:
    """Print rows of the same columns as a table."""
    table = Table(*(name.replace("_", " ") for name in rows[0]), title=title)
    for row in rows:
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else str(x) for x in row.values()))
    Console().print(table)


def main() -> None:
    """Measure the systems and print the tables."""
    parser = argparse.ArgumentParser(description="Soft values where no grid fits.")
    parser.add_argument("--system", choices=[system.name for system in SYSTEMS])
    parser.add_argument("--steps", type=int, help="environment steps; the solver's default")
    parser.add_argument("--samples", type=int, default=10_000, help="trajectories a task")
    parser.add_argument("--work", type=Path, help="folder that keeps nominals")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    settings = {} if arguments.steps is None else {"num_steps": arguments.steps}
    if arguments.work is not None:
        arguments.work.mkdir(parents=True, exist_ok=True)
    tables: dict[str, list[dict[str, Any]]] = {title: [] for title in TITLES}
    full, coarse, tempered = tables.values()
    for system in [system for system in SYSTEMS if arguments.system in (None, system.name)]:
        coarse.append(measure_coarse(system, arguments.samples))
        problem, solver = load_problem(system.name), SoftValue(explore=system.explore, **settings)
        name = f"{system.name}.{solver.num_steps}.nominal"
        file = None if arguments.work is None else arguments.work / name
        nominal, seconds = learned(problem, solver, file)
        full.append(measure(system, nominal, seconds, arguments.samples))
        if system.sharp is not None:
            tempered.append(measure_tempered(system, nominal, NUM_TEMPERED))
    if arguments.json:
        print(json.dumps(tables))
        return
    for title, rows in tables.items():
        if rows:
            show(rows, title)


if __name__ == "__main__":
    main()
