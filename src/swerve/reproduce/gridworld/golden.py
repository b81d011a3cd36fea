"""Golden output of tabular constraint inference: a world, demonstrations, and what was picked.

A file of this form is JSON:

    world               width, height, start, goal, action_delta, reward_per_action, horizon,
                        feature_<name>_states, threshold, true_constraints
    num_demonstrations  sizes D
    sets                for each: states and actions of its demonstrations, and, for each D,
                        selected: the picks in order, with the KL divergence after each

States are numbered y * width + x. Of the hypotheses, features come first, then states, then
actions.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.fitting.rewards import divergence
from swerve.inference.greedy import greedy
from swerve.inference.ranking import infer
from swerve.problem.problem import Problem
from swerve.sampling.sample import sample
from swerve.solvers.exact.tabular import TableNominal, Tabular
from swerve.systems.gridworld import MOVES, Cell, Gridworld


class Picked(NamedTuple):
    """Constraints picked one after another.

    Attributes:
      hypotheses: [P] their indices.
      gains: [P] nats a demonstration; NaN where not told.
      kl: [P+1] KL divergence before the first pick and after each, nats; NaN where not told.
    """

    hypotheses: list[int]
    gains: list[float]
    kl: list[float]


class Agreement(NamedTuple):
    """How far picks are those of a golden output.

    Attributes:
      same: sequences of picks that are the same.
      number: sequences in all.
      error: largest difference of a KL divergence in those that are the same, nats.
    """

    same: int
    number: int
    error: float


class Golden(NamedTuple):
    """What such a file holds.

    Attributes:
      problem: features, states and actions as hypotheses, counting measure, states alone.
      task: the task of all demonstrations.
      truth: the hypotheses that the demonstrations obeyed.
      threshold: of the picks [nats a demonstration].
      sizes: how many demonstrations were used.
      sets: demonstrations, the first D of which were used.
      selected: for each set and size what was picked, without gains and the first KL.
    """

    problem: Problem
    task: Task
    truth: frozenset[int]
    threshold: float
    sizes: list[int]
    sets: list[list[Demonstration]]
    selected: list[list[Picked]]


def read_golden(path: Path) -> Golden:
    """Read a file of golden output.

    Raises:
      OSError: if there is no such file.
      ValueError: if it is not of this form.
    """
    try:
        golden = _golden(json.loads(path.read_text()))
        least, most = min(golden.sizes, default=0), max(golden.sizes, default=0)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(f"{path}: not of the form of a golden.json: {error!r}") from error
    if least < 1:
        raise ValueError(f"{path}: expected numbers num_demonstrations of at least 1")
    for k, (demonstrations, selected) in enumerate(zip(golden.sets, golden.selected, strict=True)):
        if len(demonstrations) < most:
            raise ValueError(
                f"{path}: set {k}: expected {most} demonstrations, the largest of "
                f"num_demonstrations, got {len(demonstrations)}"
            )
        if len(selected) != len(golden.sizes):
            raise ValueError(
                f"{path}: set {k}: expected picks for each of {len(golden.sizes)} sizes, got "
                f"{len(selected)}"
            )
    return golden


def _golden(data: dict[str, Any]) -> Golden:
    world = data["world"]
    width = world["width"]
    moves = [list(delta) for delta in MOVES.values()]
    order = [moves.index(list(delta)) for delta in world["action_delta"]]

    def cell(state: int) -> Cell:
        return state % width, state // width

    names = sorted(key.split("_")[1] for key in world if key.startswith("feature_"))
    features = tuple((n, tuple(map(cell, world[f"feature_{n}_states"]))) for n in names)
    mdp = Gridworld(
        width=width,
        height=world["height"],
        num_steps=world["horizon"] - 1,
        step_reward=world["reward_per_action"],
        cell_features=features,
    )
    first = {
        "feature": {int(name): k for k, name in enumerate(names)},
        "state": {s: len(names) + s for s in range(mdp.num_states)},
        "action": {a: len(names) + mdp.num_states + k for a, k in enumerate(order)},
    }
    task = Task(*(np.array(cell(world[end]), float) for end in ("start", "goal")))
    table = np.array(list(MOVES.values()), float)[order]

    def demonstration(k: int, states: list[int], actions: list[int]) -> Demonstration:
        path = np.array([cell(state) for state in states], float)
        return Demonstration(f"demo_{k}", path, task, actions=table[np.array(actions, int)])

    return Golden(
        problem=Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False),
        task=task,
        truth=frozenset(
            first[kind][value] for kind in first for value in world["true_constraints"][f"{kind}s"]
        ),
        threshold=world["threshold"],
        sizes=data["num_demonstrations"],
        sets=[
            [
                demonstration(k, *pair)
                for k, pair in enumerate(zip(found["states"], found["actions"], strict=True))
            ]
            for found in data["sets"]
        ],
        selected=[
            [
                Picked(
                    [first[pick["type"]][pick["value"]] for pick in picks],
                    [math.nan] * len(picks),
                    [math.nan, *(pick["kl"] for pick in picks)],
                )
                for picks in sizes
            ]
            for sizes in (found["selected"] for found in data["sets"])
        ],
    )


def compare(golden: Golden) -> Agreement:
    """Pick anew from every set and size, and compare with what was picked."""
    nominal = Tabular().learn(golden.problem)
    found = [
        [pick(nominal, demonstrations[:size], golden.threshold) for size in golden.sizes]
        for demonstrations in golden.sets
    ]
    return agree(found, golden.selected)


def pick(nominal: TableNominal, demonstrations: list[Demonstration], threshold: float) -> Picked:
    """Pick constraints from demonstrations of a single task; threshold in nats a demonstration."""
    inference = infer(sample(nominal, demonstrations[0].task), demonstrations)
    picks = greedy(inference, nominal, threshold=threshold)
    start = divergence(nominal.problem, demonstrations, np.zeros(len(demonstrations)))
    free = nominal.log_partition(demonstrations[0].task, [()])
    after = [float(value) for value in (free[0], *(pick.log_partition[0] for pick in picks))]
    return Picked(
        [pick.hypothesis for pick in picks],
        [pick.gain for pick in picks],
        [start + value for value in after],
    )


def agree(found: list[list[Picked]], golden: list[list[Picked]]) -> Agreement:
    """Compare sequences of picks [E][L] with golden ones."""
    pairs = [pair for rows in zip(found, golden, strict=True) for pair in zip(*rows, strict=True)]
    same = [(ours, theirs) for ours, theirs in pairs if ours.hypotheses == theirs.hypotheses]
    errors = [np.abs(np.subtract(ours.kl[1:], theirs.kl[1:])) for ours, theirs in same]
    return Agreement(len(same), len(pairs), float(np.concatenate([[0.0], *errors]).max()))
