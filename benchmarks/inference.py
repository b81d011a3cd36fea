"""Time `infer` on loaded evidence, for one finished demonstration and for 33.

    python benchmarks/inference.py [--hypotheses 100,10000] [--repeats N]

Demonstrations are random pendulum paths of 301 states, each of another task, judged between the
states too; times for one demonstration are over one after another. The checks of `infer` are
included; reading files and printing tables are not. `infer` computes the ranking and the posterior
with its errors on first use, so times up to each of them are given. Pin the process to a core that
nothing else uses (`taskset -c 1`).
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
from monitor import make_evidence, path
from rich.console import Console
from rich.table import Table

import swerve

NUM_DEMONSTRATIONS = 33
UP_TO = ("entered", "ranking", "posterior")  # the first by the call, the others on first use
QUANTILES = (0.5, 0.99)
WARM_UP = 5


def make(num_hypotheses: int, num: int) -> tuple[swerve.Evidence, list[swerve.Demonstration]]:
    """Return evidence of `num` tasks, and a demonstration of each."""
    generator, times = np.random.default_rng(0), np.arange(301) / 60.0
    goals = generator.uniform([0.0, -1.0], [6.0, 1.0], (num, 2))
    starts = generator.uniform([0.0, -1.0], [6.0, 1.0], (num, 2))
    evidence = make_evidence(num_hypotheses, swerve.Task(starts, goals))
    demonstrations = []
    for k, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        states = path(len(times), seed=k)
        task = swerve.Task(start, goal)
        demonstrations.append(
            swerve.Demonstration(f"path {k}", states - states[0] + start, task, times)
        )
    return evidence, demonstrations


def infer_each(
    evidence: swerve.Evidence, parts: list[list[swerve.Demonstration]], name: str, repeats: int
) -> np.ndarray:
    """Return the time [s] of `infer` for one part after another, with one attribute read."""
    taken = np.empty(WARM_UP + repeats)
    for k in range(len(taken)):
        part = parts[k % len(parts)]
        began = time.perf_counter()
        result = swerve.infer(evidence, part)
        getattr(result, name)
        taken[k] = time.perf_counter() - began
    return taken[WARM_UP:]


def main() -> None:
    """Time `infer` and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hypotheses", default="100,10000")
    parser.add_argument("--repeats", type=int, default=500)
    arguments = parser.parse_args()
    table = Table(title=f"infer ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})")
    for column in ("hypotheses", "demonstrations", "up to", *(f"{q:.0%} [us]" for q in QUANTILES)):
        table.add_column(column)
    for text in arguments.hypotheses.split(","):
        evidence, demonstrations = make(int(text), NUM_DEMONSTRATIONS)
        for parts in ([[item] for item in demonstrations], [demonstrations]):
            for name in UP_TO:
                taken = infer_each(evidence, parts, name, arguments.repeats)
                times = (f"{1e6 * np.quantile(taken, q):.0f}" for q in QUANTILES)
                table.add_row(text, str(len(parts[0])), name, *times)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
