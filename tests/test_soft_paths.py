"""Soft shortest paths: sums over walks of any length agree with the exact finite horizon."""

from __future__ import annotations

import numpy as np
import pytest

import swerve
from swerve.occupancy import Occupancy
from swerve.problem import Problem
from swerve.solvers.discrete import Discrete
from swerve.solvers.soft_paths import SoftPaths
from swerve.solvers.tabular import Tabular
from swerve.space import Task
from swerve.systems.gridworld import Gridworld
from swerve.systems.walker import Walker

TASK = Task(np.array([0.35, 0.4]), np.array([2.6, 2.4]))
WINDOWS = [
    swerve.Box(x=(x, x + 0.75), y=(y, y + 0.75)) for x in (0.6, 1.1, 1.6) for y in (0.5, 1.2, 1.9)
]


def room(beta: float = 9.0, num_steps: int = 300, **settings: object) -> Problem:
    """Return a walker in a room of 3 m x 3 m with a wall that reaches out into it."""
    blocked = np.zeros((30, 30), bool)
    blocked[18:20, :12] = True
    walls = Occupancy("walls", blocked, (0.0, 0.0), 0.1)
    walker = Walker(bounds=((-0.75, 3.75), (-0.75, 3.75)), num_steps=num_steps)
    chosen = {"measure": "counting", "known": [walls], **settings}
    return Problem(walker, WINDOWS, beta=beta, **chosen)


@pytest.mark.parametrize("measure", ["counting", "uniform"])
def test_it_agrees_with_a_horizon_that_ends_no_walk(measure: str) -> None:
    problem = room(measure=measure)
    finite = Discrete(num_cells=problem.mdp.num_cells, hold=1).learn(problem)
    expected = finite.answer(TASK, np.random.default_rng(0))
    got = SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))
    assert got.log_partition == pytest.approx(expected.log_partition, abs=1e-9)
    assert np.ptp(expected.log_ratio) > 1.0
    np.testing.assert_allclose(got.log_ratio, expected.log_ratio, rtol=0, atol=1e-8)


def test_hypotheses_already_obeyed_are_in_force() -> None:
    problem = room()
    finite = Discrete(num_cells=problem.mdp.num_cells, hold=1).learn(problem)
    nominal = SoftPaths().learn(problem)
    first = nominal.answer(TASK, np.random.default_rng(0))
    for avoiding in ([4], [1, 5]):
        expected = finite.answer(TASK, np.random.default_rng(0), avoiding=avoiding)
        got = nominal.answer(TASK, np.random.default_rng(0), avoiding=avoiding)
        assert got.log_partition == pytest.approx(expected.log_partition, abs=1e-9)
        np.testing.assert_allclose(got.log_ratio, expected.log_ratio, rtol=0, atol=1e-8)
    again = nominal.answer(TASK, np.random.default_rng(0))
    np.testing.assert_array_equal(again.log_ratio, first.log_ratio)


def test_a_gridworld_is_its_own_table() -> None:
    mdp = Gridworld(6, 5, num_steps=200, step_reward=-3.0, walls=((2, 1), (2, 2), (2, 3)))
    problem = Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False)
    task = Task(np.array([0.0, 2.0]), np.array([5.0, 2.0]))
    expected = Tabular().learn(problem).answer(task, np.random.default_rng(0))
    got = SoftPaths().learn(problem).answer(task, np.random.default_rng(0))
    assert got.log_partition == pytest.approx(expected.log_partition, abs=1e-9)
    assert np.isneginf(expected.log_ratio).any()
    np.testing.assert_allclose(got.log_ratio, expected.log_ratio, rtol=0, atol=1e-8)
