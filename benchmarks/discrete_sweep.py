"""Measure how accurate discretised dynamics can be, over cells, time steps and transition rules.

    python benchmarks/discrete_sweep.py --data DIR [--torque 10] [--truth 55] [--quick] [--json]
                                        [--cells 30 60 120] [--holds 3 6 12 20] [--rules centre]

DIR is laid out as for accuracy.py. For every setting of the discrete solver the tasks of the
demonstrations are solved exactly on its table, demonstrations are moved to the centres of its cells
(as Stocking et al., 2021, do), and a row is printed: the median and worst error of a violation
probability over tasks, each at its worst hypothesis, the rank and nats of the true cell by all
demonstrations, ties counted half, and the time it took [s]. The best setting, by the rank of the
true cell and then by the median error, is marked and printed last.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from swerve import Demonstration, Discrete, Problem, infer, load_problem, sample
from swerve.base.progress import progress_bar
from swerve.reproduce.pendulum.measure import read_violation

CELLS = (30, 60, 120)  # along each axis
HOLDS = (3, 6, 12, 20)  # steps of 1/60 s
RULES = ("centre", "majority")


def measure(
    problem: Problem,
    solver: Discrete,
    demonstrations: list[Demonstration],
    exact: np.ndarray,
    truth: int,
) -> dict[str, Any]:
    """Return the row of one setting."""
    began = time.perf_counter()
    nominal = solver.learn(problem)
    moved = [nominal.snapped(demonstration) for demonstration in demonstrations]
    evidence = sample(nominal, [demonstration.task for demonstration in moved])
    result = infer(evidence, moved)
    error = np.abs(evidence.violation_probability - exact).max(axis=1)
    score = np.where(result.struck_out, -np.inf, result.log_likelihood)
    better, equal = (score > score[truth]).sum(), (score == score[truth]).sum()
    return {
        "cells": solver.num_cells,
        "hold": solver.hold,
        "rule": solver.rule,
        "median_error": float(np.median(error)),
        "worst_error": float(error.max()),
        "truth_rank": float(better + (equal + 1) / 2),
        "truth_nats": None if result.struck_out[truth] else float(score[truth]),
        "seconds": time.perf_counter() - began,
    }


def show(rows: list[dict[str, Any]], best: dict[str, Any]) -> None:
    """Print the table."""
    table = Table(title="Discretised dynamics")
    for name in ("cells", "hold", "rule", "error: median", "worst", "truth: rank", "nats", "s"):
        table.add_column(name, justify="right")
    for row in rows:
        nats = "struck out" if row["truth_nats"] is None else f"{row['truth_nats']:.1f}"
        cells = (
            f"{row['cells']}{' *' * (row is best)}",
            str(row["hold"]),
            row["rule"],
            f"{row['median_error']:.3f}",
            f"{row['worst_error']:.3f}",
            f"{row['truth_rank']:.1f}",
            nats,
            f"{row['seconds']:.1f}",
        )
        table.add_row(*cells)
    Console(width=100).print(table)
    print(f"* best: discrete?num_cells={best['cells']}&hold={best['hold']}&rule={best['rule']}")


def main() -> None:
    """Sweep, print, mark the best."""
    from swerve import read_demonstrations

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--torque", default="10")
    parser.add_argument("--truth", type=int, default=55)
    parser.add_argument("--cells", type=int, nargs="+", default=CELLS, help="along each axis")
    parser.add_argument("--holds", type=int, nargs="+", default=HOLDS, help="steps of 1/60 s")
    parser.add_argument("--rules", nargs="+", choices=RULES, default=RULES)
    parser.add_argument("--quick", action="store_true", help="three settings, eight demonstrations")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    problem = load_problem(f"pendulum?between_states=false&max_torque={arguments.torque}")
    demonstrations = read_demonstrations(
        sorted(arguments.data.glob("demo_*.csv")),
        problem.mdp.space,
        tasks=arguments.data / "tasks.csv",
    )
    settings = list(itertools.product(arguments.cells, arguments.holds, arguments.rules))
    if arguments.quick:
        demonstrations, settings = demonstrations[:8], settings[:6:2]
    path = arguments.data / f"exact_violation_torque{arguments.torque}.csv"
    exact = read_violation(path, demonstrations)
    rows = []
    with progress_bar("sweeping", len(settings), True) as advance:
        for cells, hold, rule in settings:
            solver = Discrete(cells, hold, rule)
            rows.append(measure(problem, solver, demonstrations, exact, arguments.truth))
            advance(1)
    best = min(rows, key=lambda row: (row["truth_rank"], row["median_error"]))
    if arguments.json:
        print(json.dumps({"rows": rows, "best": best}))
    else:
        show(rows, best)


if __name__ == "__main__":
    main()
