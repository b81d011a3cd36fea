"""A user's problem in a file of its own, and the command run on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from swerve.base.space import TWO_PI, StateSpace

ROBOT = """
import math
import neighbour
from swerve import Pendulum, Problem, grid

def problem(beta: float = 0.05, between_states: bool = True):
    cells = grid(theta=(0.0, 2 * math.pi, 6), omega=(-4.0, 4.0, 5))
    mdp = Pendulum(max_torque=neighbour.MAX_TORQUE, dt=0.4, num_steps=6)
    return Problem(mdp, cells, beta=beta, between_states=between_states)
"""
SOLVER = "grid?num_points=40"
CONSTRAINT = 17
SPACE = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-8.0, 8.0]]))

Run = Callable[..., tuple[int, str, str]]


def infer(robot: str, files: list[Path], work: Path, *more: object) -> list[object]:
    """Return the arguments of an inference."""
    tasks = files[0].parent / "tasks.csv"
    return ["infer", robot, *files, "--tasks", tasks, "--work", work, "--samples", 500, *more]
