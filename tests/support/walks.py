"""A small gridworld, and demonstrations that walk through it."""

from __future__ import annotations

import numpy as np

from swerve import Demonstration, Gridworld, Problem, Task
from swerve.systems.gridworld import MOVES

WORLD = Gridworld(width=4, height=3, num_steps=5, cell_features=(("wet", ((1, 0), (2, 0))),))
PROBLEM = Problem(WORLD, WORLD.hypotheses(), measure="counting", between_states=False)
TASK = Task(np.array([0.0, 0.0]), np.array([3.0, 0.0]))


def walk(*names: str) -> Demonstration:
    """Go from the start by moves."""
    moves = np.array([MOVES[name] for name in names], float)
    states = np.concatenate([TASK.start[None], TASK.start + moves.cumsum(axis=0)])
    return Demonstration("-".join(names), states, TASK, actions=moves)


ROUND = walk("up", "right", "right", "down-right")
