"""Discretised dynamics: cells, transitions held for a while, and what they tell."""

from __future__ import annotations

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)

from swerve import (
    MDP,
    Box,
    Demonstration,
    Discrete,
    Gridworld,
    Problem,
    Task,
    grid,
    infer,
    learn,
    sample,
)
from swerve.base.space import TWO_PI, StateSpace
from swerve.solvers.exact.discrete import Cells
from swerve.solvers.exact.tabular import TableNominal

SPACE = StateSpace(("theta", "x"), ("theta",), np.array([[0.0, TWO_PI], [-2.0, 2.0]]))


def test_centres_are_in_their_cells() -> None:
    cells = Cells(SPACE, (7, 4), (np.array([0.0, -2.0]), np.array([TWO_PI, 2.0])))
    np.testing.assert_array_equal(cells.number(cells.centres), np.arange(28))
    turned = cells.centres + np.array([4 * np.pi, 0.0])
    np.testing.assert_array_equal(cells.number(turned), np.arange(28))
    beyond = np.array([[0.1, -9.0], [0.1, 9.0]])
    np.testing.assert_array_equal(cells.number(beyond), [0, 3])


def test_cells_of_a_part() -> None:
    """Of an angle as well, which has ends then: what lies beyond counts as the nearer one."""
    cells = Cells(SPACE, (6, 4), (np.array([-1.5, -1.0]), np.array([1.5, 1.0])))
    np.testing.assert_allclose(cells.centres[[0, -1]], [[-1.25, -0.75], [1.25, 0.75]])
    np.testing.assert_array_equal(cells.number(cells.centres), np.arange(24))
    np.testing.assert_array_equal(
        cells.number(cells.centres + np.array([TWO_PI, 0.0])), np.arange(24)
    )
    beyond = np.array([[2.9, 0.1], [TWO_PI - 2.9, 0.1], [0.1, 9.0]])
    np.testing.assert_array_equal(cells.number(beyond), [22, 2, 15])


