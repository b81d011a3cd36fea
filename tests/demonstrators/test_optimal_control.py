"""Optimal control: exact optima where they are known; nothing is entered; errors without a path."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from swerve import (
    MDP,
    ActionBox,
    Ball,
    Box,
    HalfSpace,
    Polygon,
    Predicate,
    Problem,
    StateAction,
    Task,
    Union,
    grid,
    optimal_control,
)
from swerve.base.space import Actions
from swerve.constraints.base import Constraint, violates
from swerve.demonstrators import optimal_control as module
from swerve.demonstrators import path_search
from swerve.demonstrators.transcription import Transcription
from swerve.systems.pendulum import pendulum

FREE = (-np.inf, np.inf)
NOWHERE = Box(x=(50.0, 51.0))


class Puck(MDP):
    """A puck on ice that is pushed in two directions and is to stop at its goal.

    s' = A s + B a, so without limits and obstacles least squares gives the optimum.
    """

    num_steps: int = eqx.field(default=20, static=True)
    line: float = eqx.field(default=99.0, static=True)  # of x, where episodes end

    state_names = ("x", "y", "vx", "vy")
    action_names = ("ax", "ay")
    actions = jnp.array([[-1.0, 0.0], [0.0, -1.0], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    bounds = ((-3.0, 3.0), (-3.0, 3.0), (-2.0, 2.0), (-2.0, 2.0))
    dt: float = eqx.field(default=0.2, static=True)

    def dynamics(self, state, action):
        speed = state[2:] + self.dt * action
        return jnp.concatenate([state[:2] + self.dt * speed, speed])

    def reward(self, state, action, next_state, goal):
        return -jnp.sum(action**2) * self.dt

    def terminal_reward(self, state, goal):
        return -100.0 * jnp.sum((state - goal) ** 2)

    def terminated(self, state, goal):
        return state[0] >= self.line


class Throw(Puck):
    """A puck that is to reach a position at any speed."""

    goal_names = ("x", "y")

    def terminal_reward(self, state, goal):
        return -100.0 * jnp.sum((state[:2] - goal) ** 2)


PUCK = Problem(Puck(), grid(x=(-3.0, 3.0, 3)))
ACROSS = Task(np.array([-1.5, 0.1, 0.0, 0.0]), np.array([1.5, 0.0, 0.0, 0.0]))


def least_squares(task: Task) -> float:
    """Return the largest reward by least squares: weights times (actions, miss at the end)."""
    mdp, (n, m), num = PUCK.mdp, (4, 2), PUCK.mdp.num_steps
    step = np.eye(n)
    step[0, 2] = step[1, 3] = mdp.dt
    push = np.zeros((n, m))
    push[:2] = mdp.dt**2 * np.eye(2)
    push[2:] = mdp.dt * np.eye(2)
    powers = [np.linalg.matrix_power(step, k) for k in range(num + 1)]
    reach = np.concatenate([powers[num - 1 - k] @ push for k in range(num)], axis=1)
    rows = np.concatenate([np.sqrt(mdp.dt) * np.eye(m * num), 10.0 * reach])
    miss = task.goal - powers[num] @ task.start
    target = np.concatenate([np.zeros(m * num), 10.0 * miss])
    best = np.linalg.lstsq(rows, target, rcond=None)[0]
    return -float(np.sum((rows @ best - target) ** 2))


def densely(states: np.ndarray, num: int = 200) -> np.ndarray:
    """Return points of the straight lines between states [T+1, n]."""
    share = np.linspace(0.0, 1.0, num)[:, None, None]
    return (states[:-1] + share * np.diff(states, axis=0)).reshape(-1, states.shape[1])


class TestOptimum:
    def test_is_that_of_least_squares_with_nothing_in_the_way(self) -> None:
        (found,) = optimal_control(PUCK, NOWHERE, ACROSS, limits=FREE, num_guesses=3)
        assert found.reward == pytest.approx(least_squares(ACROSS), rel=1e-5)
        assert found.rewards == (found.reward,)  # there is one optimum
        assert found.num_guesses == 3
        assert found.endings == {"Solve_Succeeded": 3}

    def test_its_reward_is_what_its_actions_earn(self) -> None:
        (found,) = optimal_control(PUCK, Ball(0.6, x=0.0, y=0.0), ACROSS, limits=FREE)
        item, mdp = found.demonstration, PUCK.mdp
        assert item.actions is not None
        assert item.times is not None
        state, total = jnp.asarray(item.task.start, jnp.float32), 0.0
        for action, expected in zip(item.actions, item.states[1:], strict=True):
            after = mdp.dynamics(state, jnp.asarray(action, jnp.float32))
            total += float(mdp.reward(state, action, after, item.task.goal))
            np.testing.assert_allclose(after, expected, atol=1e-4)
            state = after
        total += float(mdp.terminal_reward(state, item.task.goal))
        assert found.reward == pytest.approx(total, rel=1e-3)
        np.testing.assert_allclose(item.times, 0.2 * np.arange(21))

    @pytest.mark.parametrize(
        "constraint",
        [
            Box(x=(-0.5, 0.5), y=(-0.7, 0.4)),
            Box(x=(-0.5, 0.5), y=(-0.7, 0.4), vx=(0.2, 9.0)),
            Ball(0.6, x=0.0, y=0.0),
            HalfSpace(0.8, vx=1.0, y=-0.5),
            Polygon([(-0.5, -0.5), (0.0, -0.2), (0.5, -0.5), (0.3, 0.4), (-0.3, 0.4)]),
            Union("two", [Ball(0.4, x=-0.6, y=0.2), Box(x=(0.2, 0.8), y=(-0.6, 0.2))]),
            ActionBox(ax=(0.1, 0.5)),
            StateAction(Box(x=(-0.5, 0.5)), ActionBox(ax=(-0.25, 0.25))),
        ],
        ids=lambda c: c.name,
    )
    def test_keeps_out_of_every_kind_and_pays_for_it(self, constraint: Constraint) -> None:
        (found,) = optimal_control(PUCK, constraint, ACROSS, limits=FREE, goal_tolerance=0.2)
        item, space = found.demonstration, PUCK.mdp.space
        assert item.actions is not None
        actions = Actions(("ax", "ay"), item.actions)
        assert not violates(constraint, item.states, space, True, actions)
        assert not constraint.contains(densely(item.states), space).any()
        assert found.reward < least_squares(ACROSS) - 1e-3

    def test_passes_on_the_better_side(self) -> None:
        for side in (1.0, -1.0):
            low = Box(x=(-0.4, 0.4), y=(-1.2, 0.3) if side > 0 else (-0.3, 1.2))
            (found,) = optimal_control(PUCK, low, ACROSS, limits=FREE)
            states = densely(found.demonstration.states)
            assert (side * states[np.abs(states[:, 0]) < 0.3, 1] > 0.2).all()
            assert len(found.rewards) > 1  # the other side was found as well

    def test_is_as_good_as_passing_points_tells(self) -> None:
        """Around a wall's end the best path passes exactly at the end."""
        wall = Box(x=(-0.02, 0.02), y=(-9.0, 0.8))
        (found,) = optimal_control(PUCK, wall, ACROSS, limits=FREE)
        free = least_squares(ACROSS)
        assert free - 3.0 < found.reward < free
        states = densely(found.demonstration.states)
        near = np.abs(states[:, 0]) < 0.02
        assert states[near, 1].min() == pytest.approx(0.8, abs=1e-3)  # no wider than need be

    def test_keeps_to_limits_and_known_constraints(self) -> None:
        known = Problem(PUCK.mdp, PUCK.hypotheses, known=[Ball(0.5, x=0.0, y=0.2)])
        (found,) = optimal_control(known, Box(x=(-0.4, 0.4), y=(-1.0, 0.0)), ACROSS)
        item = found.demonstration
        assert item.actions is not None
        assert np.abs(item.actions).max() <= 1.0 + 1e-6
        for constraint in (*known.known, Box(x=(-0.4, 0.4), y=(-1.0, 0.0))):
            assert not violates(constraint, item.states, known.mdp.space, True)

    def test_a_goal_that_is_a_position_is_come_to_at_any_speed(self) -> None:
        problem, task = Problem(Throw(), PUCK.hypotheses), Task(ACROSS.start, ACROSS.goal[:2])
        (found,) = optimal_control(problem, Ball(0.4, x=0.0, y=0.0), task, limits=FREE)
        end = found.demonstration.states[-1]
        assert np.linalg.norm(end[:2] - task.goal) < 0.05
        assert end[2] > 0.5
        with pytest.raises(ValueError, match=r"ends [\d.]+ from the goal"):
            optimal_control(problem, NOWHERE, task, limits=(-0.1, 0.1), num_guesses=2)

    def test_an_angle_may_turn_either_way(self) -> None:
        problem = pendulum(10.0)
        task = Task(np.array([2.2, 0.3]), np.array([4.2, 0.0]))
        cell = problem.hypotheses.constraint(55)
        (found,) = optimal_control(problem, cell, task, limits=FREE)
        assert len(found.rewards) >= 3
        assert not violates(cell, found.demonstration.states, problem.mdp.space, True)

    def test_is_the_same_again(self) -> None:
        first, second = (
            optimal_control(PUCK, Ball(0.6, x=0.0, y=0.0), ACROSS, limits=FREE) for _ in range(2)
        )
        np.testing.assert_array_equal(first[0].demonstration.states, second[0].demonstration.states)

    def test_names_and_order_of_many(self) -> None:
        tasks = [ACROSS, Task(ACROSS.goal, ACROSS.start)]
        found = optimal_control(PUCK, NOWHERE, tasks, limits=FREE, names=["to", "fro"])
        assert [item.demonstration.name for item in found] == ["to", "fro"]
        np.testing.assert_allclose(found[1].demonstration.states[0], ACROSS.goal)


