"""The KL divergence of demonstrations from the nominal distribution."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.carts import CART, sampled, shown
from support.reference import CART_TASK, Cart, enumerate_exactly
from support.walks import PROBLEM, ROUND, TASK, walk

from swerve import Demonstration, Task, divergence, fit_beta, infer, learn, sample
from swerve.fitting.rewards import _path_of, total_rewards
from swerve.fitting.steps import steps_taken


def test_divergence_by_hand() -> None:
    """Two of three alike, each 3 or 4 moves at a reward of -1, log Z = -2."""
    straight = walk("right", "right", "right")
    found = divergence(PROBLEM, [straight, straight, ROUND], np.full(3, -2.0))
    entropy = 2 / 3 * math.log(2 / 3) + 1 / 3 * math.log(1 / 3)
    assert found == pytest.approx(entropy + (3 + 3 + 4) / 3 - 2.0)


def test_actions_of_a_tabular_mdp_are_found_from_its_transitions() -> None:
    bare = Demonstration("bare", ROUND.states, TASK)
    value = np.array([-2.0])
    assert divergence(PROBLEM, [bare], value) == divergence(PROBLEM, [ROUND], value)


def test_an_impossible_transition_names_the_step() -> None:
    states = ROUND.states.copy()
    states[2] = [3.0, 2.0]
    message = r"jump: step 2 leads from \[0.0, 1.0\] to \[3.0, 2.0\], which no action does"
    for actions in (None, ROUND.actions):
        jump = Demonstration("jump", states, TASK, actions=actions)
        with pytest.raises(ValueError, match=message):
            divergence(PROBLEM, [jump], np.zeros(1))
    with pytest.raises(ValueError, match=message):
        infer(sample(learn(PROBLEM), TASK), [jump])


def test_an_action_that_does_not_make_the_step_is_named() -> None:
    assert ROUND.actions is not None
    wrong = Demonstration("wrong", ROUND.states, TASK, actions=ROUND.actions[::-1])
    with pytest.raises(ValueError, match=r"wrong: step 1 leads .* action \[1.0, -1.0\] does not"):
        divergence(PROBLEM, [wrong], np.zeros(1))


def test_resting_at_the_end_is_no_step() -> None:
    rests = Demonstration(
        "rests",
        np.concatenate([ROUND.states, ROUND.states[-1:]]),
        TASK,
        actions=np.concatenate([np.asarray(ROUND.actions), [[-1.0, 0.0]]]),
    )
    result = infer(sample(learn(PROBLEM), TASK), [rests, ROUND])
    assert result.entered[0].sum() > 3
    np.testing.assert_array_equal(result.entered[0], result.entered[1])
    bare = Demonstration("bare", rests.states, TASK)
    expected = divergence(PROBLEM, [ROUND], np.zeros(1))
    assert divergence(PROBLEM, [rests], np.zeros(1)) == expected
    assert divergence(PROBLEM, [bare], np.zeros(1)) == expected


def test_going_on_after_the_end_is_refused() -> None:
    on = walk("right", "right", "right", "left", "right")
    with pytest.raises(ValueError, match=r"has ended in state 3 .*, and yet the demonstr"):
        divergence(PROBLEM, [on], np.zeros(1))


def test_more_steps_than_the_horizon_are_refused() -> None:
    long = walk("up", "up", "down", "right", "right", "down-right")
    with pytest.raises(ValueError, match="6 steps, more than the horizon of 5"):
        divergence(PROBLEM, [long], np.zeros(1))
    with pytest.raises(ValueError, match="6 steps, more than the horizon of 5"):
        infer(sample(learn(PROBLEM), TASK), [long])


def test_demonstrations_that_differ_by_rounding_are_the_same() -> None:
    straight = walk("right", "right", "right")
    near = Demonstration("near", straight.states + 1e-12, TASK, actions=straight.actions)
    minus = Demonstration("minus", straight.states, Task(-TASK.start, TASK.goal))
    alike = [straight, near, minus]
    assert divergence(PROBLEM, alike, np.full(3, -2.0)) == pytest.approx(3.0 - 2.0)


class Compared(np.ndarray):
    """Actions that count how often they are compared."""

    num = 0

    def __sub__(self, other: Any) -> Any:
        Compared.num += 1
        return np.asarray(self) - np.asarray(other)


@pytest.mark.parametrize("is_discrete", [True, False])
def test_trajectories_that_differ_are_not_all_compared(is_discrete: bool) -> None:
    """Of 600 trajectories of one task, some of them alike."""
    generator = np.random.default_rng(0)
    made = generator.normal(size=(600, 8, 2))
    made = np.sign(made) if is_discrete else made
    made[generator.integers(600, size=300)] = made[generator.integers(600, size=300)]
    size = np.abs(made).max(axis=(1, 2), keepdims=True)
    made += 0.3e-6 * size * generator.uniform(-1.0, 1.0, made.shape)
    expected, known = [], []
    for taken in made:
        apart = [np.abs(other - taken).max() for other in known]
        is_new = min(apart, default=math.inf) > 1e-6 * np.abs(taken).max()
        expected.append(len(known) if is_new else int(np.argmin(apart)))
        known += [taken] if is_new else []
    Compared.num = 0
    found = _path_of([0] * 600, [taken.view(Compared) for taken in made])
    assert found == [(0, 8, number) for number in expected]
    assert len(known) < 500
    assert 100 < Compared.num < 2_000


@pytest.mark.parametrize("values", [3.0, [1.0, 2.0], [[1.0]]])
def test_divergence_takes_one_number_for_each_demonstration(values) -> None:
    with pytest.raises(ValueError, match=r"one number for each of 1 demonstrations, .* got shape"):
        divergence(PROBLEM, [ROUND], values)
    with pytest.raises(ValueError, match="demonstrations: expected a list of at least one"):
        divergence(PROBLEM, [], np.zeros(0))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_log_partition_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(
        ValueError, match=r"log_partition: expected finite numbers, got \[(nan|inf)"
    ):
        divergence(PROBLEM, [ROUND], np.array([value]))


class Recorded:
    """The same demonstrations of the cart as others would record them."""

    def __init__(self, rate: int = 1, jitter: float = 0.0, offset: float = 0.0, rest: int = 0):
        self.rate, self.jitter, self.offset, self.rest = rate, jitter, offset, rest

    def __call__(self, made: Demonstration, seed: int) -> Demonstration:
        assert made.times is not None
        assert made.actions is not None
        generator = np.random.default_rng(seed)
        dt, num = made.times[1], len(made.actions)
        times = dt / self.rate * np.arange(self.rate * num + 1)
        times[1:-1] += self.jitter * dt / self.rate * generator.uniform(-1, 1, len(times) - 2)
        states = np.stack([np.interp(times, made.times, x) for x in made.states.T], axis=1)
        actions = np.repeat(made.actions, self.rate, axis=0)
        after = dt / self.rate * np.arange(1, self.rest + 1)
        return dataclasses.replace(
            made,
            states=np.concatenate([states, np.repeat(states[-1:], self.rest, axis=0)]),
            times=self.offset + np.concatenate([times, times[-1] + after]),
            actions=np.concatenate([actions, np.full((self.rest, 1), 9.0)]),
        )


@cache
def made() -> list[Demonstration]:
    """Demonstrations of the cart: two alike, and one that leaves the track in two steps."""
    over = np.array([[0.6, 0.3], [1.0, 0.8], [1.65, 1.3]])
    left = Demonstration("left", over, CART_TASK, 0.5 * np.arange(3), np.ones((2, 1)))
    return [*shown()[:10], shown()[0], left]


def rolled_out(forces: Sequence[float]) -> tuple[float, int]:
    """Return R and L of the cart under these forces, by its formulas written once more."""
    (x, v), line, reward = CART_TASK.start.tolist(), float(CART_TASK.goal[0]), 0.0
    for step, force in enumerate(forces, start=1):
        v += 0.5 * force
        x += 0.5 * v
        reward -= 0.3 * force**2 + 0.2 * (x - line) ** 2
        if abs(x) > 1.5:
            return reward - 2.0 - (x - line) ** 2, step
    assert len(forces) == Cart().num_steps
    return reward - (x - line) ** 2, len(forces)


@cache
def log_partition() -> np.ndarray:
    """Log Z_0 of each of them."""
    return np.full(len(made()), enumerate_exactly(CART, *CART_TASK).log_partition)


class TestOfOtherRecordings:
    """Whoever records the cart, its demonstrations diverge by the same."""

    def test_is_that_of_enumeration(self) -> None:
        """KL = sum p log (p / pi_C), with pi_C from all action sequences, one after another."""
        names = [tuple(np.asarray(item.actions)[:, 0].tolist()) for item in made()]
        share = np.array([names.count(name) / len(made()) for name in names])
        log_pi = []
        for forces in names:
            reward, num = rolled_out(forces)
            log_pi.append(CART.beta * reward - num * math.log(3.0) - log_partition()[0])
        expected = np.mean(np.log(share) - log_pi)
        assert share.max() >= 2 / 12
        assert len({rolled_out(forces)[1] for forces in names}) > 1
        assert divergence(CART, made(), log_partition()) == pytest.approx(expected)

    @pytest.mark.parametrize(
        "recorded",
        [
            Recorded(2),
            Recorded(3),
            Recorded(offset=5.0),
            Recorded(2, offset=1.7e9),
            Recorded(rest=3),
            Recorded(3, rest=4),
        ],
    )
    def test_is_the_same(self, recorded: Recorded) -> None:
        others = [recorded(item, k) for k, item in enumerate(made())]
        expected = divergence(CART, made(), log_partition())
        assert divergence(CART, others, log_partition()) == pytest.approx(expected, abs=1e-4)
        mixed = [*made()[:6], *others[6:]]
        assert divergence(CART, mixed, log_partition()) == pytest.approx(expected, abs=1e-4)
        np.testing.assert_allclose(
            total_rewards(CART, others), total_rewards(CART, made()), rtol=1e-5, atol=1e-5
        )
        fits = [fit_beta(CART, sampled(), items) for items in (made(), others)]
        assert fits[1].beta == pytest.approx(fits[0].beta, rel=1e-3)

    @pytest.mark.parametrize("rate", [1, 2])
    def test_times_that_vary_cut_corners_alone(self, rate: int) -> None:
        """Lines between rows beside the steps cut corners of the path; actions stay the same."""
        others = [Recorded(rate, jitter=0.1)(item, k) for k, item in enumerate(made())]
        found = divergence(CART, made(), log_partition())
        assert divergence(CART, others, log_partition()) == pytest.approx(found, abs=0.1)
        for one, other in zip(made(), others, strict=True):
            taken, expected = (steps_taken(CART, item).actions for item in (other, one))
            np.testing.assert_array_equal(taken, expected)

    def test_is_the_same_at_both_precisions(self) -> None:
        def rounded(item: Demonstration) -> Demonstration:
            task = Task(*(np.float32(part * 1.1) / 1.1 for part in item.task))
            actions = np.asarray(item.actions) * np.float32(1.1) / 1.1
            states = np.float32(item.states)
            return dataclasses.replace(item, states=states, task=task, actions=actions)

        others = [*made()[:6], *map(rounded, made()[6:])]
        expected = divergence(CART, made(), log_partition())
        assert divergence(CART, others, log_partition()) == pytest.approx(expected, abs=1e-4)

    def test_moving_on_after_the_horizon_is_refused(self) -> None:
        item = next(item for item in made() if len(item.states) == 8)
        long = Recorded(rest=2)(item, 0)
        long.states[-1] += 0.1
        with pytest.raises(ValueError, match="9 steps, more than the horizon of 7"):
            divergence(CART, [long], np.zeros(1))

    def test_total_rewards_that_are_not_finite_are_refused(self) -> None:
        far = dataclasses.replace(made()[0], actions=np.full_like(made()[0].actions, 1e30))
        with pytest.raises(ValueError, match="expected a finite total reward, got -inf"):
            divergence(CART, [far], np.zeros(1))


def test_a_model_without_a_clock_takes_each_row_for_a_step() -> None:
    slow = dataclasses.replace(ROUND, times=7.5 * np.arange(len(ROUND.states)))
    value = np.array([-2.0])
    assert divergence(PROBLEM, [slow], value) == divergence(PROBLEM, [ROUND], value)
