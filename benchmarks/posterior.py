"""Measure posteriors of the truth and of no constraint against the number of demonstrations.

    python benchmarks/posterior.py --data DIR [--torque 10] [--work DIR] [--json] [--figure FILE]

DIR holds demo_*.csv and tasks.csv of the pendulum, as for accuracy.py. The grid solver samples
their tasks, and entering is judged at the states alone. For random subsets of growing size:

1. of the real demonstrations, which obey the true cell (--truth): the posterior of this cell and of
   no constraint;
2. of as many demonstrations sampled from pi_0 for the same tasks, which obey none:
   P(no constraint).

Printed are medians over the subsets, the middle 80 % of them, and the median of the standard error
of the posterior from sampling.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from swerve import Demonstration, Evidence, Task, infer, read_demonstrations
from swerve.base.progress import progress_bar
from swerve.problem.loading import load_problem
from swerve.work.settings import Settings
from swerve.work.work import Work

SIZES = (1, 2, 3, 5, 8, 12, 16, 20, 25, 30)
QUANTILES = (0.1, 0.5, 0.9)
STYLES = {
    "P(true cell), real demonstrations": ("o-", "#5b1a78"),
    "P(no constraint), real demonstrations": ("s--", "#d55e00"),
    "P(no constraint), demonstrations under none": ("^:", "#0072b2"),
}


def unconstrained(evidence: Evidence, seed: int) -> list[Demonstration]:
    """Return a trajectory of pi_0 for each task, out of those that evidence keeps."""
    generator, kept = np.random.default_rng(seed), evidence.samples.kept
    return [
        Demonstration(
            f"free_{k}",
            np.asarray(kept[k, generator.integers(kept.shape[1])], float),
            Task(evidence.tasks.start[k], evidence.tasks.goal[k]),
        )
        for k in range(evidence.num_tasks)
    ]


def curves(
    evidence: Evidence, real: list[Demonstration], truth: int, num_subsets: int, seed: int
) -> list[dict[str, Any]]:
    """Return rows of posteriors against the number of demonstrations."""
    generator = np.random.default_rng(seed)
    sizes = [size for size in SIZES if size < len(real)] + [len(real)]
    rows: list[dict[str, Any]] = []
    with progress_bar("inferring", len(sizes) * num_subsets, True) as advance:
        for size in sizes:
            values = np.zeros((len(STYLES), num_subsets, 2))
            for k in range(num_subsets):
                chosen = generator.permutation(len(real))[:size]
                of_real = infer(evidence, [real[d] for d in chosen]).posterior
                free = unconstrained(evidence, seed=int(generator.integers(2**31)))
                of_free = infer(evidence, [free[d] for d in chosen]).posterior
                values[:, k] = (
                    (of_real.hypotheses[truth], of_real.error[truth]),
                    (of_real.none, of_real.none_error),
                    (of_free.none, of_free.none_error),
                )
                advance(1)
            for name, found in zip(STYLES, values, strict=True):
                low, middle, high = np.quantile(found[:, 0], QUANTILES)
                rows.append(
                    {
                        "what": name,
                        "demonstrations": size,
                        "median": float(middle),
                        "low": float(low),
                        "high": float(high),
                        "standard_error": float(np.median(found[:, 1])),
                    }
                )
    return rows


def table(rows: list[dict[str, Any]]) -> Table:
    """Return a table with a row for each number of demonstrations."""
    made = Table(title="median (middle 80 % of subsets) ± standard error by the samples")
    made.add_column("demonstrations", justify="right")
    for name in STYLES:
        made.add_column(name, justify="right")
    for size in dict.fromkeys(row["demonstrations"] for row in rows):
        cells = [
            f"{row['median']:.4f} ({row['low']:.3f} to {row['high']:.3f}) "
            f"± {row['standard_error']:.4f}"
            for row in rows
            if row["demonstrations"] == size
        ]
        made.add_row(f"{size}", *cells)
    return made


def draw_figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the curves with their intervals."""
    figure = Figure((6.0, 4.2), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for name, (style, colour) in STYLES.items():
        mine = [row for row in rows if row["what"] == name]
        x = [row["demonstrations"] for row in mine]
        axes.plot(x, [row["median"] for row in mine], style, color=colour, ms=4, label=name)
        low, high = ([row[side] for row in mine] for side in ("low", "high"))
        axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.set(xlabel="demonstrations", ylabel="posterior probability", ylim=(-0.02, 1.02))
    figure.legend(loc="outside upper left", fontsize=8, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)


def main() -> None:
    """Measure, print the table and draw the curves."""
    parser = argparse.ArgumentParser(description="Posteriors on real demonstrations.")
    parser.add_argument("--data", type=Path, required=True, help="folder, see above")
    parser.add_argument("--torque", default="10", help="max_torque of the pendulum")
    parser.add_argument("--truth", type=int, default=55, help="index of the true cell")
    parser.add_argument("--subsets", type=int, default=200, help="random subsets of each size")
    parser.add_argument("--samples", type=int, default=10_000, help="trajectories a task")
    parser.add_argument("--work", type=Path, help="folder that keeps samples")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    space = load_problem("pendulum").mdp.space
    real = read_demonstrations(
        sorted(arguments.data.glob("demo_*.csv")), space, tasks=arguments.data / "tasks.csv"
    )
    work = Work(
        f"pendulum?between_states=false&max_torque={arguments.torque}",
        arguments.work,
        Settings("grid", num_trajectories=arguments.samples),
        progress=True,
        say=lambda line: print(line, file=sys.stderr),
    )
    evidence = work.evidence(Task.stack([item.task for item in real]))
    evidence = evidence.select([evidence.match(item.task) for item in real])
    rows = curves(evidence, real, arguments.truth, arguments.subsets, arguments.seed)
    print(json.dumps(rows)) if arguments.json else Console(width=150).print(table(rows))
    if arguments.figure is not None:
        draw_figure(rows, arguments.figure)


if __name__ == "__main__":
    main()
