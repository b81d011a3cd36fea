"""A small world in the form of golden output."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from swerve.demonstrations.demonstration import Demonstration
from swerve.fitting.rewards import divergence
from swerve.inference.greedy import Pick
from swerve.problem.problem import Problem
from swerve.systems.gridworld import MOVES

WORLD = {
    "width": 4,
    "height": 3,
    "start": 0,
    "goal": 3,
    "action_delta": [list(MOVES[name]) for name in reversed(MOVES)],  # not the order of Swerve
    "reward_per_action": -2.0,
    "horizon": 10,
    "feature_1_states": [9, 10],
    "feature_2_states": [1, 5],
    "threshold": 0.05,
    "true_constraints": {"states": [6], "actions": [0], "features": [2]},
}
SIZES = [1, 3, 8]
KINDS = [*(["feature"] * 2), *(["state"] * 12), *(["action"] * 8)]
VALUES = [1, 2, *range(12), *reversed(range(8))]  # of the hypotheses, as the file counts them


def left_after(problem: Problem, made: list[Demonstration], picks: list[Pick]) -> list[float]:
    """Return the KL divergence after each pick."""
    return [divergence(problem, made, np.full(len(made), p.log_partition[0])) for p in picks]


def altered(golden: Path, folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Write the golden output with a change to its data."""
    data = json.loads(golden.read_text())
    change(data)
    path = folder / "altered.json"
    path.write_text(json.dumps(data))
    return path