def test_the_whole_is_a_part_of_itself() -> None:
    problem, task = short_cart(), CART_TASK
    low, high = (tuple(ends) for ends in problem.mdp.space.bounds.T.tolist())
    whole = sample(learn(problem, "discrete?num_cells=8&hold=1"), task)
    text = ",".join(map(str, low)), ",".join(map(str, high))
    part = sample(learn(problem, f"discrete?num_cells=8&hold=1&low={text[0]}&high={text[1]}"), task)
    np.testing.assert_array_equal(whole.log_ratio, part.log_ratio)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"low": (-np.inf, 0.0)}, "low: expected a finite number for each state"),
        ({"low": 1.0}, "low: expected a finite number for each state"),
        ({"low": (0.0,)}, "low, high: expected where the grid begins and ends for each"),
        ({"low": (3.0, 2.0), "high": (1.0, 3.0)}, "low, high: expected where"),
        ({"low": (0.0, -1.0), "high": (6.5, 1.0)}, "at most a full turn"),
    ],
)
def test_ends_that_are_none(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        learn(short_pendulum(), Discrete(num_cells=8, **settings))


@pytest.mark.parametrize(
    ("problem", "task", "tolerance"),
    [(short_pendulum(), PENDULUM_TASK, 0.08), (short_cart(), CART_TASK, 0.1)],
)
def test_fine_cells_come_near_the_exact_answer(
    problem: Problem, task: Task, tolerance: float
) -> None:
    """And nearer than coarse ones; several hypotheses are neither certain nor rare."""
    exact = enumerate_exactly(problem, task.start, task.goal)
    assert np.count_nonzero(np.abs(exact.violation_probability - 0.5) < 0.4) >= 3
    errors = []
    for num_cells in (8, 160):
        nominal = learn(problem, Discrete(num_cells=num_cells, hold=1))
        evidence = sample(nominal, task)
        errors.append(np.abs(evidence.violation_probability[0] - exact.violation_probability).max())
    assert errors[1] < tolerance
    assert errors[1] < errors[0] / 2
    assert evidence.log_partition[0] == pytest.approx(exact.log_partition, abs=0.1)


def test_a_gridworld_of_cells_is_the_gridworld() -> None:
    """Cells around the lattice points, moves from centre to centre: the tabular answer."""
    world = Gridworld(width=4, height=3, num_steps=5, walls=((1, 1),))
    problem = Problem(world, world.hypotheses(), measure="counting", between_states=False)
    task = Task(np.zeros(2), np.array([3.0, 2.0]))
    exact = sample(learn(problem, "tabular"), task)
    cells = sample(learn(problem, Discrete(num_cells=(4, 3), hold=1)), task)
    np.testing.assert_allclose(cells.log_partition, exact.log_partition, rtol=1e-6)
    np.testing.assert_allclose(
        cells.summary.avoid_probability, exact.summary.avoid_probability, atol=1e-9
    )


class Wind(MDP):
    """Carried along a line, faster further on."""

    state_names = ("x",)
    action_names = ("push",)
    actions = np.array([[0.0], [1.0]])
    bounds = ((0.0, 8.0),)
    dt = 1.0
    num_steps = 4

    def dynamics(self, state, action):
        return state + 0.3 * state + action

    def reward(self, state, action, next_state, goal):
        return -next_state[0]


@pytest.mark.parametrize("hold", [1, 2])
def test_an_action_is_held_and_its_rewards_are_added(hold: int) -> None:
    problem = Problem(Wind(), grid(x=(0.0, 8.0, 8)))
    nominal = learn(problem, Discrete(num_cells=8, hold=hold))
    assert isinstance(nominal, TableNominal)
    table = nominal.goal_table(np.zeros(1))
    assert table.num_steps == 4 // hold
    ends, earned = [], []
    for centre in np.arange(8) + 0.5:
        for push in (0.0, 1.0):
            x, total = centre, 0.0
            for _ in range(hold):
                x = 1.3 * x + push
                total -= x
            ends.append(min(int(x), 7))
            earned.append(total - np.log(2.0))
    np.testing.assert_array_equal(table.successors.ravel(), ends)
    np.testing.assert_allclose(table.reward.ravel(), earned, rtol=1e-5)


class Line(MDP):
    """Steps of 1 to either side; beyond x = 5 the episode ends."""

    state_names = ("x",)
    action_names = ("step",)
    actions = np.array([[-1.0], [1.0]])
    bounds = ((-8.0, 8.0),)
    dt = 1.0
    num_steps = 6

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return -0.5 - 0.1 * action[0]

    def terminal_reward(self, state, goal):
        return 0.2 * state[0]

    def terminated(self, state, goal):
        return state[0] > 5.0


def test_an_episode_may_end_while_an_action_is_held() -> None:
    """By hand: three choices from 2.5, each held for two steps; the fifth ends at 5.5."""
    box = Box(x=(3.9, 5.1))
    problem = Problem(Line(), [box], between_states=False)
    evidence = sample(learn(problem, Discrete(num_cells=16, hold=2)), Task([2.5], [0.0]))
    weight, avoiding, ended_early = {}, {}, 0
    for choices in itertools.product((-1.0, 1.0), repeat=3):
        x, reward, taken, path = 2.5, 0.0, [], [2.5]
        for choice in choices:
            taken.append(choice)
            for _ in range(2):
                if x <= 5.0:
                    x += choice
                    reward += -0.5 - 0.1 * choice
            path.append(x)
            if x > 5.0:
                ended_early += len(taken) < 3
                break
        reward += 0.2 * x
        weight[tuple(taken)] = math.exp(reward) / 2.0 ** len(taken)
        avoiding[tuple(taken)] = not any(3.9 <= x < 5.1 for x in path)
    assert ended_early
    total = sum(weight.values())
    share = sum(weight[key] for key in weight if avoiding[key]) / total
    assert evidence.log_partition[0] == pytest.approx(math.log(total), abs=1e-6)
    assert evidence.summary.avoid_probability[0, 0] == pytest.approx(share, abs=1e-6)
    assert 0.1 < share < 0.9


def test_demonstrations_are_moved_to_cells() -> None:
    nominal = learn(Problem(Line(), [Box(x=(3.0, 4.0))]), Discrete(num_cells=8))
    assert isinstance(nominal, TableNominal)
    task = Task([0.4], [3.7])
    states = np.array([[0.4], [1.1], [1.9], [2.2], [3.7]])  # cells of width 2
    actions, times = np.arange(4.0)[:, None], np.arange(5.0)
    moved = nominal.snapped(Demonstration("d", states, task, times, actions))
    np.testing.assert_array_equal(moved.states, [[1.0], [3.0]])
    np.testing.assert_array_equal(moved.times, [2.0, 4.0])
    np.testing.assert_array_equal(moved.actions, [[2.0]])
    np.testing.assert_array_equal(moved.task.start, [1.0])
    np.testing.assert_array_equal(moved.task.goal, [3.7])
    rests = nominal.snapped(Demonstration("r", states[:3], task, times[:3], actions[:2]))
    np.testing.assert_array_equal(rests.states, [[1.0], [1.0]])
    infer(sample(nominal, [moved.task, rests.task]), [moved, rests])


def test_that_a_table_is_not_the_dynamics_is_said() -> None:
    problem = Problem(Line(), [Box(x=(2.9, 3.1)), Box(x=(0.5, 1.5))])
    evidence = sample(learn(problem, Discrete(num_cells=8)), Task([2.3], [0.0]))
    first, second = infer(evidence).warnings
    assert first.startswith("hypothesis 0 struck out: according to Discrete(")
    assert first.endswith(
        "or the task starts near an edge, and cells are too wide: give the solver more num_cells"
    )
    assert second.startswith("answers are exact for a table of cells, not for the dynamics")


def test_the_majority_of_a_cell_may_go_elsewhere_than_its_centre() -> None:
    class Step(Wind):
        """Only the very middle of a cell stays."""

        def dynamics(self, state, action):
            middle = jnp.abs(state % 1.0 - 0.5) < 0.1
            return state + jnp.where(middle, 0.0, 1.0) * (action + 1.0) * 0.999

    problem = Problem(Step(), grid(x=(0.0, 8.0, 8)))
    tables = {}
    for rule in ("centre", "majority"):
        nominal = learn(problem, Discrete(num_cells=8, hold=1, rule=rule))
        assert isinstance(nominal, TableNominal)
        tables[rule] = nominal.table.successors[2].tolist()
    assert tables == {"centre": [2, 2], "majority": [3, 4]}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rule": "nearest"}, r"Discrete: rule: expected one of .*, got 'nearest'"),
        ({"num_cells": 2.5}, r"Discrete: num_cells: expected a whole number"),
        ({"num_cells": (3, 0)}, r"Discrete: num_cells: .* >= 1, got 0"),
        ({"hold": -1}, r"Discrete: hold: .* >= 0, got -1"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Discrete(**settings)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"one number for each of the states x, v, got \(8,\)"):
        learn(short_cart(), Discrete(num_cells=(8,)))
    with pytest.raises(ValueError, match="hold: expected at most the 7 steps of an episode, got 8"):
        learn(short_cart(), Discrete(hold=8))
    with pytest.raises(ValueError, match=r"need .* GiB, more than 8 GiB"):
        learn(short_cart(), Discrete(num_cells=30_000))

    class Wide(Wind):
        state_names = ("a", "b", "c", "d", "e")
        bounds = ((0.0, 1.0),) * 5

        def reward(self, state, action, next_state, goal):
            return -next_state[0]

        def dynamics(self, state, action):
            return state

    with pytest.raises(ValueError, match="at most 4 state dimensions, Wide has 5"):
        learn(Problem(Wide(), grid(a=(0.0, 1.0, 2))), "discrete")


def test_an_end_that_depends_on_the_goal_needs_short_actions() -> None:
    class Arrive(Wind):
        goal_names = ("x",)

        def terminated(self, state, goal):
            return jnp.abs(state[0] - goal[0]) < 0.6

    problem = Problem(Arrive(), grid(x=(0.0, 8.0, 8)))
    task = Task(np.array([1.0]), np.array([4.0]))
    with pytest.raises(ValueError, match=r"depends on the goal, so .* for 2 steps: set hold=1"):
        sample(learn(problem, Discrete(num_cells=8, hold=2)), task)
    sample(learn(problem, Discrete(num_cells=8, hold=1)), task)


def test_rewards_that_are_no_numbers_are_named() -> None:
    class Broken(Wind):
        def reward(self, state, action, next_state, goal):
            return jnp.where(state[0] > 6.0, jnp.nan, 0.0)

    nominal = learn(Problem(Broken(), grid(x=(0.0, 8.0, 8))), Discrete(num_cells=8, hold=1))
    with pytest.raises(ValueError, match=r"Broken.reward is nan in state \[6.5\]"):
        sample(nominal, Task(np.array([1.0]), np.array([4.0])))


def test_durations_are_those_of_the_system() -> None:
    problem = Problem(Wind(), grid(x=(0.0, 8.0, 8)))
    task = Task(np.array([1.5]), np.array([4.0]))
    for hold in (1, 2):
        evidence = sample(learn(problem, Discrete(num_cells=8, hold=hold)), task)
        assert evidence.summary.shortest[0] == 4.0
