"""Compare foresight of P(avoid from here on) along real demonstrations with exact values.

    python benchmarks/foresight.py --data DIR [--demos N] [--hypotheses I,J,...] [--work DIR]
                                   [--figure FILE]

The pendulum with torques up to 10 and the demonstrations in DIR. The grid solver is the nominal
and the reference: with c among the known constraints, log P_0(avoid c after t | s_t, t) is the
difference of two soft values at (s_t, t), V_c - V_0. Beside a wall, interpolation makes the soft
value too large, by up to 0.7 nats here; trajectories of the value's own policy correct this error
by their weights: V gains log mean exp(l), see `simulation.continuation`. The hypotheses compared
are those that no demonstration enters, with the one that the demonstrators avoid (cell 55).
"Open" are the states where the exact log P is below -0.05 nats; at other states the cell is already
passed. A second table gives the nats by which the evidence for cell 55 has risen at two moments:
when a demonstration is nearest to the cell (by the largest difference of a state from its centre in
units of the bounds), and when the demonstration passes the cell (the last moment at which the exact
log P(avoid after t) is below half of its value at the start). --figure draws the evidence over
time.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import swerve
from swerve.demonstrations.demonstration import Demonstration
from swerve.monitoring.foresight import Foreseer, Foresight
from swerve.simulation.continuation import continued
from swerve.simulation.policies import ValuedPolicy
from swerve.solvers.base import AdaptingSolver, PolicyNominal

TRUTH = 55  # index of the cell that the demonstrators avoid
OPEN = -0.05  # nats: above this exact log P, the cell is already passed
NUM_WEIGHED = 500  # trajectories that correct the error of a soft value
EVERY = 10  # recorded states from one that is compared to the next
QUANTILES = (0.5, 0.9, 0.95, 1.0)  # of errors
SPAN = 3.0  # s: time shown before and after a demonstration is nearest to the cell
STRONG = 0.8  # nats: demonstrations with at least this evidence in the end are black
BOLD, FAINT = {"color": "#000000", "lw": 1.0}, {"color": "#b0b0b0", "lw": 0.7}
STYLES = (("-", "#000000"), ("--", "#0072b2"), (":", "#d55e00"))


def places(demonstration: Demonstration, problem: swerve.Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return every tenth state [L, n] of a demonstration, and its step [L]."""
    assert demonstration.times is not None
    rows = np.arange(0, len(demonstration.states), EVERY)
    steps = np.round(demonstration.times[rows] / problem.mdp.dt).astype(int)
    before_end = steps < problem.mdp.num_steps
    return demonstration.states[rows][before_end], steps[before_end]


def soft_values(nominal: PolicyNominal, demonstrations: list[Demonstration]) -> list[np.ndarray]:
    """Return log Z of the rest of the episode at the states [L] of each demonstration, nats."""
    goals = np.stack([item.task.goal for item in demonstrations])
    found = []
    for policy, item in zip(nominal.policies(goals), demonstrations, strict=True):
        assert isinstance(policy, ValuedPolicy)
        states, steps = places(item, nominal.problem)
        value = jax.jit(jax.vmap(policy.soft_value, (0, 0, None)))
        goal = jnp.asarray(item.task.goal, jnp.float32)
        values = np.asarray(value(jnp.asarray(states, jnp.float32), steps, goal), float)
        for k, (state, step) in enumerate(zip(states, steps.tolist(), strict=True)):
            starts = jnp.repeat(jnp.asarray(state, jnp.float32)[:, None], NUM_WEIGHED, axis=1)
            key, first = jax.random.key(k), jnp.asarray(step)
            rest = continued(nominal.problem, policy, starts, first, goal, key)
            log_weight = np.asarray(rest.log_weight[step], float)
            values[k] += np.logaddexp.reduce(log_weight) - np.log(NUM_WEIGHED)
        found.append(values)
    return found


def foreseen(
    foreseer: Foreseer, problem: swerve.Problem, demonstrations: list[Demonstration]
) -> list[np.ndarray]:
    """Return log P(avoid from here on) [L, H] of each demonstration, nats."""
    found = []
    for item in demonstrations:
        ahead = foreseer.towards(np.asarray(item.task.goal))
        states, steps = places(item, problem)
        pairs = zip(states, steps.tolist(), strict=True)
        found.append(np.stack([ahead(state, step).copy() for state, step in pairs]))
    return found


def quantile_row(error: np.ndarray) -> list[str]:
    """Return the quantiles of errors as text."""
    return [f"{np.quantile(np.abs(error), share):.3f}" for share in QUANTILES]


