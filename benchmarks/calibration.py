"""Measure whether posteriors are right as often as they say.

    python benchmarks/calibration.py [--draws 1000] [--samples 10000] [--json] [--figure FILE]

A trial samples a constraint, or none, from the prior, and some demonstrations from pi_c: chosen by
weight among other samples of pi_0 that avoid c (pendulum, grid solver), or sampled from pi_c itself
(gridworld, tabular). The posterior of `infer` is compared with the truth, for both problems:

1. how often credible sets of 50, 80 and 95 % contain the truth, and the probability that the sets
   state (more than asked for, since sets are of whole hypotheses), with the difference that the
   number of trials allows (95 %);
2. P(no constraint) against how often there was none, in ten bins; --figure draws it;
3. the same where the demonstrator differs from the assumption: beta twice or half as large, or
   demonstrations that ignore the constraint more or less often than the tolerance. Two columns show
   such a difference: how often no hypothesis is left, and the mean quantile of the rewards of
   unconstrained demonstrations among those of pi_0 (0.5 where beta is right).

The prior excludes hypotheses that hardly any trajectory of a task avoids: no demonstration that
obeys them could be sampled.
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
from swerve.evidence.exact import ExactNominal
from swerve.hypotheses.bits import select_one, unpack
from swerve.problem.loading import load_problem
from swerve.problem.tasks import draw_tasks

PROBLEMS = {"pendulum": "pendulum?max_torque=10", "gridworld": "gridworld"}
NUM_TASKS = 12
NUM_DEMONSTRATIONS = (1, 3, 10, 30)  # one of these numbers in each trial
LEVELS = (0.5, 0.8, 0.95)  # of credible sets
LEAST_AVOID = 0.01  # least probability of avoiding a hypothesis of the prior, in every task
NUM_BINS = 10  # of P(no constraint)
LEAST_IN_BIN = 20  # trials; the share of fewer is noise
NONE = -1  # index of the truth where there is no constraint


class Scenario(NamedTuple):
    """Behaviour of the demonstrator, and the assumption about it.

    Attributes:
      name: name in tables.
      beta: beta of the demonstrator, in units of the assumed one.
      ignoring: probability that a demonstration ignores the constraint.
      tolerance: assumed value of this probability.
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


class Sampled(NamedTuple):
    """The parts of a demonstration that inference uses.

    Attributes:
      entered: [H] whether it enters each hypothesis.
      total_reward: total reward.
    """

    entered: np.ndarray
    total_reward: float


# samples a demonstration of a task that obeys a hypothesis, or NONE
Sampler = Callable[[int, int, np.random.Generator], Sampled]


class World(NamedTuple):
    """Evidence of a problem, and samplers of its demonstrations.

    Attributes:
      evidence: the evidence to infer from.
      prior: [H + 1] prior probabilities.
      samplers: sampler of demonstrations for each multiple of beta.
    """

    evidence: Evidence
    prior: np.ndarray
    samplers: dict[float, Sampler]


