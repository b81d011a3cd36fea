"""Sampling: repeatable, independent of the company a task keeps, judged right."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    Cart,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)

from swerve import (
    ActionBox,
    Box,
    Demonstration,
    Grid,
    Pendulum,
    Problem,
    Task,
    Union,
    grid,
    hoeffding_error,
    infer,
    learn,
    sample,
)
from swerve.hypotheses.bits import unpack
from swerve.solvers.base import Nominal

COARSE = Grid(num_points=(40, 61))
OTHER = Task(np.array([1.0, 0.0]), np.array([2.0, 0.5]))


@pytest.fixture(scope="module")
def nominal() -> Nominal:
    return learn(short_pendulum(), COARSE)


def test_a_task_is_sampled_the_same_alone_and_in_company(nominal: Nominal) -> None:
    alone = sample(nominal, PENDULUM_TASK, 300, seed=5)
    together = sample(nominal, [OTHER, PENDULUM_TASK], 300, seed=5)
    np.testing.assert_array_equal(alone.samples.violations[0], together.samples.violations[1])
    np.testing.assert_allclose(alone.log_weight[0], together.log_weight[1], atol=1e-4)
    assert (together.samples.violations[0] != together.samples.violations[1]).any()


def test_the_seed_decides(nominal: Nominal) -> None:
    first, again, other = (sample(nominal, PENDULUM_TASK, 300, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.samples.violations, again.samples.violations)
    np.testing.assert_array_equal(first.log_weight, again.log_weight)
    assert (first.samples.violations != other.samples.violations).any()


def test_chunks_do_not_repeat_one_another(
    nominal: Nominal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swerve.sampling.one_task.MAX_CHUNK", 100)
    evidence = sample(nominal, PENDULUM_TASK, 250, method="importance")
    reward = evidence.samples.total_reward[0]
    assert reward.shape == (250,)
    assert (reward[:84] != reward[84:168]).any()


def test_plain_agrees_with_enumeration_within_hoeffding() -> None:
    """Theorem 1 with a policy that is pi_0 (a fine grid), bounded as the paper bounds it."""
    exact = enumerate_exactly(short_pendulum(), PENDULUM_TASK.start, PENDULUM_TASK.goal)
    evidence = sample(learn(short_pendulum()), PENDULUM_TASK, 10_000, method="plain")
    assert evidence.kl[0] < 1e-3
    bound = evidence.hoeffding_error(1.0 - 1e-6)
    assert bound == pytest.approx(hoeffding_error(10_000, 1.0 - 1e-6))
    assert bound < 0.03
    assert np.abs(evidence.violation_probability[0] - exact.violation_probability).max() < bound


def test_kept_trajectories_enter_what_the_bits_say(nominal: Nominal) -> None:
    evidence = sample(nominal, PENDULUM_TASK, 400)
    problem, kept = evidence.problem, evidence.samples.kept[0]
    rows = {row.tobytes() for row in evidence.samples.violations[0]}
    judged = problem.hypotheses.violations(kept, problem.space, problem.between_states)
    assert all(row.tobytes() in rows for row in judged)
    assert unpack(judged, len(problem.hypotheses)).any()
    np.testing.assert_allclose(
        kept[:, 0], np.broadcast_to(PENDULUM_TASK.start, (100, 2)), rtol=1e-6
    )


def test_goals_of_tasks_are_not_mixed_up(nominal: Nominal) -> None:
    """Tasks in any order, two of them with the same goal, end near their own goals."""
    strong = dataclasses.replace(short_pendulum(), beta=3.0)
    tasks = [
        PENDULUM_TASK,
        OTHER,
        Task(np.array([3.0, 0.0]), PENDULUM_TASK.goal),
    ]
    evidence = sample(learn(strong, COARSE), tasks, 200)
    for k, task in enumerate(tasks):
        np.testing.assert_array_equal(evidence.tasks.goal[k], task.goal)
        ends = evidence.samples.kept[k, :, -1]
        distance = np.linalg.norm(strong.mdp.space.difference(ends, task.goal[None]), axis=1)
        others = np.linalg.norm(
            strong.mdp.space.difference(ends, tasks[(k + 1) % 2].goal[None]), axis=1
        )
        if k < 2:
            assert np.median(distance) < np.median(others)


def test_a_policy_that_enters_a_known_constraint_loses_that_weight() -> None:
    """Trajectories in a known constraint weigh nothing, whatever the policy that drew them."""
    wall = Box(x=(-0.2, 0.3), v=(-0.9, 0.1))
    walled = short_cart(known=[wall])
    exact = enumerate_exactly(walled, CART_TASK.start, CART_TASK.goal)
    blind = Grid(num_points=81).learn(short_cart())

    @dataclasses.dataclass(frozen=True, eq=False)
    class Blind:
        problem: Problem
        solver: Grid

        def policies(self, goals, advance=lambda share: None):
            return blind.policies(goals, advance)

        def arrays(self):
            return {}

    evidence = sample(Blind(walled, Grid()), CART_TASK, 20_000, method="importance")
    share = np.isneginf(evidence.log_weight[0]).mean()
    assert 0.05 < share < 0.95
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / evidence.effective_sample_size[0]
    difference = evidence.violation_probability[0] - exact.violation_probability
    assert np.abs(difference / error).max() < 4.5
    assert evidence.log_partition[0] == pytest.approx(exact.log_partition, abs=0.1)


class TestBadInput:
    def test_method(self, nominal: Nominal) -> None:
        with pytest.raises(ValueError, match=r"method: expected one of smc, .*, got 'x'"):
            sample(nominal, PENDULUM_TASK, 10, method="x")

    def test_number(self, nominal: Nominal) -> None:
        with pytest.raises(
            ValueError, match="num_trajectories: expected a whole number >= 2, got 1"
        ):
            sample(nominal, PENDULUM_TASK, 1)

    def test_no_task(self, nominal: Nominal) -> None:
        with pytest.raises(ValueError, match="at least one task"):
            sample(nominal, [])

    def test_start_of_wrong_length(self, nominal: Nominal) -> None:
        with pytest.raises(ValueError, match=r"start of 2 numbers \(theta, omega\), got 3"):
            sample(nominal, Task(np.zeros(3), np.zeros(2)))

    def test_goal_that_is_not_finite(self, nominal: Nominal) -> None:
        with pytest.raises(ValueError, match="goal of task 0 is not finite"):
            sample(nominal, Task(np.zeros(2), np.array([0.0, np.nan])))

    def test_start_inside_a_known_constraint(self) -> None:
        nominal = learn(short_cart(known=[Box(x=(0.5, 0.7))]), Grid(num_points=21))
        with pytest.raises(ValueError, match=r"task 0 starts at .* inside the known .* x \[0.5"):
            sample(nominal, CART_TASK)

    def test_start_where_the_episode_is_over(self) -> None:
        nominal = learn(short_cart(), Grid(num_points=21))
        with pytest.raises(ValueError, match="where the episode is over"):
            sample(nominal, Task(np.array([1.7, 0.0]), np.zeros(2)))

    def test_dynamics_that_return_nan(self) -> None:
        class Broken(Pendulum):
            def dynamics(self, state, action):
                return jnp.where(state[0] > 100.0, jnp.nan, state + 60.0)

        problem = Problem(Broken(num_steps=4), grid(omega=(-4.0, 4.0, 2)), beta=1e-9)
        nominal = learn(problem, Grid(num_points=12))
        with pytest.raises(ValueError, match=r"Broken.dynamics returned \[nan, nan\] at step 3"):
            sample(nominal, Task(np.array([1.0, 0.0]), np.zeros(2)), 8)


def test_what_would_not_fit_memory_is_refused() -> None:
    fine = dataclasses.replace(
        short_pendulum(), hypotheses=grid(theta=(0.0, 6.0, 10**5), omega=(-4.0, 4.0, 10**5))
    )
    with pytest.raises(ValueError, match=r"10,000,000,000 hypotheses take .* GiB of memory"):
        sample(learn(fine, COARSE), PENDULUM_TASK, 10_000)


def test_tasks_outside_the_bounds_are_refused(nominal: Nominal) -> None:
    far = Task(np.array([1.0, 99.0]), PENDULUM_TASK.goal)
    with pytest.raises(ValueError, match="task 1: start omega = 99 is outside the bounds"):
        sample(nominal, [PENDULUM_TASK, far], 100)


@pytest.mark.parametrize("known", [(), (ActionBox(force=(0.5, 2.0)),)])
def test_actions_are_judged_and_known_ones_left_out(known: tuple) -> None:
    """Against enumeration, with episodes that end early: what follows the end is no action."""
    hypotheses = [
        ActionBox(force=(-2.0, -0.5)),
        ActionBox(force=(-0.5, 0.5)),
        Union("left or pushed", [Box(x=(-2.0, -0.9)), ActionBox(force=(0.5, 2.0))]),
    ]
    problem = Problem(Cart(num_steps=3), hypotheses, beta=0.3, known=known)
    exact = enumerate_exactly(problem, CART_TASK.start, CART_TASK.goal)
    evidence = sample(learn(problem, Grid()), CART_TASK, 20_000)
    assert (exact.violation_probability < 0.95).all()
    assert np.count_nonzero(exact.violation_probability > 0.1) >= 2
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / 20_000
    difference = evidence.violation_probability[0] - exact.violation_probability
    assert np.abs(difference / error).max() < 4.5
    assert evidence.log_partition[0] == pytest.approx(exact.log_partition, abs=0.02)


def test_demonstrations_are_judged_by_their_actions() -> None:
    hypotheses = [ActionBox(force=(-2.0, -0.5)), ActionBox(force=(0.5, 2.0))]
    evidence = sample(learn(Problem(Cart(), hypotheses), Grid(num_points=41)), CART_TASK, 200)
    states = np.array([[0.6, 0.3], [0.5, -0.2], [0.4, -0.2]])
    pushed = Demonstration("a", states, CART_TASK, actions=np.array([[-1.0], [0.0]]))
    np.testing.assert_array_equal(infer(evidence, [pushed]).entered, [[True, False]])
    last = Demonstration("a", states, CART_TASK, actions=np.array([[-1.0], [0.0], [1.0]]))
    np.testing.assert_array_equal(infer(evidence, [last]).entered, [[True, False]])
    for actions in (None, np.zeros((2, 2))):
        with pytest.raises(ValueError, match="demo: the problem has constraints on actions, so"):
            infer(evidence, [Demonstration("demo", states, CART_TASK, actions=actions)])