def main() -> None:
    """Learn what is not stored yet, compare, and print tables."""
    arguments = parsed_arguments()
    problem = swerve.load_problem("pendulum?max_torque=10")
    files = sorted(arguments.data.glob("demo_*.csv"))[: arguments.demos]
    demonstrations = swerve.read_demonstrations(
        files, problem.mdp.space, tasks=arguments.data / "tasks.csv"
    )
    nominal = swerve.learn(problem, "grid")
    assert isinstance(nominal, PolicyNominal)
    evidence, foresight, seconds = learned(nominal, demonstrations, arguments.work)
    result = swerve.infer(evidence, demonstrations)
    chosen = [int(text) for text in arguments.hypotheses.split(",") if text]
    chosen = chosen or list(dict.fromkeys([TRUTH, *result.ranking[:4].tolist()]))
    chosen = [index for index in chosen if not result.struck_out[index]]
    unconstrained = soft_values(nominal, demonstrations)
    foreseers = {
        "learned": foreseen(foresight, problem, demonstrations),
        f"{arguments.rollouts} rollouts": foreseen(
            swerve.Rollouts(nominal, arguments.rollouts), problem, demonstrations
        ),
    }
    exact = {index: exact_values(nominal, index, demonstrations, unconstrained) for index in chosen}
    shown = f"learned in {seconds:.0f} s" if seconds else "learned before"
    title = f"error of log P(avoid after t) in nats, {len(files)} demonstrations, {shown}"
    Console(width=110).print(error_table(title, foreseers, exact))
    risen, ends = evidence_over_time(demonstrations, evidence, foreseers, exact[TRUTH])
    Console(width=130).print(rise_table(problem, demonstrations, risen, ends, exact[TRUTH]))
    if arguments.figure is not None:
        draw_figure(problem, demonstrations, risen, ends, arguments.figure)


def parsed_arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--demos", type=int, default=6)
    parser.add_argument("--hypotheses", default="")
    parser.add_argument("--work", type=Path, help="keep evidence and foresight here")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--rollouts", type=int, default=1000, help="for each answer on the spot")
    return parser.parse_args()


def error_table(
    title: str, foreseers: dict[str, list[np.ndarray]], exact: dict[int, list[np.ndarray]]
) -> Table:
    """Return quantiles of the errors of each kind of foresight, by hypothesis and over all.

    Args:
      title: title of the table.
      foreseers: log P(avoid after t) [L, H] along each demonstration, by kind of foresight.
      exact: the exact values [L] along each demonstration, by hypothesis.
    """
    table = Table(title=title)
    for column in ("foresight", "hypothesis", *(f"{share:.0%}" for share in QUANTILES)):
        table.add_column(column)
    for name, values in foreseers.items():
        errors = {
            index: np.concatenate(
                [value[:, index] - true for value, true in zip(values, truths, strict=True)]
            )
            for index, truths in exact.items()
        }
        for index, error in errors.items():
            table.add_row(name, str(index), *quantile_row(error))
        every = np.concatenate(list(errors.values()))
        is_open = np.concatenate([np.concatenate(truths) for truths in exact.values()]) < OPEN
        table.add_row(name, "all", *quantile_row(every))
        table.add_row(name, f"all, open ({is_open.mean():.0%})", *quantile_row(every[is_open]))
    return table


def learned(
    nominal: PolicyNominal, demonstrations: list[Demonstration], work: Path | None
) -> tuple[swerve.Evidence, Foresight, float]:
    """Return evidence and foresight of the demonstrations' tasks, and the time to learn [s]."""
    kinds = () if work is None else ("evidence", "foresight")
    paths = [Path(work or "") / f"{len(demonstrations)}.{kind}" for kind in kinds]
    if paths and paths[0].exists():
        evidence = swerve.Evidence.load(paths[0])
    else:
        evidence = swerve.sample(nominal, [item.task for item in demonstrations])
    if paths and paths[1].exists():
        return evidence, Foresight.load(paths[1], evidence.problem), 0.0
    began = time.perf_counter()
    foresight = swerve.foresee(nominal, evidence, progress=True)
    seconds = time.perf_counter() - began
    if paths:
        evidence.save(paths[0])
        foresight.save(paths[1])
    return evidence, foresight, seconds


def exact_values(
    nominal: PolicyNominal,
    index: int,
    demonstrations: list[Demonstration],
    unconstrained: list[np.ndarray],
) -> list[np.ndarray]:
    """Return the exact log P(avoid c after t) [L] along each demonstration, nats."""
    problem = nominal.problem
    known = [*problem.known, problem.hypotheses.constraint(index)]
    narrower = dataclasses.replace(problem, known=known)
    assert isinstance(nominal.solver, AdaptingSolver)
    (adapted,) = nominal.solver.adapted(nominal, narrower, 0)
    assert isinstance(adapted, PolicyNominal)
    pairs = zip(soft_values(adapted, demonstrations), unconstrained, strict=True)
    return [np.minimum(obeying - free, 0.0) for obeying, free in pairs]


