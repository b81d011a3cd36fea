"""Soft shortest paths: sums over walks of any length agree with the exact finite horizon."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import swerve
from swerve.base.space import Task
from swerve.constraints.occupancy import Occupancy
from swerve.problem.problem import Problem
from swerve.solvers.exact.discrete import Discrete
from swerve.solvers.exact.soft_paths import SoftPaths
from swerve.solvers.exact.tabular import Tabular
from swerve.solvers.exact.walks import Ends, Steps, Walks
from swerve.systems.gridworld import Gridworld
from swerve.systems.walker import Walker

BOUNDS = ((-0.75, 3.75), (-0.75, 3.75))
TASK = Task(np.array([0.35, 0.4]), np.array([2.6, 2.4]))
WINDOWS = [
    swerve.Box(x=(x, x + 0.75), y=(y, y + 0.75)) for x in (0.6, 1.1, 1.6) for y in (0.5, 1.2, 1.9)
]


def room(beta: float = 9.0, num_steps: int = 300, **settings: Any) -> Problem:
    """Return a walker in a room of 3 m x 3 m with a wall that reaches out into it."""
    blocked = np.zeros((30, 30), bool)
    blocked[18:20, :12] = True
    walls = Occupancy("walls", blocked, (0.0, 0.0), 0.1)
    walker = Walker(bounds=BOUNDS, num_steps=num_steps)
    chosen: dict[str, Any] = {"measure": "counting", "known": [walls], **settings}
    return Problem(walker, WINDOWS, beta=beta, **chosen)


@pytest.mark.parametrize("measure", ["counting", "uniform"])
def test_it_agrees_with_a_horizon_that_ends_no_walk(measure: str) -> None:
    problem = room(measure=measure)
    finite = Discrete(num_cells=Walker(bounds=BOUNDS).num_cells, hold=1).learn(problem)
    expected = finite.answer(TASK, np.random.default_rng(0))
    got = SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))
    assert got.log_partition == pytest.approx(expected.log_partition, abs=1e-9)
    assert np.ptp(expected.log_ratio) > 1.0
    np.testing.assert_allclose(got.log_ratio, expected.log_ratio, rtol=0, atol=1e-8)


def test_hypotheses_already_obeyed_are_in_force() -> None:
    problem = room()
    finite = Discrete(num_cells=Walker(bounds=BOUNDS).num_cells, hold=1).learn(problem)
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
    mdp = Gridworld(6, 5, 200, -3.0, walls=((2, 1), (2, 2), (2, 3)))
    problem = Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False)
    task = Task(np.array([0.0, 2.0]), np.array([5.0, 2.0]))
    expected = Tabular().learn(problem).answer(task, np.random.default_rng(0))
    got = SoftPaths().learn(problem).answer(task, np.random.default_rng(0))
    assert got.log_partition == pytest.approx(expected.log_partition, abs=1e-9)
    assert np.isneginf(expected.log_ratio).any()
    np.testing.assert_allclose(got.log_ratio, expected.log_ratio, rtol=0, atol=1e-8)


def test_what_is_drawn_comes_from_pi_0() -> None:
    problem = room(beta=12.0)
    nominal = SoftPaths().learn(problem)
    answer = nominal.answer(TASK, np.random.default_rng(0))
    drawn, generator = answer.kept, np.random.default_rng(1)
    entered = [swerve.sample(nominal, TASK, seed=1).samples.violations[0]]
    entered += [nominal.answer(TASK, generator).kept.violations for _ in range(9)]
    share = np.unpackbits(np.concatenate(entered), axis=1, count=9, bitorder="little").mean(axis=0)
    error = np.sqrt(answer.avoid_probability * (1.0 - answer.avoid_probability) / 1000.0)
    assert (np.abs(share - (1.0 - answer.avoid_probability)) < 4.0 * error + 1e-9).all()
    steps = np.linalg.norm(np.diff(drawn.states, axis=1), axis=2)
    np.testing.assert_allclose(drawn.total_reward, -steps.sum(axis=1), rtol=1e-5)
    assert ((steps > 0.0).sum(axis=1) == drawn.length).all()
    ends = drawn.states[:, -1]
    assert (np.linalg.norm(ends - TASK.goal, axis=1) < 0.3).all()


def test_digits_that_cancel_are_worked_out_again() -> None:
    """A square in the gap beside the wall leaves only a long way round, if any."""
    gap = swerve.Box(x=(1.15, 2.9), y=(1.5, 2.3))
    problem = Problem(room().mdp, [gap, *WINDOWS], 24.0, "counting", room().known)
    finite = Discrete(num_cells=Walker(bounds=BOUNDS).num_cells, hold=1).learn(problem)
    expected = finite.answer(TASK, np.random.default_rng(0)).log_ratio
    got = SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0)).log_ratio
    assert expected[0] < np.log(1e-8)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7)


def test_both_ways_to_take_steps_away_are_sums_over_the_walks_that_are_left() -> None:
    generator, num = np.random.default_rng(0), 7
    source, target = (part.reshape(-1) for part in np.indices((num, num)))
    weight = generator.uniform(0.0, 0.25, num * num) * (generator.random(num * num) < 0.6)
    entering = [np.flatnonzero(target == 2), np.flatnonzero(source == 3), np.array([4, 11, 30])]
    walks = Walks(Steps(source, target, num, entering), weight)
    ends = Ends(np.array([5, 6]), np.array([1.0, 0.3]))
    expected = []
    for taken in entering:
        matrix = np.where(np.isin(np.arange(num * num), taken), 0.0, weight).reshape(num, num)
        before = matrix[:5]  # whoever comes to an end goes no further
        inner = np.linalg.inv(np.eye(5) - before[:, :5])
        expected.append((inner @ before[:, 5:] @ ends.weight)[0])
    np.testing.assert_allclose(walks.avoiding(0, ends), expected, rtol=1e-12)
    again = [walks._solved(0, ends, taken) for taken in entering]
    np.testing.assert_allclose(again, expected, rtol=1e-12)


def test_nobody_can_avoid_the_square_around_the_start() -> None:
    around = swerve.Box(x=(0.2, 0.6), y=(0.2, 0.6))
    problem = Problem(room().mdp, [around, *WINDOWS], 9.0, "counting", room().known)
    answer = SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))
    assert np.isneginf(answer.log_ratio[0])
    assert np.isfinite(answer.log_ratio[1:]).all()


def test_another_beta_shares_what_does_not_depend_on_it() -> None:
    cold = SoftPaths().learn(room(beta=9.0)).at_beta(14.0)
    expected = SoftPaths().learn(room(beta=14.0))
    tasks = Task.stack([TASK, Task(TASK.goal, TASK.start)])
    np.testing.assert_array_equal(cold.log_ratio(tasks), expected.log_ratio(tasks))
    conditional = expected.answer(TASK, np.random.default_rng(0), avoiding=[4]).log_ratio
    np.testing.assert_array_equal(cold.log_ratio(tasks, [4])[0], conditional)


def test_below_the_least_beta_there_is_no_sum() -> None:
    walker = Walker(bounds=BOUNDS)
    problem = room(beta=0.8 * walker.least_beta)
    with pytest.raises(ValueError, match=r"beta 6\.04.* with the counting measure: longer and lo"):
        SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))
    uniform = SoftPaths().learn(room(beta=0.8 * walker.least_beta, measure="uniform"))
    assert np.isfinite(uniform.answer(TASK, np.random.default_rng(0)).log_ratio).all()


def test_a_horizon_that_ends_walks_is_told() -> None:
    with pytest.raises(ValueError, match=r"walks are longer than the horizon of 14 steps"):
        SoftPaths().learn(room(num_steps=14)).answer(TASK, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((0.35, 0.4), (0.6, 1.9), "no state that can be entered is at the goal"),
        ((-0.6, 3.7), (2.6, 2.4), "no step can be taken near the start"),
    ],
)
def test_tasks_that_nobody_has(start: tuple, goal: tuple, message: str) -> None:
    blocked = np.zeros((30, 30), bool)
    blocked[14:24, :12] = True
    walls = Occupancy("walls", blocked, (0.0, 0.0), 0.1)
    problem = Problem(room().mdp, WINDOWS, 9.0, "counting", [walls])
    task = Task(np.array(start), np.array(goal))
    with pytest.raises(ValueError, match=message):
        SoftPaths().learn(problem).answer(task, np.random.default_rng(0))


def test_a_room_cut_in_two() -> None:
    blocked = np.zeros((30, 30), bool)
    blocked[18:20] = True
    walls = Occupancy("walls", blocked, (0.0, 0.0), 0.1)
    problem = Problem(room().mdp, WINDOWS, 9.0, "counting", [walls])
    with pytest.raises(ValueError, match=r"no walk has any weight, Z = 0: known constraints"):
        SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))


class Impatient(Walker):
    """A walker who minds every step away from the goal."""

    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        """Return minus the length of the step and the way still to go."""
        return -jnp.linalg.norm(action) - jnp.linalg.norm(goal - next_state)


def test_rewards_and_ends_that_it_cannot_take() -> None:
    problem = Problem(Impatient(bounds=BOUNDS), WINDOWS, 9.0, "counting", room().known)
    with pytest.raises(ValueError, match="rewards that do not depend on the goal"):
        SoftPaths().learn(problem).answer(TASK, np.random.default_rng(0))
    chain = swerve.tabular(np.array([[1], [1]]), np.array([-1.0, -1.0]), num_steps=5)
    problem = Problem(chain, [swerve.Box(state=(0.5, 1.5))], measure="counting")
    task = Task(np.zeros(1), np.zeros(0))
    with pytest.raises(ValueError, match="terminal_reward of -inf where an episode has not ended"):
        SoftPaths().learn(problem).answer(task, np.random.default_rng(0))