class TestRealTasks:
    def test_at_least_as_good_as_the_authors(self, shared_data: Path) -> None:
        """No violation, ends within 0.05 of the goal, rewards at least the authors' in 30 of 33."""
        folder, problem = shared_data / "pendulum", pendulum(10.0)
        cell = problem.hypotheses.constraint(55)
        with (folder / "tasks.csv").open() as file:
            rows = list(csv.DictReader(file))
        start, goal = (
            np.array([[float(row[f"{end}_{name}"]) for name in ("theta", "omega")] for row in rows])
            for end in ("start", "goal")
        )
        found = optimal_control(problem, cell, Task(start, goal), limits=FREE)
        num_better = 0
        for row, item in zip(rows, found, strict=True):
            states = item.demonstration.states
            assert not violates(cell, states, problem.mdp.space, True)
            missed = problem.mdp.space.difference(states[-1], item.demonstration.task.goal)
            assert np.linalg.norm(missed) <= 0.05
            theirs = np.genfromtxt(folder / f"demo_{row['demo']}.csv", delimiter=",", names=True)
            end = np.array([theirs["theta"][-1], theirs["omega"][-1]])
            miss = problem.mdp.space.difference(end, item.demonstration.task.goal)
            charged = np.trapezoid(theirs["torque"] ** 2, theirs["t"])
            num_better += item.reward >= -80.0 * float(miss @ miss) - 0.05 * charged
        assert num_better >= 30


