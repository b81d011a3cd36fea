"""State spaces and small files of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.demonstrations.demonstration import Demonstration, read_demonstrations

PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
PLANE = StateSpace(("x", "y"), (), np.array([[0.0, 10.0], [-2.0, 2.0]]))
ROWS = "x,y\n1,0\n2,0.5\n3,1\n"
TASKS = "demo,start_x,start_y,goal_x,goal_y\n7,1,0,3,1\n8,5,0,6,1\n"


def save(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())
    return path


def read_one(path: Path, **options: Any) -> Demonstration:
    (demonstration,) = read_demonstrations([path], PLANE, **options)
    return demonstration


def make(states: Sequence[Sequence[float]], name: str = "a", **parts: Any) -> Demonstration:
    return Demonstration(
        name, np.array(states), Task(np.array(states[0]), np.array(states[-1])), **parts
    )
