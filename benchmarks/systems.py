"""How far soft value networks get where no grid fits: the car and the double pendulum.

    python benchmarks/systems.py [--system car] [--steps 20000000] [--work DIR] [--json]

For each system two tables. The first is about the system itself, on tasks drawn from it: least and
median ESS of importance weights as a share of the trajectories, the largest KL(pi || pi_0) by their
own log Z_0 [nats], the largest difference between any two of the 20 islands' log Z_0 by sequential
Monte Carlo [nats], and the time to learn and to sample [s]. The second is about a coarse version of
8 steps, small enough to enumerate all A^8 action sequences: the errors of log Z_0 [nats] and of the
worst violation probability, and the exact KL.
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
    learn,
    load_nominal,
    load_problem,
    sample,
    save_nominal,
)
from swerve.tasks import draw_tasks

NUM_TASKS = 8
COARSE_STEPS = 2_000_000


class System(NamedTuple):
    """A system and its coarse version.

    Attributes:
      name: of the shipped problem.
      coarse: the MDP with 8 long steps.
      beta: of the coarse version.
      task: of the coarse version.
    """

    name: str
    coarse: Any
    beta: float
    task: Task


SYSTEMS = (
    System("car", Car(dt=0.5, num_steps=8), 0.03, Task([0.0, 4.0, 0.0, 1.0], [])),
    System(
        "double-pendulum",
        DoublePendulum(dt=0.3, num_steps=8),
        1.0,
        Task([0.3, -0.2, 0.0, 0.5], [-0.4, 0.5, 0.0, 0.0]),
    ),
)


def learned(problem: Problem, solver: SoftValue, file: Path | None) -> tuple[Nominal, float | None]:
    """Return the nominal distribution, and the time it took to learn [s] unless it was stored."""
    if file is not None and file.exists():
        return load_nominal(file, problem), None
    began = time.perf_counter()
    checkpoint = None if file is None else file.with_suffix(".checkpoint")
    nominal = learn(problem, solver, progress=True, checkpoint=checkpoint)
    seconds = time.perf_counter() - began
    if file is not None:
        save_nominal(file, nominal)
    return nominal, seconds


def measure(system: System, solver: SoftValue, folder: Path | None, num: int) -> dict[str, Any]:
    """Return figures about a system."""
    problem = load_problem(system.name)
    file = None if folder is None else folder / f"{system.name}.{solver.num_steps}.nominal"
    nominal, seconds = learned(problem, solver, file)
    tasks = draw_tasks(problem, NUM_TASKS)
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


def measure_coarse(system: System, num: int) -> dict[str, Any]:
    """Return how far the coarse version is from enumeration."""
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
    parser.add_argument("--work", type=Path, help="folder that keeps what was learned")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    solver = SoftValue(**({} if arguments.steps is None else {"num_steps": arguments.steps}))
    if arguments.work is not None:
        arguments.work.mkdir(parents=True, exist_ok=True)
    chosen = [system for system in SYSTEMS if arguments.system in (None, system.name)]
    coarse = [measure_coarse(system, arguments.samples) for system in chosen]
    full = [measure(system, solver, arguments.work, arguments.samples) for system in chosen]
    if arguments.json:
        print(json.dumps({"systems": full, "coarse": coarse}))
        return
    show(full, "soft values, tasks drawn from the system")
    show(coarse, "soft values against enumeration")


if __name__ == "__main__":
    main()
