"""Measure accuracy: against exact violation probabilities, and on real demonstrations.

    python benchmarks/accuracy.py --data DIR [--solver grid] [--method smc] [--json] [--figure FILE]
                                  [--work DIR]

DIR holds demo_*.csv, tasks.csv (demo, start_theta, start_omega, goal_theta, goal_omega) and one or
more exact_violation_torque<max_torque>.csv: for each demonstration the exact probability that an
unconstrained trajectory of its task enters each of the 100 cells of the pendulum, judged at the
states alone. For every such file three tables are printed:

1. accuracy: the largest error over cells, at the worst and at the median task, for equal and for
   importance weights, or for "smc"; ESS as a share of N; KL(pi || pi_0) [nats] with
   log Z_0 from the grid solver at its default resolution, whatever solver is measured (for "smc"
   KL(pi_0 || pi) as the samples estimate it); the largest error of log Z_0 [nats]; wall time to
   learn and sample [s], or "stored" (null in JSON) where --work already held results of the solver;
2. the ranking by all demonstrations, in nats, and the ranking from the exact probabilities;
3. the rank of the true cell (--truth) against the number of demonstrations, averaged over random
   subsets, ties counted half, and how often the true cell is first. Among cells that are hardly
   ever entered, chance decides the ranks: no trajectory in 10,000 enters, or one does. So the
   curves are given for the exact files as they are, and for files and samples with probabilities
   below 5e-4 counted as 0.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from rich.console import Console
from rich.table import Table

from swerve import Evidence, Grid, Task, infer, learn, read_demonstrations, sample
from swerve.base.specification import Specification
from swerve.evidence.estimators import kl_divergence
from swerve.evidence.samples import METHODS, REWEIGHED, summarise
from swerve.inference.ranking import SCORES
from swerve.problem.loading import load_problem
from swerve.reproduce.pendulum.measure import LEAST_SURVIVAL, read_violation
from swerve.reproduce.ranks import NOISE, Judged, ranks
from swerve.work.folder import RESULTS
from swerve.work.settings import Settings
from swerve.work.work import Work

SIZES = (1, 2, 3, 5, 8, 10, 15, 20, 30)
NUM_SUBSETS = 2_000
CURVE_STYLES: dict[str, dict[str, Any]] = {
    "exact file": {"ls": ":", "lw": 1.2},
    "exact file above noise": {"ls": "-", "lw": 1.2},
    "Swerve above noise": {"ls": "", "marker": "o", "fillstyle": "none"},
}
NUM_REFERENCE = 2_000  # trajectories for log Z_0


class Setting(NamedTuple):
    """One exact file and the evidence of its tasks.

    Attributes:
      max_torque: largest torque of the pendulum.
      exact: [K, H] exact violation probabilities, in the order of the demonstrations.
      evidence: evidence of the same tasks.
      exact_log_partition: [K] log Z_0 from the grid solver at its default resolution, nats.
      seconds: wall time to learn and sample [s]; None where results were stored before.
    """

    max_torque: float
    exact: np.ndarray
    evidence: Evidence
    exact_log_partition: np.ndarray
    seconds: float | None


def measure_setting(
    path: Path, demonstrations: list[Any], arguments: argparse.Namespace
) -> Setting:
    """Learn and sample the problem of one exact file."""
    match = re.fullmatch(r"exact_violation_torque([0-9.]+)", path.stem)
    if match is None:
        raise ValueError(f"{path}: expected a name such as exact_violation_torque10.csv")
    max_torque = float(match[1])
    text = f"pendulum?between_states=false&max_torque={match[1]}"
    tasks = Task.stack([demonstration.task for demonstration in demonstrations])
    folder = arguments.work / path.stem if arguments.work else None
    stored = holds_results(folder, arguments.solver)
    settings = Settings(
        arguments.solver, method=arguments.method, num_trajectories=arguments.samples
    )
    work = Work(
        text, folder, settings, progress=True, say=lambda line: print(line, file=sys.stderr)
    )
    began = time.perf_counter()
    evidence = work.evidence(tasks)
    seconds = time.perf_counter() - began
    order = [evidence.match(demonstration.task) for demonstration in demonstrations]
    evidence = evidence.select(order)
    return Setting(
        max_torque,
        read_violation(path, demonstrations),
        evidence,
        reference_log_partition(text, evidence),
        None if stored else seconds,
    )


def holds_results(folder: Path | None, solver: str) -> bool:
    """Return whether a work folder holds anything that this solver has learned or sampled."""
    if folder is None:
        return False
    name = quote(str(Specification.parse(solver)), safe="=")
    files = [path.name for pattern in RESULTS for path in folder.glob(pattern)]
    return any(file.startswith(f"{name}.") for file in files)


def reference_log_partition(text: str, evidence: Evidence) -> np.ndarray:
    """Return log Z_0 [K] by importance weights of the default grid, whose ESS is near N.

    The trajectories are samples of their own, so that evidence of the default grid can be compared
    with them too.
    """
    nominal, how = learn(load_problem(text), Grid()), {"method": "importance", "seed": 1}
    return sample(nominal, evidence.tasks, NUM_REFERENCE, progress=True, **how).log_partition


def accuracy(setting: Setting) -> list[dict[str, Any]]:
    """Return one row for each way to weigh the trajectories."""
    evidence = setting.evidence
    divergences = evidence.kl
    if evidence.method != "smc":  # trajectories of "smc" are not the policy's
        pairs = zip(evidence.importance_log_weight, setting.exact_log_partition, strict=True)
        divergences = [kl_divergence(*pair) for pair in pairs]
    log_partition_error = np.abs(evidence.log_partition - setting.exact_log_partition)
    rows = []
    for method in ("smc",) if evidence.method == "smc" else REWEIGHED:
        summary = summarise(evidence.problem, evidence.samples, method)
        error = np.abs(1.0 - summary.avoid_probability - setting.exact).max(axis=1)
        share = evidence.effective_sample_size / evidence.num_trajectories
        rows.append(
            {
                "max_torque": setting.max_torque,
                "method": method,
                "worst_error": float(error.max()),
                "median_error": float(np.median(error)),
                "least_ess": float(share.min()),
                "median_ess": float(np.median(share)),
                "median_kl": float(np.median(divergences)),
                "worst_kl": float(np.max(divergences)),
                "worst_log_z_error": float(log_partition_error.max()),
                "seconds": setting.seconds,
            }
        )
    return rows


def ranking(setting: Setting, demonstrations: list[Any], truth: int) -> list[dict[str, Any]]:
    """Return the first five hypotheses and the true one, with nats and exact nats."""
    result = infer(setting.evidence, demonstrations)
    evidence = setting.evidence
    plain = None
    if evidence.method in REWEIGHED:
        avoid = summarise(evidence.problem, evidence.samples, "plain").avoid_probability
        plain = -np.log(np.maximum(avoid, 1.0 / evidence.num_trajectories)).sum(axis=0)
    exact = -np.log(np.maximum(1.0 - setting.exact, LEAST_SURVIVAL)).sum(axis=0)
    chosen = list(result.ranking[:5])
    if truth not in chosen:
        chosen.append(truth)
    return [
        {
            "max_torque": setting.max_torque,
            "rank": int(np.flatnonzero(result.ranking == index)[0]) + 1,
            "index": int(index),
            "nats": float(result.log_likelihood[index]),
            "standard_error": float(result.standard_error[index]),
            **({} if plain is None else {"plain_nats": float(plain[index])}),
            "is_lower_bound": bool(result.is_lower_bound[index]),
            "exact_nats": float(exact[index]),
            "num_left": len(result.ranking),
        }
        for index in chosen
        if not result.struck_out[index]
    ]


def curves(setting: Setting, demonstrations: list[Any], truth: int) -> list[dict[str, Any]]:
    """Return the average rank of the truth and how often it is first, by demonstrations."""
    result = infer(setting.evidence, demonstrations)
    if result.struck_out[truth]:
        raise ValueError(f"a demonstration enters cell {truth}, so it cannot be the truth: --truth")
    violation = {
        "exact file": setting.exact,
        "exact file above noise": _above_noise(setting.exact),
        "Swerve above noise": _above_noise(setting.evidence.violation_probability),
    }
    rows = []
    for source, probability in violation.items():
        nats = -np.log(np.maximum(1.0 - probability, LEAST_SURVIVAL))
        for score, values in zip(SCORES, (nats, probability), strict=True):
            for size in [size for size in SIZES if size <= len(demonstrations)]:
                generator = np.random.default_rng(0)
                scores = Judged(values, result.entered)
                rank = ranks(scores, truth, size, NUM_SUBSETS, generator)
                rows.append(
                    {
                        "max_torque": setting.max_torque,
                        "source": source,
                        "score": score,
                        "demonstrations": size,
                        "mean_rank": float(rank.mean()),
                        "rank_error": float(rank.std() / np.sqrt(NUM_SUBSETS)),
                        "first": float((rank == 1.0).mean()),
                    }
                )
    return rows


def _above_noise(probability: np.ndarray) -> np.ndarray:
    """Return probabilities, with 0 for values that a handful of trajectories decides."""
    return np.where(probability < NOISE, 0.0, probability)


def print_rows(title: str, rows: list[dict[str, Any]], console: Console) -> None:
    """Print rows as a table."""
    table = Table(title=title)
    for name in rows[0]:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    console.print(table)


def _text(value: Any) -> str:
    if value is None:  # a time that was not measured
        return "stored"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def plot_curves(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the rank of the truth against the number of demonstrations."""
    from matplotlib.figure import Figure

    torques = sorted({row["max_torque"] for row in rows}, reverse=True)
    figure = Figure(figsize=(10, 7), layout="constrained")
    axes = figure.subplots(2, len(torques), sharex=True, sharey="row", squeeze=False)
    for column, torque in enumerate(torques):
        for score, colour in zip(SCORES, ("#0072B2", "#D55E00"), strict=True):
            for source, style in CURVE_STYLES.items():
                chosen = [
                    row
                    for row in rows
                    if (row["max_torque"], row["source"], row["score"]) == (torque, source, score)
                ]
                sizes = [row["demonstrations"] for row in chosen]
                common = {"color": colour, "label": f"{score}, {source}", **style}
                axes[0, column].plot(sizes, [row["mean_rank"] for row in chosen], **common)
                axes[1, column].plot(sizes, [100 * row["first"] for row in chosen], **common)
        axes[0, column].set_title(f"torques in [-{torque:g}, {torque:g}]")
        axes[0, column].set_yscale("log")
        axes[0, column].set_yticks([1, 2, 5, 10, 20, 40], ["1", "2", "5", "10", "20", "40"])
        axes[0, column].minorticks_off()
        axes[1, column].set_xlabel("number of demonstrations")
    axes[0, 0].set_ylabel("average rank of the true cell")
    axes[1, 0].set_ylabel("true cell ranked first [%]")
    axes[0, 0].legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure every exact file of a folder and print the tables."""
    parser = argparse.ArgumentParser(description="Accuracy against exact answers.")
    parser.add_argument("--data", type=Path, required=True, help="folder, see above")
    parser.add_argument("--solver", default="grid")
    parser.add_argument("--method", choices=METHODS, help="how to sample; the solver's default")
    parser.add_argument("--samples", type=int, default=10_000, help="trajectories a task")
    parser.add_argument("--truth", type=int, default=55, help="index of the true cell")
    parser.add_argument("--torque", help="only this exact file")
    parser.add_argument("--work", type=Path, help="folder that keeps samples")
    parser.add_argument("--figure", type=Path, help="picture of the rank curves to write")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    files = sorted(arguments.data.glob(f"exact_violation_torque{arguments.torque or '*'}.csv"))
    if not files:
        raise SystemExit(f"{arguments.data}: no exact_violation_torque*.csv")
    tasks = arguments.data / "tasks.csv"
    space = load_problem("pendulum").mdp.space
    demonstrations = read_demonstrations(
        sorted(arguments.data.glob("demo_*.csv")), space, tasks=tasks
    )
    tables: dict[str, list[dict[str, Any]]] = {"accuracy": [], "ranking": [], "curves": []}
    for path in files:
        setting = measure_setting(path, demonstrations, arguments)
        tables["accuracy"] += accuracy(setting)
        tables["ranking"] += ranking(setting, demonstrations, arguments.truth)
        tables["curves"] += curves(setting, demonstrations, arguments.truth)
    if arguments.json:
        print(json.dumps({"solver": arguments.solver, **tables}))
    else:
        for title, rows in tables.items():
            print_rows(f"{title}, solver {arguments.solver}", rows, Console(width=120))
    if arguments.figure:
        plot_curves(tables["curves"], arguments.figure)


if __name__ == "__main__":
    main()
