"""Rewards of demonstrations."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.carts import CART, shown
from support.reference import CART_TASK, Cart, short_pendulum
from support.routes import TASK, LatticeRoutes, routes

from swerve import Demonstration, Problem, Task
from swerve.fitting.rewards import total_rewards
from swerve.fitting.steps import steps_taken

TRACES: list[str] = []


class Traced(Cart):
    """The cart, which notes each time that JAX traces its rewards or its end."""

    def reward(self, state, action, next_state, goal):
        TRACES.append("reward")
        return super().reward(state, action, next_state, goal)

    def terminated(self, state, goal):
        TRACES.append("terminated")
        return super().terminated(state, goal)


def wandering(num: int) -> Demonstration:
    """A demonstration of some steps on the track."""
    generator = np.random.default_rng(num)
    states, forces = generator.uniform(-1, 1, (num + 1, 2)), generator.integers(-1, 2, (num, 1))
    return Demonstration(f"of {num}", states, Task(states[0], CART_TASK.goal), actions=forces)


class TestRewards:
    def test_are_those_of_the_steps(self) -> None:
        made = shown()[0]
        mdp, states, actions = CART.mdp, made.states, made.actions
        assert actions is not None
        steps = [mdp.reward(*step, made.task.goal) for step in zip(states, actions, states[1:])]  # noqa: B905
        expected = sum(map(float, steps)) + float(mdp.terminal_reward(states[-1], made.task.goal))
        assert total_rewards(CART, [made]) == pytest.approx([expected], rel=1e-5)

    @pytest.mark.parametrize("offset", [0.0, 1.7e9])
    def test_rows_at_other_times_are_resampled(self, offset: float) -> None:
        made = next(item for item in shown() if len(item.states) == 8)
        assert made.times is not None
        assert made.actions is not None
        times = np.sort(np.concatenate([made.times, made.times[:-1] + 0.2, [0.01, 2.03]]))
        held = made.actions[(times[:-1] / 0.5 + 1e-6).astype(int)]
        states = np.stack([np.interp(times, made.times, x) for x in made.states.T], axis=1)
        finer = dataclasses.replace(made, states=states, times=times + offset, actions=held)
        expected = total_rewards(CART, [made])
        np.testing.assert_allclose(total_rewards(CART, [finer]), expected, rtol=1e-5)
        wrong = dataclasses.replace(made, times=0.5 * made.times)  # as if twice as fast
        assert abs(total_rewards(CART, [wrong])[0] - expected[0]) > 0.01

    def test_angles_are_resampled_along_the_shorter_arc(self) -> None:
        problem = short_pendulum()
        theta = np.linspace(6.0, 7.2, 13)
        states = np.stack([theta, np.full(13, 0.5)], axis=1)
        times, goal = 0.2 * np.arange(13), np.array([1.0, 0.0])
        turned = Demonstration("a", states, Task(states[0], goal), times, np.ones((12, 1)))
        wrapped = states % [2.0 * math.pi, 100.0]
        assert np.ptp(np.diff(wrapped[:, 0])) > 1.0
        for item in (turned, dataclasses.replace(turned, states=wrapped)):
            steps = Demonstration("b", states[::2], item.task, None, np.ones((6, 1)))
            np.testing.assert_allclose(
                total_rewards(problem, [item]), total_rewards(problem, [steps]), rtol=1e-5
            )

    def test_lengths_share_what_is_compiled(self) -> None:
        """Rows that make up the number compiled for are not earned."""
        problem = Problem(Traced(num_steps=200), CART.hypotheses)
        made, expected = [wandering(num) for num in (1, 2, 5, 20, 63, 64)], []
        for item in [*made, wandering(65), wandering(200)]:
            off = item.states[1:, 0] - CART_TASK.goal[0]
            forces = np.asarray(item.actions)[:, 0]
            expected.append(-0.3 * (forces**2).sum() - 0.2 * (off**2).sum() - off[-1] ** 2)
        TRACES.clear()
        found = total_rewards(problem, made)
        assert sorted(TRACES) == ["reward", "terminated"]
        found = np.append(found, total_rewards(problem, [wandering(65), wandering(200)]))
        assert sorted(TRACES) == ["reward"] * 2 + ["terminated"] * 2
        np.testing.assert_allclose(found, expected, rtol=1e-5)

    def test_the_action_at_the_middle_of_a_step_counts(self) -> None:
        """Not the one held for the longest; where it changes at the middle, the one before."""
        times = np.array([0.0, 0.2, 0.35, 0.5, 0.75, 1.0])
        states = np.linspace(*CART_TASK, 6)
        forces = np.array([[-1.0], [0.0], [1.0], [0.0], [1.0]])
        made = Demonstration("a", states, CART_TASK, times, forces)
        np.testing.assert_array_equal(steps_taken(CART, made).actions, [[0.0], [0.0]])

    def test_what_comes_after_the_end_does_not_count(self) -> None:
        states = np.array([[0.6, 0.3], [1.1, 1.0], [1.6, 1.0], [2.1, 1.0], [2.6, 1.0]])
        made = Demonstration("over", states, CART_TASK, actions=np.ones((4, 1)))
        ended = dataclasses.replace(made, states=states[:3], actions=np.ones((2, 1)))
        assert total_rewards(CART, [made]) == total_rewards(CART, [ended])

    def test_the_last_state_is_kept(self) -> None:
        """2.8 steps of 0.5 s count as three, to the line and not to just before it."""
        states = np.array([[0.6, 0.3], [1.0, 1.0], [1.52, 1.0]])
        made = Demonstration("e", states, CART_TASK, np.array([0.0, 0.7, 1.4]), np.ones((2, 1)))
        bare = dataclasses.replace(made, states=states[:2], times=made.times[:2], actions=[[1.0]])  # pyright: ignore
        assert total_rewards(CART, [made])[0] < total_rewards(CART, [bare])[0] - 2.0

    def test_a_lattice_needs_no_times(self) -> None:
        problem = routes(LatticeRoutes(), known=[], measure="counting")
        states = np.linspace(*TASK, 9)
        made = Demonstration("straight", states, TASK, times=np.arange(9) * 7.0)
        assert total_rewards(problem, [made]) == pytest.approx([0.0])

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"actions": None}, "a: expected actions force, got none: the total reward"),
            (
                {"actions": None, "notes": ("has no column force, and 'forse' was not taken",)},
                "on them; its file has no column force, and 'forse' was not taken$",
            ),
            ({"actions": np.ones((4, 2))}, "a: expected actions force, got 2 of them"),
            ({"actions": np.full((4, 1), np.nan)}, "a: row 1, column force: expected a finite"),
            ({"times": 2.0 * np.arange(5)}, "a: 16 steps, more than the horizon of 7"),
            (
                {"times": 1.7e18 + 5e7 * np.arange(5)},
                r"a: lasts 2e\+08 s, and the model's episodes at most 3.5 s: another unit of t\?",
            ),
            ({"times": 1e300 * np.arange(5)}, "a: lasts .* another unit of t.* to seconds$"),
            ({"actions": np.full((4, 1), 1e30)}, "a: expected a finite total reward, got -inf"),
        ],
    )
    def test_what_cannot_be_rewarded_is_refused(self, changes: dict, message: str) -> None:
        states = CART_TASK.start + 0.01 * np.arange(5)[:, None]
        made = Demonstration("a", states, CART_TASK, actions=np.ones((4, 1)))
        with pytest.raises(ValueError, match=message):
            total_rewards(CART, [dataclasses.replace(made, **changes)])
