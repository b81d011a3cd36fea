"""Demonstrations of pi_c: they avoid c, and are distributed as enumeration says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from reference import CART_TASK, enumerate_exactly, short_cart

from swerve import Box, Grid, Task, demonstrate
from swerve.constraints import violates
from swerve.hypotheses import unpack
from swerve.tasks import draw_tasks

WALL = Box(x=(-0.2, 0.3), v=(-0.9, 0.1))
GRID = Grid(num_points=81)


def test_demonstrations_follow_the_constrained_distribution() -> None:
    problem = short_cart()
    exact = enumerate_exactly(
        dataclasses.replace(problem, known=[WALL]), CART_TASK.start, CART_TASK.goal
    )
    tasks = Task(*(np.repeat(x[None], 400, axis=0) for x in CART_TASK))
    made = demonstrate(problem, WALL, tasks, solver=GRID)
    space = problem.mdp.space
    assert not any(violates(WALL, d.states, space, True) for d in made)
    bits = np.concatenate(
        [problem.hypotheses.violations(d.states[None], space, True) for d in made]
    )
    share = unpack(bits, len(problem.hypotheses)).mean(axis=0)
    spread = np.sqrt(exact.violation_probability * (1 - exact.violation_probability) / 400)
    assert np.abs((share - exact.violation_probability) / (spread + 1 / 400)).max() < 4.0


def test_a_demonstration_is_what_the_dynamics_make_of_its_actions() -> None:
    problem = short_cart()
    for item in demonstrate(problem, WALL, draw_tasks(problem, 3, avoid=[WALL]), solver=GRID):
        assert item.actions is not None
        assert item.times is not None
        np.testing.assert_allclose(item.states[0], item.task.start, rtol=1e-6)
        for state, action, following in zip(
            item.states[:-1], item.actions, item.states[1:], strict=True
        ):
            np.testing.assert_allclose(
                problem.mdp.dynamics(state, action), following, rtol=1e-5, atol=1e-5
            )
        np.testing.assert_allclose(np.diff(item.times), problem.mdp.dt)


def test_drawn_tasks_can_be_done() -> None:
    """They start outside the constraint, where the episode is not over already."""
    half = Box(x=(-5.0, 0.0))
    tasks = draw_tasks(short_cart(), 50, avoid=[half])
    assert (tasks.start[:, 0] >= 0.0).all()
    assert (tasks.goal[:, 0] >= 0.0).all()
    assert (np.abs(tasks.start[:, 0]) <= 1.5).all()
    assert len(np.unique(tasks.start[:, 0])) == 50


def test_a_constraint_everywhere_is_refused() -> None:
    with pytest.raises(ValueError, match=r"only 0 of .* tasks drawn from Cart"):
        draw_tasks(short_cart(), 2, avoid=[Box(x=(-9.0, 9.0))])


def test_a_task_that_cannot_avoid_the_constraint_is_named() -> None:
    trap = Box(x=(0.65, 9.0))  # too close to brake before it
    task = Task(np.array([[0.6, 1.2]]), np.array([[0.0, 0.0]]))
    with pytest.raises(ValueError, match=r"demo_000: from start \[0.6, 1.2\].*another task"):
        demonstrate(short_cart(), trap, task, solver=GRID)


def test_a_start_inside_the_constraint_is_named() -> None:
    task = Task(np.array([[1.0, 0.0], [0.1, -0.5]]), np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"task 1 starts at \[0.1, -0.5\], inside x .* keep out"):
        demonstrate(short_cart(), WALL, task, solver=GRID)
