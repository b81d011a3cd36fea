"""Modes of pi_0 that samples miss although their weights look perfect."""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.carts import CART, GRID, nominal, sampled
from support.guesses import Fixed, Guess
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    Exact,
    enumerate_exactly,
    short_pendulum,
)

from swerve import MDP, Box, Evidence, Problem, Task, grid, infer, learn, sample
from swerve.sampling import missed
from swerve.sampling.missed import Explored, explore, missed_share
from swerve.simulation.policies import LookAhead

RIGHT = Box(x=(0.7, 9.0))


class Undervalued(LookAhead):
    """Looks ahead with a value that is `shift` nats too low, right of a place."""

    problem: Problem = eqx.field(static=True)
    inner: LookAhead
    shift: float
    place: float = -np.inf

    def value(self, state, step, goal):
        shift = jnp.where(state[0] > self.place, self.shift, 0.0)
        return self.inner.value(state, step, goal) - shift


def undervalued(problem: Problem, task: Task, shift: float, place: float = -np.inf) -> Fixed:
    (inner,) = learn(problem, GRID).policies(task.goal[None])  # pyright: ignore
    return Fixed(Undervalued(problem, inner, shift, place))


class HardCart(MDP):
    """A cart that pays dearly for each distance from the goal at the end, and for its force."""

    num_steps: int = eqx.field(default=5, static=True)
    state_names = ("x", "v")
    action_names = ("force",)
    bounds = ((-3.0, 3.0), (-3.0, 3.0))
    dt = 0.3
    actions = property(lambda self: jnp.array([[-1.0], [0.0], [1.0]]))

    def dynamics(self, state, action):
        v = state[1] + self.dt * action[0]
        return jnp.stack([state[0] + self.dt * v, v])

    def reward(self, state, action, next_state, goal):
        return -self.dt * action[0] ** 2

    def terminal_reward(self, state, goal):
        return -1e4 * jnp.sum((state - goal) ** 2)


HARD = Problem(HardCart(), grid(x=(-3.0, 3.0, 12), v=(-3.0, 3.0, 12)), beta=1.0)
HARD_TASK = Task(np.zeros(2), np.array([0.0, 0.05]))


def hard() -> tuple[Evidence, Exact]:
    """Evidence by a grid on whose nodes the cart can rest, and nowhere else; the exact answer."""
    evidence = sample(learn(HARD, "grid?num_points=21"), HARD_TASK, 2_000)
    return evidence, enumerate_exactly(HARD, *HARD_TASK)


class TestHardGoals:
    def test_a_mode_between_nodes_is_found_missing(self) -> None:
        """All else looks perfect: the weights, the islands, and the value at the start."""
        evidence, exact = hard()
        assert evidence.effective_sample_size[0] > 0.99 * evidence.num_trajectories
        assert evidence.island_spread[0] < 0.01
        assert evidence.log_partition[0] == pytest.approx(evidence.soft_value[0], abs=0.01)
        error = np.abs(evidence.violation_probability[0] - exact.violation_probability)
        assert error.max() > 0.3
        missing = 1.0 - math.exp(evidence.log_partition[0] - exact.log_partition)
        assert missing == pytest.approx(0.64, abs=0.01)
        assert evidence.missed_share[0] == pytest.approx(missing, abs=0.15)
        result = infer(evidence, [])
        assert result.verdict(0).startswith("not to be trusted: about ")
        assert result.verdict(0).endswith(" % of pi_0 was not sampled")
        assert result.warnings[0].startswith("not to be trusted: about ")
        assert "the worst of 1 such tasks of 1, but found by traj" in result.warnings[0]
        assert result.warnings[0].endswith("too coarse for this problem: give it more num_points")


