"""Measure how fast training approaches pi_0: soft values and PPO, for the same time.

    python benchmarks/training.py --data DIR [--seconds 600] [--torque 10] [--every 4]
                                  [--samples 4000] [--json] [--figure FILE]

DIR has the files of accuracy.py. Each solver trains for about --seconds, one after the other,
without the time to compile. A few iterations are timed first to choose the number of steps, since
learning rates fall with the share of the steps that is done. After every few chunks, outside the
clock, the tasks of the demonstrations are sampled and a row is printed: wall time [s], environment
steps, KL(pi || pi_0) [nats] with log Z_0 from the grid solver, and the largest error over cells of
importance-weighted violation probabilities against DIR's exact ones, both at the median and at the
worst task. The errors include the sampling noise of both.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from accuracy import NUM_REFERENCE, print_rows
from rich.console import Console

from swerve import PPO, Grid, Problem, SoftValue, Task, learn, read_demonstrations, sample
from swerve.evidence.estimators import kl_divergence
from swerve.problem.loading import load_problem
from swerve.reproduce.pendulum.measure import read_violation
from swerve.solvers.trained.history_plot import LEAST, finish, log_scale, time_unit
from swerve.solvers.trained.probe import Progress
from swerve.solvers.trained.run import Run
from swerve.solvers.trained.settings import NUM_CHUNKS
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver

SOLVERS: tuple[TrainingSolver, ...] = (SoftValue(), PPO())
TIMED = 20  # iterations to time, after as many to warm up
MARKS: tuple[dict[str, Any], ...] = (
    {"color": "#0072b2", "marker": "o"},
    {"color": "#d55e00", "marker": "s"},
)
PANELS = {
    "kl": "KL, exact log Z [nats]",
    "error": "error of a violation probability\nat its worst cell",
}


class Truth(NamedTuple):
    """Exact answers.

    Attributes:
      problem: the pendulum.
      tasks: [K] tasks of the demonstrations.
      violation: [K, H] exact violation probabilities.
      log_partition: [K] log Z_0, nats.
    """

    problem: Problem
    tasks: Task
    violation: np.ndarray
    log_partition: np.ndarray


def read_truth(folder: Path, torque: str) -> Truth:
    """Read the exact probabilities of a folder and compute log Z_0 of its tasks."""
    path = folder / f"exact_violation_torque{torque}.csv"
    if not path.exists():
        raise SystemExit(f"{folder}: no {path.name}")
    problem = load_problem(f"pendulum?between_states=false&max_torque={torque}")
    files = sorted(folder.glob("demo_*.csv"))
    demonstrations = read_demonstrations(files, problem.mdp.space, tasks=folder / "tasks.csv")
    tasks = Task.stack([demonstration.task for demonstration in demonstrations])
    violation = read_violation(path, demonstrations)
    return Truth(problem, tasks, violation, exact_log_partition(problem, tasks))


def exact_log_partition(problem: Problem, tasks: Task) -> np.ndarray:
    """Return log Z_0 [K] by importance weights of the default grid, whose ESS is near N."""
    return sample(learn(problem, Grid()), tasks, NUM_REFERENCE, progress=True).log_partition


def with_steps(solver: TrainingSolver, num_steps: float) -> TrainingSolver:
    """Return the solver with another number of steps."""
    changed = {"num_steps": max(1, round(num_steps))}
    return dataclasses.replace(solver, **changed)  # pyright: ignore[reportArgumentType]


def new_run(solver: TrainingSolver, truth: Truth) -> Run:
    """Return a new run of training."""
    return Run(solver, solver.trainer(truth.problem, 0), truth.problem, truth.tasks, 0, None)


def steps_per_second(solver: TrainingSolver, truth: Truth) -> float:
    """Return the environment steps per second of a solver on this machine."""
    chunk = TIMED * solver.num_lanes * solver.segment
    run = new_run(with_steps(solver, chunk * NUM_CHUNKS), truth)
    before, after = run.advance(), run.advance()
    assert before is not None
    assert after is not None
    return chunk / (after.seconds - before.seconds)


def measure(solver: TrainingSolver, truth: Truth, every: int, num: int) -> Iterator[dict[str, Any]]:
    """Train, and yield a row after every few chunks and the last."""
    run = new_run(solver, truth)
    while (progress := run.advance()) is not None:
        number = len(run.history)
        if number % every and number != solver.num_chunks:
            continue
        nominal = TrainedNominal(truth.problem, solver, run.policy, np.array(run.history))
        yield row(nominal, progress, truth, num)


def row(nominal: TrainedNominal, progress: Progress, truth: Truth, num: int) -> dict[str, Any]:
    """Return the errors of a policy."""
    evidence = sample(nominal, truth.tasks, num, method="importance", seed=1)
    pairs = zip(evidence.importance_log_weight, truth.log_partition, strict=True)
    kl = [kl_divergence(*pair) for pair in pairs]
    error = np.abs(evidence.violation_probability - truth.violation).max(axis=1)
    return {
        "solver": nominal.solver.name,
        "seconds": progress.seconds,
        "steps": int(progress.num_steps),
        "median_kl": float(np.median(kl)),
        "worst_kl": float(np.max(kl)),
        "median_error": float(np.median(error)),
        "worst_error": float(error.max()),
    }


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw KL and error over time, the median task as a line, the worst one dashed."""
    from matplotlib.figure import Figure

    unit, seconds = time_unit(max(row["seconds"] for row in rows))
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    panels = figure.subplots(1, len(PANELS))
    for axes, (name, label) in zip(panels, PANELS.items(), strict=True):
        for solver, marks in zip(SOLVERS, MARKS, strict=True):
            chosen = [row for row in rows if row["solver"] == solver.name]
            time = [row["seconds"] / seconds for row in chosen]
            for task, style in (("median", "-"), ("worst", "--")):
                values = np.maximum([row[f"{task}_{name}"] for row in chosen], LEAST)
                fill = {} if task == "median" else {"mfc": "white"}
                what = f"{solver.name}, {task} task"
                axes.plot(time, values, ls=style, ms=4, label=what, **marks, **fill)
        log_scale(axes)
        finish(axes, label)
        axes.set_xlabel(f"time [{unit}]", fontsize=9)
        axes.set_xlim(left=0.0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Train one solver after the other, print the table and draw it."""
    parser = argparse.ArgumentParser(description="How fast training gets near pi_0.")
    parser.add_argument("--data", type=Path, required=True, help="folder, see above")
    parser.add_argument("--seconds", type=float, default=600.0, help="to train each solver for")
    parser.add_argument("--torque", default="10", help="which exact file")
    parser.add_argument("--every", type=int, default=4, help="chunks between measurements")
    parser.add_argument("--samples", type=int, default=4_000, help="trajectories a task")
    parser.add_argument("--figure", type=Path, help="picture to write")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    truth = read_truth(arguments.data, arguments.torque)
    rows = []
    for solver in SOLVERS:
        timed = with_steps(solver, arguments.seconds * steps_per_second(solver, truth))
        for found in measure(timed, truth, arguments.every, arguments.samples):
            print(found, file=sys.stderr)
            rows.append(found)
    load = os.getloadavg()[0]
    if arguments.json:
        print(json.dumps({"max_torque": float(arguments.torque), "load": load, "rows": rows}))
    else:
        title = f"torques in [-{arguments.torque}, {arguments.torque}], load {load:.1f}"
        print_rows(title, rows, Console(width=120))
    if arguments.figure:
        plot(rows, arguments.figure)


if __name__ == "__main__":
    main()
