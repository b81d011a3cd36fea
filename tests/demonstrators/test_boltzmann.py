"""Demonstrations of pi_c avoid c, and follow the distribution that enumeration gives."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
from support.reference import CART_TASK, enumerate_exactly, short_cart

from swerve import (
    Box,
    Grid,
    Gridworld,
    Pendulum,
    Problem,
    SoftValue,
    Task,
    Union,
    demonstrate,
    grid,
    learn,
)
from swerve.constraints.base import violates
from swerve.hypotheses.bits import unpack
from swerve.problem.tasks import draw_tasks

WALL = Box(x=(-0.2, 0.3), v=(-0.9, 0.1))
GRID = Grid(num_points=81)
NETWORK = SoftValue(num_steps=400_000)


@pytest.mark.parametrize("by", ["grid", "soft-value", "nominal of soft-value", "resampled"])
def test_demonstrations_follow_the_constrained_distribution(
    by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = short_cart()
    settings: dict = {"solver": GRID}
    if by == "soft-value":
        settings = {"solver": NETWORK}
    elif by == "nominal of soft-value":
        settings = {"nominal": learn(problem, NETWORK)}
    elif by == "resampled":
        monkeypatch.setattr("swerve.demonstrators.boltzmann.ENOUGH", 2.0)
    exact = enumerate_exactly(
        dataclasses.replace(problem, known=[WALL]), CART_TASK.start, CART_TASK.goal
    )
    tasks = Task(*(np.repeat(x[None], 400, axis=0) for x in CART_TASK))
    made = demonstrate(problem, WALL, tasks, **settings)
    space = problem.mdp.space
    assert not any(violates(WALL, d.states, space, True) for d in made)
    bits = np.concatenate(
        [problem.hypotheses.violations(d.states[None], space, True) for d in made]
    )
    share = unpack(bits, len(problem.hypotheses)).mean(axis=0)
    spread = np.sqrt(exact.violation_probability * (1 - exact.violation_probability) / 400)
    assert np.abs((share - exact.violation_probability) / (spread + 1 / 400)).max() < 4.0


def test_on_tables_they_follow_it_exactly() -> None:
    """Frequencies of the paths that avoid the cell are proportional to exp(beta R)."""
    mdp = Gridworld(width=3, height=3, num_steps=4, step_reward=-1.0)
    problem = Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False)
    middle = problem.hypotheses.constraint(4)
    task = Task(np.array([0.0, 0.0]), np.array([2.0, 2.0]))
    made = demonstrate(problem, middle, [task] * 600)
    counts = Counter(tuple(map(tuple, item.states.tolist())) for item in made)
    assert all((1.0, 1.0) not in path for path in counts)
    weight = {path: np.exp(-(len(path) - 1.0)) for path in counts}
    assert sorted(len(path) - 1 for path in counts) == [
        3,
        3,
        4,
        4,
        4,
        4,
        4,
        4,
    ]  # every path that avoids the cell
    expected = 600 * np.array(list(weight.values())) / sum(weight.values())
    chi_squared = ((np.array(list(counts.values())) - expected) ** 2 / expected).sum()
    assert chi_squared < 24.3  # 7 degrees of freedom, p = 0.001
    wall = Union("wall", [problem.hypotheses.constraint(k) for k in (1, 3, 4)])
    with pytest.raises(ValueError, match="no trajectory of 4 steps avoids wall: choose another"):
        demonstrate(problem, wall, task)
    for item in made[:5]:
        np.testing.assert_array_equal(np.diff(item.states, axis=0), item.actions)


def test_other_solvers_and_nominals_are_refused() -> None:
    problem = short_cart()
    other = learn(Problem(Pendulum(), grid(theta=(0.0, 6.0, 2))), GRID)
    hotter = learn(dataclasses.replace(problem, beta=0.5 * problem.beta), GRID)
    for settings, message in [
        ({"solver": "ppo"}, "solver: expected one of grid, soft-value, tabular .*'ppo'"),
        ({"solver": 7}, "solver: expected one of grid, soft-value, tabular .*got 7"),
        ({"solver": GRID, "nominal": other}, "a solver or a nominal, not both"),
        ({"nominal": other}, "the same MDP, beta and measure: Cart.*got one of Pendulum"),
        ({"nominal": hotter}, "the same MDP, beta and measure: Cart.*; got one of Cart"),
        ({"nominal": learn(problem, "enumeration")}, "grid or soft-value learned.*enumeration"),
        ({"nominal": problem}, "grid or soft-value learned, got"),
    ]:
        with pytest.raises(ValueError, match=message):
            demonstrate(problem, WALL, CART_TASK, **settings)


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


def test_sampled_tasks_can_be_done() -> None:
    """Tasks start outside the constraint, in states where the episode goes on."""
    half = Box(x=(-5.0, 0.0))
    tasks = draw_tasks(short_cart(), 50, avoid=[half])
    assert (tasks.start[:, 0] >= 0.0).all()
    assert (tasks.goal[:, 0] >= 0.0).all()
    assert (np.abs(tasks.start[:, 0]) <= 1.5).all()
    assert len(np.unique(tasks.start[:, 0])) == 50


def test_a_constraint_everywhere_is_refused() -> None:
    with pytest.raises(ValueError, match=r"only 0 of .* tasks sampled from Cart"):
        draw_tasks(short_cart(), 2, avoid=[Box(x=(-9.0, 9.0))])


def test_a_task_that_cannot_avoid_the_constraint_is_named() -> None:
    trap = Box(x=(0.65, 9.0))  # too close to brake before it
    task = Task(np.array([[0.6, 1.2]]), np.array([[0.0, 0.0]]))
    with pytest.raises(ValueError, match=r"demo_000: from start \[0.6, 1.2\].*another task"):
        demonstrate(short_cart(), trap, task, solver=GRID)


def test_a_start_inside_the_constraint_is_named() -> None:
    task = Task(np.array([[1.0, 0.0], [0.1, -0.5]]), np.zeros((2, 2)))
    with pytest.raises(
        ValueError, match=r"task 1 starts at \[0.1, -0.5\], inside x .* must not enter"
    ):
        demonstrate(short_cart(), WALL, task, solver=GRID)