class TestPolicies:
    @pytest.mark.parametrize("method", ["smc", "importance"])
    def test_what_a_policy_never_does_is_found_missing(self, method: str) -> None:
        region = dataclasses.replace(CART, hypotheses=[RIGHT])
        exact = enumerate_exactly(region, *CART_TASK)
        share = exact.violation_probability[0]
        assert 0.1 < share < 0.7
        blind = undervalued(region, CART_TASK, 40.0, 0.7)
        evidence = sample(blind, CART_TASK, 4_000, method=method)
        assert evidence.violation_probability[0, 0] < 0.01
        assert evidence.effective_sample_size[0] > 0.9 * evidence.num_trajectories
        lost = 1.0 - math.exp(evidence.log_partition[0] - exact.log_partition)
        assert lost == pytest.approx(share, abs=0.02)
        assert evidence.missed_share[0] == pytest.approx(share, rel=0.4)
        assert evidence.is_missing[0]

    @pytest.mark.parametrize("shift", [-12.0, 12.0])
    def test_a_value_that_is_wrong_everywhere_misses_nothing(self, shift: float) -> None:
        problem = short_pendulum()
        nominal = undervalued(problem, PENDULUM_TASK, shift)
        evidence = sample(nominal, PENDULUM_TASK, 4_000, method="smc")
        exact = enumerate_exactly(problem, *PENDULUM_TASK)
        assert evidence.log_partition[0] == pytest.approx(exact.log_partition, abs=0.05)
        assert not evidence.is_missing[0]

    def test_samples_that_are_right_miss_nothing(self) -> None:
        evidence = sampled()
        assert (evidence.missed_share < evidence.resolution).all()
        assert not any("was not sampled" in text for text in infer(evidence, []).warnings)

    def test_little_that_is_missing_makes_errors_larger(self) -> None:
        evidence = dataclasses.replace(sampled(), missed_share=np.array([np.nan, 0.012]))
        np.testing.assert_array_equal(evidence.is_missing, [False, True])
        result = infer(evidence, [])
        expected = "errors may be larger than stated: about 1.2 % of pi_0 was not sampled"
        assert result.verdict(1) == expected
        assert result.warnings[0].startswith(
            f"{expected} for task 1, the worst of 1 such tasks of 2"
        )

    def test_what_is_missing_is_of_the_beta_sampled_for(self) -> None:
        evidence = dataclasses.replace(sampled(), missed_share=np.array([np.nan, 0.2]))
        sampled_for = evidence.problem.beta
        result = infer(evidence.at_beta(0.95 * sampled_for), [])
        of_beta = f"of pi_0 at beta {sampled_for:g}, the beta of sampling, was not sampled"
        expected = f"not to be trusted: about 20 % {of_beta}"
        assert result.verdict(1) == expected
        assert result.warnings[0].startswith(
            f"{expected} for task 1, the worst of 1 such tasks of 2"
        )


class TestExplorers:
    def test_weigh_what_they_do_exactly(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(missed, "NUM_EXPLORERS", 20_000)
        for policy in (Guess(CART, -0.2), UniformlyRandom()):
            found = explore(CART, policy, CART_TASK, jax.random.key(0))
            gain = np.asarray(found.gain, float).sum(axis=0)
            weight = np.exp(gain - gain.max())
            error = weight.std() / weight.mean() / math.sqrt(len(weight))
            assert error < 0.1
            value = gain.max() + math.log(weight.mean())
            exact = enumerate_exactly(CART, *CART_TASK).log_partition
            assert value == pytest.approx(exact, abs=4.0 * error)

    def test_weights_beyond_float64_are_no_matter(self) -> None:
        gain, value = np.zeros((2, 2, 256))
        gain[1, :100], value[1, 100:] = 6_000.0, 5_000.0
        found = Explored(*(jnp.asarray(x) for x in (gain, 2.0 * gain, value)))
        for is_resampled in (True, False):
            assert missed_share(found, 0.0, 1_000, is_resampled) == 1.0

    def test_steps_into_known_constraints_weigh_nothing(self) -> None:
        problem = dataclasses.replace(CART, known=[Box(x=(0.9, 9.0))])
        found = explore(problem, UniformlyRandom(), CART_TASK, jax.random.key(0))
        entered = np.isneginf(np.asarray(found.gain)).any(axis=0)
        assert 0.1 < entered.mean() < 0.99
        assert missed_share(found, 0.0, 1_000, False) < 1.0

    @pytest.mark.parametrize("is_resampled", [True, False])
    def test_all_in_known_constraints_tell_nothing(self, is_resampled: bool) -> None:
        gain, value = np.zeros((2, 2, 256))
        gain[1, :100] = gain[0, 100:] = -np.inf
        found = Explored(*(jnp.asarray(x) for x in (gain, gain, value)))
        assert math.isnan(missed_share(found, 0.0, 1_000, is_resampled))


class UniformlyRandom:
    """A policy without a value."""

    def __call__(self, state, step, goal):
        return jnp.full(3, -math.log(3.0))


def test_the_share_is_kept_with_the_evidence(tmp_path) -> None:
    evidence = dataclasses.replace(sampled(), missed_share=np.array([0.25, np.nan]))
    evidence.save(tmp_path / "a.evidence")
    loaded = Evidence.load(tmp_path / "a.evidence")
    np.testing.assert_array_equal(loaded.missed_share, [0.25, np.nan])
    np.testing.assert_array_equal(loaded.select([1, 0]).missed_share, [np.nan, 0.25])
    joined = loaded.select([1]).joined(loaded.select([0]))
    np.testing.assert_array_equal(joined.missed_share, [np.nan, 0.25])
    np.testing.assert_array_equal(loaded.at_beta(1.9).missed_share, [0.25, np.nan])


def test_another_beta_is_not_explored() -> None:
    evidence = sample(nominal(2.0), CART_TASK, 400, beta=1.0)
    assert np.isnan(evidence.missed_share).all()
    assert not evidence.is_missing.any()
