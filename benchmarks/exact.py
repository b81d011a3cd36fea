"""Measure time and memory of exact answers.

    python benchmarks/exact.py [--json]

All 5^10 action sequences of the pendulum against 100 hypotheses, and one backward and forward pass
over a gridworld of 200 x 200 cells with 8 moves and 400 steps. Each job runs in a process of its
own; printed are its wall time [s], without the start of the process, and its peak memory [GiB].
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

JOBS = {
    "enumeration": "all 9,765,625 sequences of 5 torques in 10 steps, 100 hypotheses",
    "tabular": "200 x 200 cells, 8 moves, 400 steps, 1 hypothesis",
}


def run(name: str) -> dict[str, float]:
    """Return wall time and peak memory of one job."""
    import swerve

    if name == "enumeration":
        mdp = swerve.Pendulum(max_torque=3.0, dt=0.4, num_steps=10)
        cells = swerve.grid(theta=(0.0, 2 * np.pi, 10), omega=(-6.0, 6.0, 10))
        problem = swerve.Problem(mdp, cells, beta=0.05)
        task = swerve.Task([2.5, 0.5], [4.0, -0.5])
    else:
        mdp = swerve.Gridworld(width=200, height=200, num_steps=400)
        box = swerve.Box(x=(49.5, 60.5), y=(-0.5, 50.5))
        problem = swerve.Problem(mdp, [box], measure="counting", between_states=False)
        task = swerve.Task([0.0, 0.0], [199.0, 150.0])
    began = time.perf_counter()
    swerve.sample(swerve.learn(problem, name), task)
    return {
        "seconds": time.perf_counter() - began,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main() -> None:
    """Run each job in a process of its own and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--job", choices=JOBS, help="run this one in this process")
    arguments = parser.parse_args()
    if arguments.job:
        print(json.dumps(run(arguments.job)))
        return
    rows = {}
    for name in JOBS:
        command = [sys.executable, __file__, "--job", name]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        rows[name] = json.loads(done.stdout)
    load = os.getloadavg()[0]
    if arguments.json:
        print(json.dumps(rows | {"load": load}))
        return
    table = Table(title=f"Exact answers ({os.cpu_count()} cores, load {load:.1f})")
    for column in ("solver", "job", "time [s]", "peak memory [GiB]"):
        table.add_column(column)
    for name, row in rows.items():
        table.add_row(name, JOBS[name], f"{row['seconds']:.1f}", f"{row['peak_gib']:.2f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
