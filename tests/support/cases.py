"""Problems that several solvers can solve, their exact and their sampled answers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from support.reference import Cart, short_cart

from swerve import (
    PPO,
    ActionBox,
    Box,
    Evidence,
    Grid,
    Gridworld,
    Pendulum,
    Problem,
    Tabular,
    Task,
    Union,
    learn,
    sample,
)
from swerve.evidence import estimators
from swerve.hypotheses.bits import unpack
from swerve.solvers.base import Solver
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal
from swerve.solvers.exact.tabular import TableNominal
from swerve.systems.gridworld import cell_box, move_box

STANDARD_ERRORS = 4.5
NUM = 20_000
SMALL_PPO = PPO(
    num_steps=500_000,
    num_lanes=128,
    segment=16,
    num_minibatches=4,
    width=32,
    learning_rate=1e-2,
)


@cache
def enumerated(problem: Problem) -> EnumerationNominal:
    nominal = learn(problem, Enumeration())
    assert isinstance(nominal, EnumerationNominal)
    return nominal


@cache
def tabulated(problem: Problem) -> TableNominal:
    nominal = learn(problem, Tabular())
    assert isinstance(nominal, TableNominal)
    return nominal


def is_open(probability: np.ndarray) -> np.ndarray:
    """Return where an estimate has room to be wrong in."""
    return (probability > 0.1) & (probability < 0.9)


WORLD = Gridworld(
    4, 3, 5, walls=((1, 1),), cell_features=(("ice", ((2, 1), (3, 1))), ("mud", ((0, 1), (2, 2))))
)
WORLD_TASK = Task(np.array([0.0, 0.0]), np.array([3.0, 2.0]))
KNOWN = [Union("known", [cell_box((2, 0)), move_box("up-left")])]


def world(**settings: Any) -> Problem:
    settings = {"beta": 0.2} | settings
    return Problem(WORLD, WORLD.hypotheses(), **settings)


class Case(NamedTuple):
    """A problem to be sampled, and tasks two of which share a goal.

    Attributes:
      least_ess: share of all trajectories that weights are worth, of each solver.
    """

    problem: Problem
    tasks: Task
    least_ess: dict[str, float]


PENDULUM_CELLS = [
    Box(theta=(a, a + 0.5), omega=(b, b + 1.0))
    for a, b in itertools.product((2.5, 3.0, 3.5, 4.0), (-1.0, 0.0, 1.0))
]
PENDULUM = Case(
    Problem(
        Pendulum(max_torque=3.0, num_torques=3, dt=0.3, num_steps=8),
        [
            *PENDULUM_CELLS,
            Box(theta=(-0.5, 0.3)),
            Union("swings", [PENDULUM_CELLS[0], PENDULUM_CELLS[-1]]),
            Union("slow or left", [Box(omega=(-1.0, -0.6)), ActionBox(torque=(-9.0, -1.0))]),
        ],
        beta=0.05,
    ),
    Task(
        np.array([[2.5, 0.5], [3.2, -0.5], [2.5, 0.5]]),
        np.array([[4.0, -0.5], [4.0, -0.5], [3.6, -0.2]]),
    ),
    {"grid": 0.95, "ppo": 0.4},
)
CART = Case(
    Problem(
        Cart(),
        [
            *(short_cart().hypotheses.constraint(k) for k in (4, 5, 9, 13, 14, 17, 21, 22, 23)),
            Box(x=(1.5, 9.0)),
            ActionBox(force=(0.5, 2.0)),
            ActionBox(force=(-0.5, 0.5)),
            Union("back or fast", [ActionBox(force=(-2.0, -0.5)), Box(v=(0.6, 9.0))]),
        ],
        beta=0.3,
        known=[Union("known", [Box(x=(0.2, 0.5), v=(-2.0, -0.6)), Box(v=(1.2, 9.0))])],
    ),
    Task(
        np.array([[0.6, 0.3], [0.9, 0.6], [0.3, 0.3]]),
        np.array([[-0.5, 0.0], [-0.5, 0.0], [-0.2, 0.2]]),
    ),
    {"grid": 0.5, "ppo": 0.3},
)
CASES = {"pendulum": PENDULUM, "cart": CART}
GRID = Grid(num_points=121)


@cache
def exact(name: str) -> Evidence:
    return sample(enumerated(CASES[name].problem), CASES[name].tasks)


@cache
def sampled(name: str, solver: Solver) -> Evidence:
    """Return evidence by importance weights, sampled one by one."""
    nominal = learn(CASES[name].problem, solver)
    return sample(nominal, CASES[name].tasks, NUM, method="importance", seed=1)


def entered_by(evidence: Evidence, k: int) -> np.ndarray:
    """Return which hypotheses [N, H] the trajectories of a task enter."""
    return unpack(evidence.samples.violations[k], len(evidence.problem.hypotheses))


def weights_avoiding(evidence: Evidence, k: int, avoiding: Sequence[int]) -> np.ndarray:
    """Return log-weights [N] of the trajectories of a task, -inf where one enters any of a set."""
    entered = entered_by(evidence, k)[:, list(avoiding)].any(axis=1)
    return np.where(entered, -np.inf, evidence.log_weight[k])


def spread_of(log_weight: np.ndarray) -> float:
    """Return the standard error of the log of a mean of weights, at most as of counting them."""
    ess = estimators.effective_sample_size(log_weight)
    return math.sqrt(max(1.0 / ess - 1.0 / len(log_weight), 0.0))
