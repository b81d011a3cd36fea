"""Golden output of another implementation: a world, demonstrations, and the picked constraints.

A file of this form is JSON:

    world               width, height, start, goal, action_delta, reward_per_action, horizon,
                        feature_<name>_states, threshold, true_constraints
    num_demonstrations  sizes D
    sets                for each: states and actions of its demonstrations, and, for each D,
                        selected: the picks in order, with the KL divergence after each

States are numbered y * width + x. Hypotheses are in the order features, states, actions.

Shapes: P picks, D demonstrations, E sets of demonstrations, L sizes D.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swerve.answer import infer
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.tables import file_content
from swerve.fitting.rewards import divergence
from swerve.inference.greedy import greedy
from swerve.problem.problem import Problem
from swerve.sampling.sample import sample
from swerve.solvers.exact.tabular import TableNominal, Tabular
from swerve.systems.gridworld import MOVES, Cell, Gridworld


class Picked(NamedTuple):
    """Constraints picked one after another.

    Attributes:
      hypotheses: [P] indices of the constraints.
      gains: [P] gain of each pick, nats a demonstration; NaN where unknown.
      kl: [P+1] KL divergence before the first pick and after each, nats; NaN where unknown.
    """

    hypotheses: list[int]
    gains: list[float]
    kl: list[float]


class Agreement(NamedTuple):
    """Agreement of picks with golden output.

    Attributes:
      same: number of sequences of picks that are the same.
      number: number of all sequences.
      error: largest difference of a KL divergence in sequences that are the same, nats.
    """

    same: int
    number: int
    error: float


class Golden(NamedTuple):
    """Contents of a file of golden output.

    Attributes:
      problem: features, states and actions as hypotheses; counting measure; entering at states.
      task: the task of all demonstrations.
      truth: indices of the hypotheses that the demonstrations obey.
      threshold: gain below which picking ends [nats a demonstration].
      sizes: [L] numbers of demonstrations that picks are made from.
      sets: [E] demonstrations; picks are made from the first D of a set.
      selected: [E][L] picks of each set and size, without gains and the first KL.
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
      OSError: if the file does not exist.
      ValueError: if the file is not of this form.
    """
    try:
        golden = _parsed(json.loads(file_content(path)))
        least, most = min(golden.sizes, default=0), max(golden.sizes, default=0)
    except (KeyError, TypeError, IndexError, ValueError, RecursionError) as error:
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


def _parsed(data: dict[str, Any]) -> Golden:
    """Return the contents of a file from its JSON data."""
    world = data["world"]
    moves = [list(delta) for delta in MOVES.values()]
    order = [moves.index(list(delta)) for delta in world["action_delta"]]
    mdp = _gridworld(world)
    indices = _indices(mdp, order)
    task = Task(*(np.array(_cell(world, world[end]), float) for end in ("start", "goal")))
    table = np.array(list(MOVES.values()), float)[order]
    truth = frozenset(
        indices[kind][value] for kind in indices for value in world["true_constraints"][f"{kind}s"]
    )
    return Golden(
        problem=Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False),
        task=task,
        truth=truth,
        threshold=world["threshold"],
        sizes=data["num_demonstrations"],
        sets=[_demonstrations(found, world, task, table) for found in data["sets"]],
        selected=[
            [_picked(picks, indices) for picks in found["selected"]] for found in data["sets"]
        ],
    )


def _cell(world: dict[str, Any], state: int) -> Cell:
    """Return (x, y) of a numbered state."""
    return state % world["width"], state // world["width"]


def _gridworld(world: dict[str, Any]) -> Gridworld:
    """Return the MDP of a world."""
    names = sorted(key.split("_")[1] for key in world if key.startswith("feature_"))
    features = [
        (name, tuple(_cell(world, state) for state in world[f"feature_{name}_states"]))
        for name in names
    ]
    return Gridworld(
        width=world["width"],
        height=world["height"],
        num_steps=world["horizon"] - 1,
        step_reward=world["reward_per_action"],
        cell_features=tuple(features),
    )


def _indices(mdp: Gridworld, order: list[int]) -> dict[str, dict[int, int]]:
    """Return the index of each feature, state and action of a file among the hypotheses.

    Args:
      mdp: the gridworld.
      order: place in MOVES of each action of the file.
    """
    num = len(mdp.cell_features)
    return {
        "feature": {int(name): k for k, (name, _) in enumerate(mdp.cell_features)},
        "state": {state: num + state for state in range(mdp.num_states)},
        "action": {action: num + mdp.num_states + k for action, k in enumerate(order)},
    }


def _demonstrations(
    found: dict[str, Any], world: dict[str, Any], task: Task, table: np.ndarray
) -> list[Demonstration]:
    """Return the demonstrations of one set; `table` holds the move of each action."""
    made = []
    for k, (states, actions) in enumerate(zip(found["states"], found["actions"], strict=True)):
        path = np.array([_cell(world, state) for state in states], float)
        taken = table[np.array(actions, int)]
        made.append(Demonstration(f"demo_{k}", path, task, actions=taken))
    return made


def _picked(picks: list[dict[str, Any]], indices: dict[str, dict[int, int]]) -> Picked:
    """Return the picks of one set and size."""
    return Picked(
        [indices[pick["type"]][pick["value"]] for pick in picks],
        [math.nan] * len(picks),
        [math.nan, *(pick["kl"] for pick in picks)],
    )


def compare(golden: Golden) -> Agreement:
    """Pick from every set and size, and compare with the golden picks."""
    nominal = Tabular().learn(golden.problem)
    found = [
        [pick(nominal, demonstrations[:size], golden.threshold) for size in golden.sizes]
        for demonstrations in golden.sets
    ]
    return agree(found, golden.selected)


def pick(nominal: TableNominal, demonstrations: list[Demonstration], threshold: float) -> Picked:
    """Pick constraints from demonstrations of one task; threshold in nats a demonstration."""
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