class Trial(NamedTuple):
    """Result of one trial.

    Attributes:
      is_none: whether there was no constraint.
      none: P(no constraint).
      truth: posterior of the truth.
      said: [levels] probability that the credible sets state.
      contained: [levels] whether the credible sets contain the truth.
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
    """Return evidence of a problem, and samplers of its demonstrations."""
    problem = load_problem(text)
    tasks = draw_tasks(problem, NUM_TASKS, seed=seed)
    nominal = learn(problem)
    evidence = sample(nominal, tasks, num_samples, seed=seed, progress=True)
    is_exact = isinstance(nominal, ExactNominal)
    least = 0.0 if is_exact else LEAST_AVOID
    allowed = (evidence.violation_probability < 1.0 - least).all(axis=0)
    prior = np.concatenate([[0.5], 0.5 * allowed / allowed.sum()])
    samplers: dict[float, Sampler] = {}
    for beta in betas:
        other = dataclasses.replace(problem, beta=beta * problem.beta)
        if is_exact:
            samplers[beta] = _exact_sampler(other, tasks, seed + 1)
        else:
            samplers[beta] = _weighted_sampler(other, tasks, num_samples, seed + 1)
    return World(evidence, prior, samplers)


def _weighted_sampler(problem: Problem, tasks: Task, num_samples: int, seed: int) -> Sampler:
    """Return a sampler that chooses by weight among samples of pi_0 that avoid c."""
    nominal = learn(problem)
    evidence = sample(nominal, tasks, num_samples, method="importance", seed=seed, progress=True)
    num_hypotheses = len(problem.hypotheses)
    rewards, bits = evidence.samples.total_reward, evidence.samples.violations
    weight = np.array([normalise(row) for row in evidence.log_weight])

    def one(task: int, hypothesis: int, generator: np.random.Generator) -> Sampled:
        chance = weight[task]
        if hypothesis != NONE:
            chance = chance * ~select_one(bits[task], slice(None), hypothesis)
        n = generator.choice(len(chance), p=chance / chance.sum())
        return Sampled(unpack(bits[task, n], num_hypotheses), float(rewards[task, n]))

    return one


def _exact_sampler(problem: Problem, tasks: Task, seed: int) -> Sampler:
    """Return a sampler of pi_c itself, which is computed once for each task and hypothesis."""
    nominal, made = learn(problem), {}
    assert isinstance(nominal, ExactNominal)

    def one(task: int, hypothesis: int, generator: np.random.Generator) -> Sampled:
        if (task, hypothesis) not in made:
            avoiding = [] if hypothesis == NONE else [hypothesis]
            answer = nominal.answer(
                Task(tasks.start[task], tasks.goal[task]),
                np.random.default_rng([seed, task, hypothesis + 1]),
                avoiding=avoiding,
            )
            made[task, hypothesis] = answer.kept
        kept = made[task, hypothesis]
        n = generator.integers(len(kept.total_reward))
        entered = unpack(kept.violations[n], len(problem.hypotheses))
        return Sampled(entered, float(kept.total_reward[n]))

    return one


def try_once(world: World, scenario: Scenario, generator: np.random.Generator) -> Trial:
    """Sample a truth and demonstrations that obey it, and infer."""
    evidence = world.evidence
    truth = int(generator.choice(len(world.prior), p=world.prior)) - 1
    tasks = generator.integers(evidence.num_tasks, size=generator.choice(NUM_DEMONSTRATIONS))
    obeyed = np.where(generator.random(len(tasks)) < scenario.ignoring, NONE, truth)
    made = [
        world.samplers[scenario.beta](int(task), int(hypothesis), generator)
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
    return Trial(
        is_none=truth == NONE,
        none=result.posterior.none,
        truth=result.posterior.none if truth == NONE else result.posterior.hypotheses[truth],
        said=[found.probability for found in sets],
        contained=[
            found.has_none if truth == NONE else truth in found.hypotheses for found in sets
        ],
        nothing_left=bool(result.struck_out[world.prior[1:] > 0.0].all()),
        quantile=_quantile(evidence, tasks, made) if truth == NONE else math.nan,
    )


def _stand_in(evidence: Evidence, task: int) -> Demonstration:
    """Return a demonstration of a task; `try_once` sets the hypotheses that it enters."""
    start, goal = evidence.tasks.start[task], evidence.tasks.goal[task]
    return Demonstration("sampled", start[None], Task(start, goal))


def _quantile(evidence: Evidence, tasks: np.ndarray, made: list[Sampled]) -> float:
    """Return the mean quantile of rewards among those of pi_0, ties counted half."""
    found = []
    for task, one in zip(tasks, made, strict=True):
        rewards, weight = evidence.samples.total_reward[task], normalise(evidence.log_weight[task])
        near = np.abs(rewards - one.total_reward) < 1e-9 * (1.0 + np.abs(rewards))
        found.append(weight @ np.where(near, 0.5, rewards < one.total_reward))
    return float(np.mean(found))


def summarise(trials: list[Trial]) -> dict[str, Any]:
    """Return means over trials."""
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
        for one in next(iter(rows.values()))["none_bins"]:  # of the first scenario
            variance = max(one["was"] * (1 - one["was"]), 0.25 / one["num"])
            half = 1.96 * math.sqrt(variance / one["num"])
            ax.plot([one["said"]] * 2, [one["was"] - half, one["was"] + half], "k-", lw=0.8)
        ax.set(title=name, xlabel="P(no constraint) as inferred", xlim=(0, 1), ylim=(-0.02, 1.02))
    axes[0].set_ylabel("share of trials without one")
    named = axes[0].get_legend_handles_labels()
    figure.legend(*named, loc="outside lower center", ncols=2, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)


def main() -> None:
    """Run the trials and print tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--draws", type=int, default=1_000, help="trials of each scenario")
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
        with progress_bar(f"{name}: trials", len(SCENARIOS) * arguments.draws, True) as advance:
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