RING = r"demo_000: from start .* no path was found .* 3 guesses|ends [\d.]+ from the goal"


class TestRefusals:
    def test_a_start_inside_is_named_before_the_work(self) -> None:
        tasks = [ACROSS, Task(np.zeros(4), ACROSS.goal)]
        message = r"demo_001: task 1 starts at \[0.0, .*inside ball .*start"
        with pytest.raises(ValueError, match=message):
            optimal_control(PUCK, Ball(0.6, x=0.0, y=0.0), tasks)

    def test_a_goal_that_is_walled_in(self) -> None:
        ring = Union(
            "ring",
            [
                Box(x=(0.8, 1.0), y=(-1.0, 1.0)),
                Box(x=(2.0, 2.2), y=(-1.0, 1.0)),
                Box(x=(0.8, 2.2), y=(0.8, 1.0)),
                Box(x=(0.8, 2.2), y=(-1.0, -0.8)),
            ],
        )
        with pytest.raises(ValueError, match=RING):
            optimal_control(PUCK, ring, ACROSS, limits=FREE, num_guesses=3)

    def test_a_goal_that_is_out_of_reach(self) -> None:
        with pytest.raises(ValueError, match=r"ends [\d.]+ from the goal, more than goal_toleran"):
            optimal_control(PUCK, NOWHERE, ACROSS, limits=(-0.1, 0.1))

    def test_a_constraint_that_holds_everything_else(self) -> None:
        trap = Box(x=(-1.4, 9.0))
        moving = Task(np.array([-1.5, 0.0, 2.0, 0.0]), ACROSS.goal)
        with pytest.raises(ValueError, match=r"no path was found that avoids x \[-1.4, 9\)"):
            optimal_control(PUCK, trap, moving, num_guesses=2)

    def test_an_episode_that_ends_early(self) -> None:
        problem = Problem(Puck(line=0.0), PUCK.hypotheses)
        with pytest.raises(ValueError, match=r"Ends_Early.*choose fewer num_steps than 20"):
            optimal_control(problem, NOWHERE, ACROSS, limits=FREE, num_guesses=2)

    def test_what_has_no_sides(self) -> None:
        with pytest.raises(ValueError, match="expected a constraint with sides"):
            optimal_control(PUCK, Predicate("right", lambda s: s[..., 0] > 0.0), ACROSS)

    @pytest.mark.parametrize(
        ("constraint", "message"),
        [
            (Box(z=(0.0, 1.0)), "z"),
            (ActionBox(push=(0.0, 1.0)), "push"),
            (ActionBox(ax=(-np.inf, np.inf)), "forbids everything"),
        ],
    )
    def test_a_constraint_of_another_system(self, constraint: Constraint, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            optimal_control(PUCK, constraint, ACROSS)

    def test_an_angle_has_no_sides(self) -> None:
        task = Task(np.array([2.2, 0.3]), np.array([4.2, 0.0]))
        with pytest.raises(ValueError, match="theta"):
            optimal_control(pendulum(10.0), HalfSpace(3.5, theta=1.0), task)

    def test_a_path_that_the_dynamics_do_not_make(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A wrong expression of the dynamics is an error, not a demonstration."""

        def wrong(mdp: MDP, num_steps: int, limits: np.ndarray) -> object:
            return Transcription(Puck(dt=0.25), num_steps, limits)

        monkeypatch.setattr(path_search, "_transcription", lambda: wrong)
        with pytest.raises(ValueError, match=r"2 Unlike_Dynamics.*write dynamics with arithmetic"):
            optimal_control(PUCK, NOWHERE, ACROSS, limits=FREE, num_guesses=2)

    def test_those_that_can_be_done_are_kept(self) -> None:
        trap = Box(x=(-1.4, 9.0))
        doomed = Task(np.array([-1.5, 0.0, 2.0, 0.0]), ACROSS.goal)
        back = Task(np.array([-1.5, 0.0, 0.0, 0.0]), np.array([-2.0, 0.0, 0.0, 0.0]))
        tasks = Task.stack([doomed, back, doomed])
        search = path_search.Search(num_guesses=2)
        (found,) = module.first_optima(PUCK, trap, tasks, 1, search)
        assert found.demonstration.task.goal.tolist() == back.goal.tolist()
        assert found.demonstration.name == "demo_000"
        with pytest.raises(module.NoPathError, match="only 1 of 3 tasks can be done, 2 were"):
            module.first_optima(PUCK, trap, tasks, 2, search)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"limits": (1.0, -1.0)}, "limits: expected the least and the largest"),
            ({"limits": 3.0}, "limits: expected"),
            ({"num_steps": 0}, "num_steps: expected"),
            ({"num_guesses": 0}, "num_guesses: expected"),
            ({"goal_tolerance": 0.0}, "goal_tolerance: expected"),
            ({"names": ["a", "b"]}, "names: expected 1"),
        ],
    )
    def test_settings(self, settings: dict, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            optimal_control(PUCK, NOWHERE, ACROSS, **settings)

    def test_a_missing_solver_names_the_extra(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("symbolic", "transcription"):
            monkeypatch.delitem(sys.modules, f"swerve.demonstrators.{name}", raising=False)
        monkeypatch.setitem(sys.modules, "casadi", None)
        with pytest.raises(ImportError, match=r"pip install 'swerve\[control\]'"):
            optimal_control(PUCK, NOWHERE, ACROSS)
