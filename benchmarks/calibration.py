"""Whether posteriors are right as often as they say.

    python benchmarks/calibration.py [--draws 1000] [--samples 10000] [--json] [--figure FILE]

A constraint, or none, is drawn from the prior, and some demonstrations from pi_c: trajectories that
avoid c, drawn by weight from other samples of pi_0 (pendulum, grid solver) or from pi_c itself
(gridworld, tabular). What `infer` makes of them is held against the truth. For both problems:

1. how often credible sets of 50, 80 and 95 % contain the truth, beside the probability that they
   say they have (sets are of whole hypotheses, so that is more than asked for), with how far apart
   the two may be by the number of draws (95 %);
2. P(no constraint) against how often there was none, in ten bins, drawn by --figure;
3. the same where the demonstrator is not as assumed: at twice and half the beta, or where
   demonstrations ignore the constraint more or less often than the tolerance says. Beside it what
   shows that: how often nothing is left, and the mean quantile of the rewards of unconstrained
   demonstrations among those of pi_0 (0.5 where beta is right).

The prior gives no probability to hypotheses that hardly any trajectory of a task avoids, since
demonstrations that obey them could not be drawn from samples.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from swerve import Demonstration, Evidence, Problem, Task, infer, learn, sample
from swerve.base.progress import progress_bar
from swerve.evidence.estimators import normalise
from swerve.hypotheses.base import unpack
from swerve.problem.loading import load_problem
from swerve.problem.tasks import draw_tasks
from swerve.solvers.learn import ExactNominal

PROBLEMS = {"pendulum": "pendulum?max_torque=10", "gridworld": "gridworld"}
NUM_TASKS = 12
NUM_DEMONSTRATIONS = (1, 3, 10, 30)
LEVELS = (0.5, 0.8, 0.95)
LEAST_AVOID = 0.01  # of a hypothesis that the prior allows, in every task
NUM_BINS = 10
LEAST_IN_BIN = 20  # draws; the share of fewer is noise
NONE = -1  # what the truth is called where there is no constraint


class Scenario(NamedTuple):
    """What the demonstrator does, and what is assumed.

    Attributes:
      name: for people.
      beta: of the demonstrator, times that assumed.
      ignoring: probability that a demonstration ignores the constraint.
      tolerance: what is assumed of it.
    """

    name: str
    beta: float = 1.0
    ignoring: float = 0.0
    tolerance: float = 0.0


SCENARIOS = (
    Scenario("as assumed"),
    Scenario("as assumed, 10 % ignore it", ignoring=0.1, tolerance=0.1),
    Scenario("beta twice that assumed", beta=2.0),
    Scenario("beta half that assumed", beta=0.5),
    Scenario("10 % ignore it, none assumed", ignoring=0.1),
    Scenario("none ignores it, 10 % assumed", tolerance=0.1),
)


class Drawn(NamedTuple):
    """A demonstration as far as inference looks at it.

    Attributes:
      entered: [H] what it enters.
      total_reward: its reward.
    """

    entered: np.ndarray
    total_reward: float


Draw = Callable[[int, int, np.random.Generator], Drawn]
"""Draws a demonstration of a task that obeys a hypothesis, or NONE."""


class World(NamedTuple):
    """A problem to be tried.

    Attributes:
      evidence: that inference rests on.
      prior: [H + 1].
      draw: for each multiple of beta.
    """

    evidence: Evidence
    prior: np.ndarray
    draw: dict[float, Draw]


class Trial(NamedTuple):
    """What was inferred from one draw of everything.

    Attributes:
      is_none: whether there was no constraint.
      none: P(no constraint).
      truth: posterior of the truth.
      said: [levels] probability of the credible sets.
      contained: [levels] whether they contain the truth.
      nothing_left: whether every hypothesis of the prior was struck out.
      quantile: mean quantile of the rewards where there was no constraint, NaN elsewhere.
    """

    is_none: bool
    none: float
    truth: float
    said: list[float]
    contained: list[bool]
    nothing_left: bool
    quantile: float


def make_world(text: str, num_samples: int, betas: list[float], seed: int) -> World:
    """Return evidence of a problem, and what draws demonstrations of it."""
    problem = load_problem(text)
    tasks = draw_tasks(problem, NUM_TASKS, seed=seed)
    nominal = learn(problem)
    evidence = sample(nominal, tasks, num_samples, seed=seed, progress=True)
    is_exact = isinstance(nominal, ExactNominal)
    least = 0.0 if is_exact else LEAST_AVOID
    allowed = (evidence.violation_probability < 1.0 - least).all(axis=0)
    prior = np.concatenate([[0.5], 0.5 * allowed / allowed.sum()])
    draw: dict[float, Draw] = {}
    for beta in betas:
        other = dataclasses.replace(problem, beta=beta * problem.beta)
        make = _exact_draw if is_exact else _sampled_draw
        draw[beta] = make(other, tasks, num_samples, seed + 1)
    return World(evidence, prior, draw)


def _sampled_draw(problem: Problem, tasks: Task, num_samples: int, seed: int) -> Draw:
    """Return what draws from samples of pi_0, by weight, those that avoid c."""
    nominal = learn(problem)
    evidence = sample(nominal, tasks, num_samples, method="importance", seed=seed, progress=True)
    num_hypotheses = len(problem.hypotheses)
    rewards, bits = evidence.samples.total_reward, evidence.samples.violations
    weight = np.array([normalise(row) for row in evidence.log_weight])

    def draw(task: int, hypothesis: int, generator: np.random.Generator) -> Drawn:
        chance = weight[task]
        if hypothesis != NONE:
            hit = bits[task, :, hypothesis >> 3] >> (hypothesis & 7) & 1
            chance = chance * (hit == 0)
        n = generator.choice(len(chance), p=chance / chance.sum())
        return Drawn(unpack(bits[task, n], num_hypotheses), float(rewards[task, n]))

    return draw


def _exact_draw(problem: Problem, tasks: Task, num_samples: int, seed: int) -> Draw:
    """Return what draws from pi_c worked out for each task and hypothesis once."""
    del num_samples
    nominal, made = learn(problem), {}
    assert isinstance(nominal, ExactNominal)

    def draw(task: int, hypothesis: int, generator: np.random.Generator) -> Drawn:
        if (task, hypothesis) not in made:
            avoiding = [] if hypothesis == NONE else [hypothesis]
            answer = nominal.answer(
                Task(tasks.start[task], tasks.goal[task]),
                np.random.default_rng([seed, task, hypothesis + 1]),
                avoiding=avoiding,
            )
            made[task, hypothesis] = answer.drawn
        drawn = made[task, hypothesis]
        n = generator.integers(len(drawn.total_reward))
        entered = unpack(drawn.violations[n], len(problem.hypotheses))
        return Drawn(entered, float(drawn.total_reward[n]))

    return draw


def try_once(world: World, scenario: Scenario, generator: np.random.Generator) -> Trial:
    """Draw a truth and demonstrations of it, and infer."""
    evidence = world.evidence
    truth = int(generator.choice(len(world.prior), p=world.prior)) - 1
    tasks = generator.integers(evidence.num_tasks, size=generator.choice(NUM_DEMONSTRATIONS))
    obeyed = np.where(generator.random(len(tasks)) < scenario.ignoring, NONE, truth)
    made = [
        world.draw[scenario.beta](int(task), int(hypothesis), generator)
        for task, hypothesis in zip(tasks, obeyed, strict=True)
    ]
    result = infer(evidence, prior=world.prior, tolerance=scenario.tolerance)
    result = dataclasses.replace(
        result,
        demonstrations=tuple(_stand_in(evidence, int(task)) for task in tasks),
        task_of=tasks,
        entered=np.array([one.entered for one in made]),
    )
    sets = [result.credible_set(level) for level in LEVELS]
    allowed = world.prior[1:] > 0.0
    return Trial(
        is_none=truth == NONE,
        none=result.posterior.none,
        truth=result.posterior.none if truth == NONE else result.posterior.hypotheses[truth],
        said=[found.probability for found in sets],
        contained=[
            found.has_none if truth == NONE else truth in found.hypotheses for found in sets
        ],
        nothing_left=bool(result.struck_out[allowed].all()),
        quantile=_quantile(evidence, tasks, made) if truth == NONE else math.nan,
    )


def _stand_in(evidence: Evidence, task: int) -> Demonstration:
    """Return a demonstration of a task; what it enters is told apart from it."""
    start, goal = evidence.tasks.start[task], evidence.tasks.goal[task]
    return Demonstration("drawn", start[None], Task(start, goal))


def _quantile(evidence: Evidence, tasks: np.ndarray, made: list[Drawn]) -> float:
    """Return the mean quantile of rewards among those of pi_0, ties counted half."""
    found = []
    for task, one in zip(tasks, made, strict=True):
        rewards, weight = evidence.samples.total_reward[task], normalise(evidence.log_weight[task])
        near = np.abs(rewards - one.total_reward) < 1e-9 * (1.0 + np.abs(rewards))
        found.append(weight @ np.where(near, 0.5, rewards < one.total_reward))
    return float(np.mean(found))


def summarise(trials: list[Trial]) -> dict[str, Any]:
    """Return what many trials come to."""
    num, none = len(trials), np.array([trial.none for trial in trials])
    is_none = np.array([trial.is_none for trial in trials])
    place = np.minimum((none * NUM_BINS).astype(int), NUM_BINS - 1)
    bins = [
        {
            "said": float(none[place == k].mean()),
            "was": float(is_none[place == k].mean()),
            "num": int((place == k).sum()),
        }
        for k in range(NUM_BINS)
        if (place == k).sum() >= LEAST_IN_BIN
    ]
    return {
        "num": num,
        "said": np.mean([trial.said for trial in trials], axis=0).tolist(),
        "contained": np.mean([trial.contained for trial in trials], axis=0).tolist(),
        "error": [
            1.96 * math.sqrt(max(share * (1.0 - share), 1.0 / num) / num)
            for share in np.mean([trial.said for trial in trials], axis=0)
        ],
        "none_said": float(none.mean()),
        "none_was": float(is_none.mean()),
        "none_bins": bins,
        "truth": float(np.mean([trial.truth for trial in trials])),
        "nothing_left": float(np.mean([trial.nothing_left for trial in trials])),
        "quantile": float(np.nanmean([trial.quantile for trial in trials])),
    }


def table(name: str, rows: dict[str, dict[str, Any]]) -> Table:
    """Return a table of all scenarios of a problem."""
    made = Table(title=f"{name}: how often credible sets contain the truth (they say)")
    made.add_column("demonstrator")
    for level in LEVELS:
        made.add_column(f"{level:.0%}", justify="right")
    for column in ("P(none), mean (was)", "P(truth), mean", "nothing left", "reward quantile"):
        made.add_column(column, justify="right")
    for scenario, row in rows.items():
        sets = zip(row["contained"], row["said"], row["error"], strict=True)
        made.add_row(
            scenario,
            *(f"{was:.3f} ({said:.3f} ± {error:.3f})" for was, said, error in sets),
            f"{row['none_said']:.3f} ({row['none_was']:.3f})",
            f"{row['truth']:.2f}",
            f"{row['nothing_left']:.3f}",
            f"{row['quantile']:.2f}",
        )
    return made


def draw_figure(found: dict[str, dict[str, dict[str, Any]]], path: Path) -> None:
    """Draw P(no constraint) against how often there was none."""
    figure = Figure((max(6.5, 3.6 * len(found)), 4.4), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    styles = ("o-", "s--", "^:", "v:", "D-.", "x-.")
    greys = ("#000000", "#555555", "#0072b2", "#56b4e9", "#d55e00", "#e69f00")
    for ax, (name, rows) in zip(axes, found.items(), strict=True):
        ax.plot([0, 1], [0, 1], color="#bbbbbb", lw=1)
        for (scenario, row), style, colour in zip(rows.items(), styles, greys, strict=True):
            said = [one["said"] for one in row["none_bins"]]
            was = [one["was"] for one in row["none_bins"]]
            ax.plot(said, was, style, color=colour, ms=4, lw=1, label=scenario)
        first = next(iter(rows.values()))
        for one in first["none_bins"]:
            half = 1.96 * math.sqrt(
                max(one["was"] * (1 - one["was"]), 0.25 / one["num"]) / one["num"]
            )
            ax.plot([one["said"]] * 2, [one["was"] - half, one["was"] + half], "k-", lw=0.8)
        ax.set(title=name, xlabel="P(no constraint) as inferred", xlim=(0, 1), ylim=(-0.02, 1.02))
    axes[0].set_ylabel("share of draws without one")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--draws", type=int, default=1_000, help="of each scenario")
    parser.add_argument("--samples", type=int, default=10_000, help="trajectories a task")
    parser.add_argument("--problem", choices=PROBLEMS, action="append")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for name in arguments.problem or PROBLEMS:
        betas = sorted({scenario.beta for scenario in SCENARIOS})
        world = make_world(PROBLEMS[name], arguments.samples, betas, arguments.seed)
        found[name] = {}
        with progress_bar(f"{name}: drawing", len(SCENARIOS) * arguments.draws, True) as advance:
            for scenario in SCENARIOS:
                generator, trials = np.random.default_rng(arguments.seed), []
                for _ in range(arguments.draws):
                    trials.append(try_once(world, scenario, generator))
                    advance(1)
                found[name][scenario.name] = summarise(trials)
    if arguments.json:
        print(json.dumps(found))
    else:
        for name, rows in found.items():
            Console(width=170).print(table(name, rows))
    if arguments.figure is not None:
        draw_figure(found, arguments.figure)


if __name__ == "__main__":
    main()
