"""The short cart at several betas: its evidence and its demonstrators."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from support.reference import CART_TASK, short_cart

from swerve import Box, Demonstration, Evidence, Nominal, Problem, Task, demonstrate, learn, sample

GRID = "grid?num_points=81"
FAR = Box(x=(50.0, 60.0))  # no constraint at all
CART = short_cart(beta=2.0)
OTHER_TASK = Task(np.array([-0.4, 0.5]), np.array([0.7, 0.0]))


def cooled(problem: Problem, beta: float) -> Problem:
    return dataclasses.replace(problem, beta=beta)


@cache
def nominal(beta: float) -> Nominal:
    return learn(cooled(CART, beta), GRID)


@cache
def sampled(beta: float = 2.0, num: int = 4_000, seed: int = 0) -> Evidence:
    """Evidence of two tasks of the cart."""
    return sample(nominal(beta), [CART_TASK, OTHER_TASK], num, seed=seed)


@cache
def shown(beta: float = 2.0, num: int = 240, task: int = 0, seed: int = 0) -> list[Demonstration]:
    """What demonstrators of one of the tasks do whom nothing holds back."""
    start, goal = (CART_TASK, OTHER_TASK)[task]
    tasks = Task(np.repeat(start[None], num, axis=0), np.repeat(goal[None], num, axis=0))
    return demonstrate(cooled(CART, beta), FAR, tasks, solver=GRID, seed=seed)
