"""What tests of published results share."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.golden_world import KINDS, SIZES, VALUES, WORLD, left_after

from swerve.answer import infer
from swerve.fitting.steps import steps_taken
from swerve.inference.greedy import greedy
from swerve.reproduce.gridworld import measure as gridworld
from swerve.reproduce.gridworld.golden import read_golden
from swerve.sampling.sample import sample
from swerve.solvers.exact.tabular import Tabular
from swerve.systems.gridworld import MOVES


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small file of golden output, whose demonstrations and picks are the tabular solver's."""
    path = tmp_path_factory.mktemp("golden") / "golden.json"
    path.write_text(json.dumps({"world": WORLD, "num_demonstrations": SIZES, "sets": []}))
    world = read_golden(path)
    made = gridworld.sampled(world.problem, world.task, world.truth, np.random.default_rng(1))[:8]
    moves = [tuple(MOVES[name]) for name in reversed(MOVES)]
    nominal = Tabular().learn(world.problem)
    selected = []
    for size in SIZES:
        found = infer(sample(nominal, world.task), made[:size])
        picks = greedy(found, nominal, threshold=world.threshold)
        after = left_after(world.problem, made[:size], picks)
        indices = [pick.hypothesis for pick in picks]
        selected.append(
            [
                {"type": KINDS[index], "value": VALUES[index], "kl": kl}
                for index, kl in zip(indices, after, strict=True)
            ]
        )
    found = {
        "states": [(d.states @ [1, 4]).astype(int).tolist() for d in made],
        "actions": [
            [moves.index((int(x), int(y))) for x, y in steps_taken(world.problem, d).actions]
            for d in made
        ],
        "selected": selected,
    }
    path.write_text(json.dumps({"world": WORLD, "num_demonstrations": SIZES, "sets": [found]}))
    return path
