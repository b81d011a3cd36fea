"""The systems that ship move and earn as their formulas say, and are enumerated as such."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force.reference import systems
from brute_force.reference.geometry import Axes
from brute_force.reference.paths import all_paths, log_sum
from brute_force.reference.worlds import TableWorld

from swerve import (
    Car,
    Demonstration,
    DoublePendulum,
    Gridworld,
    Pendulum,
    Problem,
    StateSpace,
    Tabular,
    Task,
    Walker,
    draw_tasks,
    grid,
    learn,
    read_demonstrations,
    rk4,
    sample,
    write_demonstrations,
)

CLOSE = 3e-6  # a step in float32


@pytest.mark.parametrize(
    ("mdp", "derivative"),
    [
        (Pendulum(3.0), systems.pendulum),
        (DoublePendulum(2.0), systems.double_pendulum),
        (Car(dt=0.1), systems.car),
    ],
    ids=lambda item: type(item).__name__,
)
def test_steps(mdp, derivative) -> None:
    generator, low, high = np.random.default_rng(0), *np.array(mdp.bounds).T
    step = jax.jit(mdp.dynamics)
    for _ in range(40):
        state = generator.uniform(low, high).astype(np.float32)
        action = np.asarray(mdp.actions)[generator.integers(mdp.num_actions)]
        rate = lambda s, action=action: derivative(s, action.astype(float))  # noqa: E731
        found = step(state, action)
        once = systems.integrated(rate, state.astype(float), mdp.dt)
        np.testing.assert_allclose(found, once, rtol=CLOSE, atol=CLOSE)
        truly = systems.exactly_integrated(rate, state.astype(float), mdp.dt)
        np.testing.assert_allclose(found, truly, rtol=1e-3, atol=1e-3)


def test_rk4_is_of_fourth_order() -> None:
    rate = lambda s: systems.pendulum(s, np.array([0.5]))  # noqa: E731
    state = np.array([1.0, -0.5])
    for duration in (0.1, 0.7):
        found = rk4(rate, state, duration)  # pyright: ignore[reportArgumentType]
        np.testing.assert_allclose(found, systems.integrated(rate, state, duration), rtol=1e-12)
        truly = systems.exactly_integrated(rate, state, duration)
        assert np.abs(found - truly).max() < 0.02 * duration**5


def test_rewards_of_pendulums_and_the_car() -> None:
    generator = np.random.default_rng(1)
    pendulum, double, car = Pendulum(2.0), DoublePendulum(), Car()
    for _ in range(40):
        state, goal = generator.uniform(-4.0, 9.0, (2, 4)).astype(np.float32)
        action = np.asarray(pendulum.actions)[generator.integers(5)]
        truly = systems.pendulum_reward(action, pendulum.dt)
        got = pendulum.reward(*map(jnp.asarray, (state[:2], action, goal[:2], goal[:2])))
        assert float(got) == pytest.approx(truly, rel=CLOSE)
        got = pendulum.terminal_reward(jnp.asarray(state[:2]), jnp.asarray(goal[:2]))
        assert float(got) == pytest.approx(systems.pendulum_end(state[:2], goal[:2]), rel=1e-4)
        got = double.terminal_reward(jnp.asarray(state), jnp.asarray(goal))
        assert float(got) == pytest.approx(systems.double_pendulum_end(state, goal), rel=1e-4)
        state[0] *= 0.1
        got = car.reward(*map(jnp.asarray, (state, np.zeros(2), state, np.zeros(0))))
        assert float(got) == pytest.approx(systems.car_reward(state, car.dt), rel=CLOSE)
        over, end = systems.car_end(state)
        nowhere = jnp.zeros(0)
        assert bool(car.terminated(jnp.asarray(state), nowhere)) == over
        assert float(car.terminal_reward(jnp.asarray(state), nowhere)) == end


def test_walkers_walk_as_far_as_their_moves_are_long() -> None:
    walker, goal = Walker(spacing=0.5), jnp.array([0.6, 0.8])
    moves = np.asarray(walker.actions) / 0.5
    assert len(moves) == 16
    for move in moves:
        assert sorted(np.abs(move)) in ([0, 1], [1, 1], [1, 2])
        found = walker.dynamics(jnp.zeros(2), jnp.asarray(0.5 * move))
        np.testing.assert_allclose(found, 0.5 * move)
        got = walker.reward(jnp.zeros(2), jnp.asarray(0.5 * move), found, goal)
        assert float(got) == pytest.approx(-0.5 * np.hypot(*move), rel=CLOSE)
    assert float(walker.terminal_reward(goal + 0.1, goal)) == 0.0
    assert float(walker.terminal_reward(goal + 0.3, goal)) == -np.inf
    lengths = 0.5 * np.hypot(*moves.T)
    assert np.exp(-walker.least_beta * lengths).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(4))
def test_gridworlds(seed: int) -> None:
    generator = np.random.default_rng(seed)
    cells = [(int(x), int(y)) for x, y in generator.integers(0, 3, (3, 2))]
    start, goal, wall = cells[0], cells[1], (3, 1)
    mdp = Gridworld(4, 3, 4, -0.7, walls=(wall,), cell_features={"wet": [cells[2]]})
    successors = systems.gridworld(4, 3, {wall})
    np.testing.assert_array_equal(mdp.successors, successors)
    if start == goal:
        return
    is_goal = np.arange(12) == goal[1] * 4 + goal[0]
    world = TableWorld(
        successors=successors,
        rewards=np.full(successors.shape, -0.7),
        terminal=np.where(is_goal, 0.0, -np.inf),
        absorbing=is_goal,
        num_steps=4,
        axes=Axes(("state",)),
    )
    paths = all_paths(world, np.array([float(start[1] * 4 + start[0])]), np.zeros(0))
    log_weight = paths.log_weight(1.3, "counting")
    problem = Problem(mdp, mdp.hypotheses(), 1.3, "counting")
    evidence = sample(learn(problem, Tabular()), Task(np.array(start), np.array(goal)))
    assert evidence.log_partition[0] == pytest.approx(log_sum(log_weight), abs=1e-6)
    visited = paths.states[:, :, 0]
    for number in range(12):
        enters = (visited == number).any(axis=1)
        expected = log_sum(log_weight[enters]) - log_sum(log_weight)
        got = evidence.violation_probability[0, 1 + number]
        assert got == pytest.approx(np.exp(expected), abs=1e-6)
    wet = cells[2][1] * 4 + cells[2][0]
    assert evidence.log_ratio[0, 0] == evidence.log_ratio[0, 1 + wet]
    for move in range(8):
        makes = (paths.actions == move).any(axis=1)
        expected = log_sum(log_weight[makes]) - log_sum(log_weight)
        got = evidence.violation_probability[0, 13 + move]
        assert got == pytest.approx(np.exp(expected), abs=1e-6)


def test_angles_take_the_shorter_arc() -> None:
    generator = np.random.default_rng(3)
    space = StateSpace(("theta", "x"), ("theta",), np.array([[0.0, 6.0], [-9.0, 9.0]]))
    starts, ends = generator.uniform(-20.0, 20.0, (2, 200, 2))
    found = space.difference(starts, ends)
    arcs = [systems.shorter_arc(a, b) for a, b in zip(starts[:, 0], ends[:, 0], strict=True)]
    np.testing.assert_allclose(found[:, 0], arcs, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], ends[:, 1] - starts[:, 1])


def test_files_give_back_what_was_written(tmp_path) -> None:
    generator = np.random.default_rng(4)
    problem = Problem(Pendulum(), grid(theta=(0.0, 1.0, 2)))
    tasks = draw_tasks(problem, 3, seed=1)
    made = []
    for k in range(3):
        steps = generator.normal(0.0, 0.1, (5, 2))
        states = tasks.start[k] + np.vstack([np.zeros(2), steps.cumsum(axis=0)])
        task = Task(tasks.start[k], states[-1])
        made.append(Demonstration(f"demo_{k}", states, task, np.arange(6) / 7, steps[:, :1]))
    write_demonstrations(tmp_path, made, problem.mdp.space, action_names=("torque",))
    paths = sorted(tmp_path.glob("demo_*.csv"))
    read = read_demonstrations(paths, problem.mdp.space, action_names=("torque",))
    for first, second in zip(made, read, strict=True):
        for name in ("states", "times", "actions"):
            expected = getattr(first, name)
            got = getattr(second, name)[: len(expected)]
            np.testing.assert_allclose(got, expected, rtol=1e-8)  # nine digits are written
        assert second.name == first.name
