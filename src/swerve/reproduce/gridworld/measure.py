"""Measure false positives and KL of greedy inference in a gridworld (Scobee & Sastry, 2019).

From D demonstrations, constraints c_1, ..., c_P are picked until one gains less than a threshold:

    false positives = picks that are not among the true constraints,   their rate = that number / P,
    KL = KL(demonstrations || pi_C) after the last pick, or of pi_0 without picks.

A pick counts as true only if it is itself a true constraint: a single cell of a true feature is a
false positive, and so is a pick that only follows from the true constraints. Without picks the rate
is 0.

A threshold only ends the sequence of picks. So greedy selection runs once for each set and size,
with the least threshold; for a larger threshold the sequence is cut at the first gain below it.

Shapes: K thresholds, E sets of demonstrations, L sizes D, P picks, H hypotheses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.fitting.steps import steps_taken
from swerve.problem.problem import Problem
from swerve.reproduce.gridworld.golden import Agreement, Golden, Picked, agree, pick, read_golden
from swerve.solvers.exact.tabular import Tabular
from swerve.systems.gridworld import MOVES, Cell, Gridworld

THRESHOLDS = (1.0, 0.1, 0.01)  # nats a demonstration
SIZES = [*range(1, 10), *range(10, 101, 10)]
QUICK_SIZES = (1, 3, 10, 30, 100)
NUM_SETS = 5
FIXED_WORK = 40  # work of one greedy sequence for the progress bar, plus 1 for each demonstration

# This project's own world, of the same form, for runs without a file of golden output.
START, GOAL = (0, 0), (8, 0)
FEATURES: tuple[tuple[str, tuple[Cell, ...]], ...] = (
    ("A", ((5, 0), (5, 1), (5, 2))),
    ("B", ((2, 3), (2, 4), (3, 4))),
)
TRUE_FEATURES, TRUE_MOVES = ("A",), ("down-left", "down-right")
TRUE_CELLS: tuple[Cell, ...] = ((3, 3), (4, 4), (6, 3), (7, 2), (1, 6))


class Curves(NamedTuple):
    """Counts and KL against the number of demonstrations.

    Attributes:
      thresholds: [K] nats a demonstration.
      sizes: [L] numbers of demonstrations.
      num_picks: [K, E, L] numbers of picks.
      num_false: [K, E, L] numbers of picks that are not true constraints.
      kl: [K, E, L] KL after the last pick, nats.
    """

    thresholds: list[float]
    sizes: list[int]
    num_picks: np.ndarray
    num_false: np.ndarray
    kl: np.ndarray

    @property
    def false_rate(self) -> np.ndarray:
        """[K, E, L] share of the picks that are false positives; 0 without picks."""
        return self.num_false / np.maximum(self.num_picks, 1)


class Result(NamedTuple):
    """Measurements.

    Attributes:
      world: problem, truth and demonstrations.
      curves: curves for THRESHOLDS and the threshold of the golden output.
      golden: curve of the golden picks, with K = 1; None without golden output.
      agreement: agreement with the golden picks; None without golden output.
      violation: [H] probability of entering each hypothesis under pi_0.
    """

    world: Golden
    curves: Curves
    golden: Curves | None
    agreement: Agreement | None
    violation: np.ndarray


def reproduce(
    data: Path | None = None, *, is_quick: bool = False, seed: int = 0, progress: bool = False
) -> Result:
    """Pick from sets of demonstrations of all sizes.

    Args:
      data: file of golden output, with demonstrations to use and picks to compare with; None to
        sample demonstrations in this project's own world.
      is_quick: whether to use only QUICK_SIZES.
      seed: seed of sampled demonstrations.
      progress: whether to show a progress bar.

    Raises:
      OSError: if the file does not exist.
      ValueError: if the file is not of the form of golden output.
    """
    world = own_world(seed) if data is None else read_golden(data)
    if not world.sets:
        raise ValueError(f"{data}: expected at least one set of demonstrations, got none")
    if is_quick:
        world = at_sizes(world, [size for size in world.sizes if size in QUICK_SIZES])
    return measure(world, progress=progress)


def own_world(seed: int = 0) -> Golden:
    """Return a world with demonstrations sampled exactly from pi_C, C its true constraints."""
    mdp = Gridworld(num_steps=24, step_reward=-4.0, cell_features=FEATURES)
    problem = Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False)
    task = Task(np.array(START, float), np.array(GOAL, float))
    true = {
        *(f"feature {name}" for name in TRUE_FEATURES),
        *(f"cell ({x}, {y})" for x, y in TRUE_CELLS),
        *(f"move {name}" for name in TRUE_MOVES),
    }
    truth = frozenset(index for index, label in enumerate(labels(mdp)) if label in true)
    sets = [
        sampled(problem, task, truth, np.random.default_rng([seed, e])) for e in range(NUM_SETS)
    ]
    return Golden(problem, task, truth, THRESHOLDS[1], SIZES, sets, selected=[])


def sampled(
    problem: Problem, task: Task, truth: frozenset[int], generator: np.random.Generator
) -> list[Demonstration]:
    """Return 100 demonstrations that avoid some hypotheses, sampled exactly from pi_C."""
    kept = Tabular().learn(problem).answer(task, generator, avoiding=sorted(truth)).kept
    made = [
        Demonstration(f"demo_{k}", states[: length + 1], task)
        for k, (states, length) in enumerate(zip(kept.states, kept.length, strict=True))
    ]
    return [dataclasses.replace(d, actions=steps_taken(problem, d).actions) for d in made]


def labels(mdp: Gridworld) -> list[str]:
    """Return the name of each hypothesis [H] of a gridworld, in their order."""
    return [
        *(f"feature {name}" for name, _ in mdp.cell_features),
        *(f"cell ({x:.0f}, {y:.0f})" for x, y in mdp.states),
        *(f"move {name}" for name in MOVES),
    ]


def at_sizes(world: Golden, sizes: list[int]) -> Golden:
    """Return a world with only some of its sizes.

    Raises:
      ValueError: if no size is left.
    """
    if not sizes:
        raise ValueError(f"sizes: expected some of {world.sizes}, got none: leave out --quick")
    places = [world.sizes.index(size) for size in sizes]
    selected = [[picks[place] for place in places] for picks in world.selected]
    return world._replace(sizes=sizes, selected=selected)


def measure(world: Golden, *, progress: bool = False) -> Result:
    """Pick from the first demonstrations of each set, for each of the world's sizes."""
    nominal = Tabular().learn(world.problem)
    thresholds = sorted({*THRESHOLDS, world.threshold}, reverse=True)
    amount = len(world.sets) * sum(size + FIXED_WORK for size in world.sizes)
    found: list[list[Picked]] = []
    with progress_bar("picking constraints", amount, progress) as advance:
        for k, demonstrations in enumerate(world.sets):
            found.append([])
            for size in world.sizes:
                found[k].append(pick(nominal, demonstrations[:size], thresholds[-1]))
                advance(size + FIXED_WORK, f"set {k + 1} of {len(world.sets)}")
    cuts = [[[cut(picked, value) for picked in row] for row in found] for value in thresholds]
    answer = nominal.answer(world.task, np.random.default_rng(0))
    golden = agreement = None
    if world.selected:
        golden = curves([world.selected], world, [world.threshold])
        agreement = agree(cuts[thresholds.index(world.threshold)], world.selected)
    violation = np.clip(1.0 - answer.avoid_probability, 0.0, 1.0)  # rounding may leave the range
    return Result(world, curves(cuts, world, thresholds), golden, agreement, violation)


def cut(picked: Picked, threshold: float) -> Picked:
    """Return the picks with a larger threshold [nats a demonstration]."""
    number = len(list(takewhile(lambda gain: gain >= threshold, picked.gains)))
    return Picked(picked.hypotheses[:number], picked.gains[:number], picked.kl[: number + 1])


def curves(picked: list[list[list[Picked]]], world: Golden, thresholds: list[float]) -> Curves:
    """Return the counts and KL of picks for each threshold, set and size [K][E][L]."""

    def count(of: Callable[[Picked], float]) -> np.ndarray:
        return np.array([[[of(one) for one in row] for row in sets] for sets in picked])

    return Curves(
        thresholds=thresholds,
        sizes=world.sizes,
        num_picks=count(lambda one: len(one.hypotheses)),
        num_false=count(lambda one: len(set(one.hypotheses) - world.truth)),
        kl=count(lambda one: one.kl[-1]),
    )