def evidence_over_time(
    demonstrations: list[Demonstration],
    evidence: swerve.Evidence,
    foreseers: dict[str, list[np.ndarray]],
    exact: list[np.ndarray],
) -> tuple[dict[str, list[np.ndarray]], np.ndarray]:
    """Return the evidence for the truth [L] along each demonstration, by source, and its end."""
    ends = [-evidence.log_ratio[evidence.match(item.task), TRUTH] for item in demonstrations]
    left = {"exact": exact} | {
        name: [value[:, TRUTH] for value in values] for name, values in foreseers.items()
    }
    risen = {
        name: [value + end for value, end in zip(values, ends, strict=True)]
        for name, values in left.items()
    }
    return risen, np.array(ends)


def nearest_row(problem: swerve.Problem, states: np.ndarray) -> int:
    """Return the row of the state [L, n] that is nearest to the centre of the true cell."""
    box = problem.hypotheses.constraint(TRUTH)
    assert isinstance(box, swerve.Box)
    centre = np.array([np.mean(interval) for interval in box.intervals.values()])
    distance = np.abs(problem.mdp.space.difference(centre, states)) / problem.mdp.space.extent
    return int(distance.max(axis=1).argmin())


def passing_row(left: np.ndarray) -> int:
    """Return the last row where log P(avoid after t) [L] is below half the first."""
    return int(np.flatnonzero(left <= 0.5 * left[0])[-1])


def rise_table(
    problem: swerve.Problem,
    demonstrations: list[Demonstration],
    risen: dict[str, list[np.ndarray]],
    ends: np.ndarray,
    exact: list[np.ndarray],
) -> Table:
    """Return the evidence for the truth when demonstrations are nearest to it and pass it."""
    table = Table(
        title=f"evidence for cell {TRUTH} in nats: when nearest to it, passing it, in the end"
    )
    for column in ("demonstration", "nearest at [s]", *risen, "passes at [s]", *risen, "end"):
        table.add_column(column)
    totals = np.zeros((2, len(risen)))
    for k, item in enumerate(demonstrations):
        states, steps = places(item, problem)
        rows = nearest_row(problem, states), passing_row(exact[k])
        cells = []
        for which, row in enumerate(rows):
            values = [value[k][row] for value in risen.values()]
            totals[which] += values
            cells += [f"{steps[row] * problem.mdp.dt:.2f}", *(f"{value:.3f}" for value in values)]
        table.add_row(item.name, *cells, f"{ends[k]:.3f}")
    shares = [[f"{share:.0%}" for share in row] for row in totals / ends.sum()]
    table.add_row("all", "", *shares[0], "", *shares[1], f"{ends.sum():.2f}")
    return table


def draw_figure(
    problem: swerve.Problem,
    demonstrations: list[Demonstration],
    risen: dict[str, list[np.ndarray]],
    ends: np.ndarray,
    path: Path,
) -> None:
    """Draw the evidence for the truth over the time since a demonstration is nearest to it."""
    figure = Figure((7.2, 3.6), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    together, single = figure.subplots(1, 2)
    times = np.linspace(-SPAN, SPAN, 401)
    for (name, values), (style, colour) in zip(risen.items(), STYLES, strict=True):
        total = np.zeros(len(times))
        for item, value, end in zip(demonstrations, values, ends, strict=True):
            states, steps = places(item, problem)
            since = (steps - steps[nearest_row(problem, states)]) * problem.mdp.dt
            total += np.interp(times, since, value, left=0.0, right=end)
            if name == "exact":
                strong = end >= STRONG
                look: dict[str, Any] = BOLD if strong else FAINT
                single.plot([*since, SPAN], [*value, end], zorder=2 + strong, **look)
        together.plot(times, total, style, color=colour, lw=1.8, label=name)
    together.axhline(ends.sum(), color="#808080", lw=0.8, ls=(0, (1, 2)))
    together.text(-SPAN, ends.sum(), " in the end", va="bottom", fontsize=8, color="#404040")
    together.set(
        title=f"all {len(ends)} demonstrations", ylabel=f"evidence for cell {TRUTH} [nats]"
    )
    together.set_ylim(0.0, 1.12 * ends.sum())
    together.legend(loc="upper left", bbox_to_anchor=(0.0, 0.88), fontsize=8, frameon=False)
    single.set(title=f"each, exactly (black: {STRONG:g} nats or more in the end)")
    for axes in (together, single):
        axes.axvline(0.0, color="#808080", lw=0.8)
        axes.set(xlim=(-SPAN, SPAN), xlabel=f"time since nearest to cell {TRUTH} [s]")
        axes.title.set_fontsize(9)
        axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)


if __name__ == "__main__":
    main()
