"""A cart on a line whose dynamics are NumPy alone: how it moves, and drives of it."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from support.synthetic import make_record

from swerve.base.space import StateSpace, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.motion import Motion, fit_motion
from swerve.hypotheses.grid import grid
from swerve.problem.record import ProblemRecord

SPACE = StateSpace(("x", "v"), (), np.array([[-3.0, 3.0], [-4.0, 4.0]]))
DT = 0.05  # s
FORCES = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])


def cart_record() -> ProblemRecord:
    """The record of the cart: one step is 0.05 s, an episode 3 s."""
    cells = grid(x=(-3.0, 3.0, 4), v=(-4.0, 4.0, 3))
    return make_record(space=SPACE, goal_names=SPACE.names, dt=DT, num_steps=60, hypotheses=cells)


def euler(states: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Explicit Euler steps of states [..., 2]."""
    x, v = states[..., 0], states[..., 1]
    return np.stack(np.broadcast_arrays(x + DT * v, v + DT * force), axis=-1)


@cache
def cart_motion() -> Motion:
    """How the cart moves, fitted to its steps."""
    before = np.random.default_rng(0).uniform(SPACE.bounds[:, 0], SPACE.bounds[:, 1], (900, 2))
    return fit_motion(before, euler(before[:, None], FORCES), SPACE, DT)


def drive(rate: float = 1.0, seed: int = 0) -> Demonstration:
    """A smooth drive there and back, recorded `rate` times as often as the model steps."""
    duration = 3.0
    times = np.linspace(0.0, duration, round(duration / DT * rate) + 1)
    generator = np.random.default_rng(seed)
    size, turn = generator.uniform(0.9, 1.1), generator.uniform(1.3, 1.6)
    states = np.stack(
        [1.0 - size * np.cos(turn * times), size * turn * np.sin(turn * times)], axis=1
    )
    return Demonstration(f"drive_{seed}", states, Task(states[0], states[-1]), times)


def changed(item: Demonstration, states: np.ndarray) -> Demonstration:
    """The demonstration with other states [L, n]."""
    return dataclasses.replace(item, states=states, task=Task(states[0], states[-1]))
