"""Estimates from weighted trajectories agree with sums over all trajectories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.weighted_worlds import make_world, pack

from swerve.evidence.estimators import (
    avoid_probability,
    effective_sample_size,
    joint_error,
    kl_divergence,
    log_partition,
    log_weights,
    normalise,
    parts,
)

seeds = st.integers(0, 2**32 - 1)
STANDARD_ERRORS = 4.5


class TestLogWeights:
    @given(seed=seeds, beta=st.floats(0.0, 10.0), num_actions=st.integers(1, 30))
    def test_are_log_target_minus_log_proposal(self, seed, beta, num_actions) -> None:
        generator = np.random.default_rng(seed)
        reward, log_pi = generator.normal(-50, 20, (2, 3, 8))
        length = generator.integers(1, 300, (3, 8))
        settings = {"beta": beta, "num_actions": num_actions}
        counting = log_weights(reward, log_pi, length, measure="counting", **settings)
        uniform = log_weights(reward, log_pi, length, measure="uniform", **settings)
        np.testing.assert_allclose(counting, beta * reward - log_pi, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(
            uniform, beta * reward - length * math.log(num_actions) - log_pi, rtol=1e-12, atol=1e-9
        )

    def test_are_float64_whatever_came(self) -> None:
        reward, log_pi = np.array([[-300.25, 0.0], [-1.5, -2.0]], np.float32)
        found = log_weights(
            reward, log_pi, np.array([3, 3], np.int32), beta=0.1, measure="counting", num_actions=5
        )
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, [-30.025 + 1.5, 2.0], rtol=1e-15)

    @pytest.mark.parametrize("beta", [0.0, 0.5])
    def test_a_known_constraint_has_weight_zero(self, beta: float) -> None:
        found = log_weights(
            np.array([-np.inf, -2.0]),
            np.array([-1.0, -1.0]),
            np.array([2, 4]),
            beta=beta,
            measure="counting",
            num_actions=5,
        )
        np.testing.assert_array_equal(found, [-np.inf, 1.0 - 2.0 * beta])

    @pytest.mark.parametrize(
        ("reward", "log_pi", "num"),
        [
            ([np.nan, 0.0, 0.0], [0.0, 0.0, 0.0], 1),
            ([0.0, np.inf, np.nan], [0.0, 0.0, 0.0], 2),
            ([0.0, 0.0, 0.0], [0.0, -np.inf, 0.0], 1),
            ([0.0, 0.0, 0.0], [np.nan, np.nan, np.nan], 3),
            ([-np.inf, 0.0, 0.0], [np.nan, 0.0, 0.0], 1),
        ],
    )
    def test_numbers_that_are_not_finite_are_refused(self, reward, log_pi, num) -> None:
        message = f"{num} of 3 log-weights are not finite: the reward or the policy returned NaN"
        with pytest.raises(ValueError, match=message):
            log_weights(
                np.array(reward),
                np.array(log_pi),
                np.ones(3),
                beta=1.0,
                measure="uniform",
                num_actions=2,
            )


class TestExactlyProportionalSamples:
    """Where each trajectory comes as often as the policy says, estimates are the exact sums."""

    @given(seed=seeds, forbid=st.booleans())
    def test_all_estimates(self, seed, forbid) -> None:
        generator = np.random.default_rng(seed)
        times = generator.integers(1, 9, 12)
        target = np.exp(generator.normal(0.0, 2.0, 12))
        if forbid:
            target[generator.permutation(12)[:4]] = 0.0
        proposal = times / times.sum()
        violates = generator.random((12, 20)) < 0.4
        rows = np.repeat(np.arange(12), times)
        with np.errstate(divide="ignore"):
            log_weight = (np.log(target) - np.log(proposal))[rows]

        exact_log_partition = math.log(target.sum())
        nominal = target / target.sum()
        assert log_partition(log_weight) == pytest.approx(exact_log_partition, abs=1e-12)
        estimate = avoid_probability(log_weight, pack(violates[rows]), 20)
        np.testing.assert_allclose(estimate.avoid_probability, nominal @ ~violates, atol=1e-12)
        # the policy restricted to what is allowed
        allowed = target > 0
        restricted = proposal[allowed] / proposal[allowed].sum()
        exact_kl = restricted @ np.log(restricted / nominal[allowed])
        assert kl_divergence(log_weight, exact_log_partition) == pytest.approx(exact_kl, abs=1e-10)
        weight = target / proposal
        ess = (times @ weight) ** 2 / (times @ weight**2)
        assert effective_sample_size(log_weight) == pytest.approx(ess, rel=1e-10)
        np.testing.assert_allclose(
            normalise(log_weight), (weight / (times @ weight))[rows], atol=1e-14
        )


class TestAgainstEnumeration:
    def test_random_samples_lie_within_their_standard_errors(self) -> None:
        """And the errors are not merely large: their unit is that of the differences."""
        num, scores = 4000, []
        for seed in range(25):
            world = make_world(seed)
            drawn = world.sample(num, np.random.default_rng(seed + 1000))
            log_weight = world.log_weight[drawn]
            ess = effective_sample_size(log_weight)
            assert 0.3 * num < ess < num
            estimate = avoid_probability(log_weight, world.bits[drawn], 9)
            error = np.sqrt(estimate.avoid_variance)
            scores.append((estimate.avoid_probability - world.avoid_probability) / error)
            difference = log_partition(log_weight) - world.log_partition
            assert abs(difference) < STANDARD_ERRORS * math.sqrt(1.0 / ess - 1.0 / num)
        assert np.abs(scores).max() < STANDARD_ERRORS
        assert 0.85 < np.sqrt(np.mean(np.square(scores))) < 1.15

    def test_equal_weights_would_be_wrong_there(self) -> None:
        world = make_world(0)
        drawn = world.sample(4000, np.random.default_rng(0))
        plain = avoid_probability(np.zeros(4000), world.bits[drawn], 9)
        error = np.sqrt(plain.avoid_variance)
        off = np.abs(plain.avoid_probability - world.avoid_probability) / error
        assert off.max() > 2 * STANDARD_ERRORS

    def test_another_temperature(self) -> None:
        """The paper, Theorem 2: sampled at beta 1, asked at beta 0.6."""
        world = make_world(3)
        reward = world.log_target
        asked = world._replace(log_target=0.6 * reward)
        sampled = world._replace(log_proposal=reward - world.log_partition)
        drawn = sampled.sample(20_000, np.random.default_rng(5))
        log_weight = log_weights(
            reward[drawn],
            sampled.log_proposal[drawn],
            np.ones(20_000),
            beta=0.6,
            measure="counting",
            num_actions=1,
        )
        assert effective_sample_size(log_weight) > 10_000
        estimate = avoid_probability(log_weight, world.bits[drawn], 9)
        off = (estimate.avoid_probability - asked.avoid_probability) / np.sqrt(
            estimate.avoid_variance
        )
        assert np.abs(off).max() < STANDARD_ERRORS
        assert log_partition(log_weight) == pytest.approx(asked.log_partition, abs=0.05)
        assert np.abs(asked.avoid_probability - world.avoid_probability).max() > 0.02

    def test_delta_method_variance_is_the_spread_over_repeated_draws(self) -> None:
        world = make_world(7)
        generator = np.random.default_rng(7)
        estimates = []
        for _ in range(1500):
            drawn = world.sample(400, generator)
            estimates.append(avoid_probability(world.log_weight[drawn], world.bits[drawn], 9))
        spread = np.var([e.avoid_probability for e in estimates], axis=0)
        variance = np.mean([e.avoid_variance for e in estimates], axis=0)
        np.testing.assert_allclose(variance, spread, rtol=0.15)

    def test_kl_is_measured_with_the_exact_log_partition(self) -> None:
        world = make_world(2)
        proposal = np.exp(world.log_proposal)
        exact = float(proposal @ (world.log_proposal - np.log(world.nominal)))
        drawn = world.sample(20_000, np.random.default_rng(2))
        log_weight = world.log_weight[drawn]
        error = log_weight.std() / math.sqrt(20_000)
        found = kl_divergence(log_weight, world.log_partition)
        assert found == pytest.approx(exact, abs=STANDARD_ERRORS * error)
        assert exact > 20 * error


WEIGHING = [
    normalise,
    effective_sample_size,
    log_partition,
    lambda log_weight: kl_divergence(log_weight, 0.0),
]


class TestRefused:
    def test_rows_and_weights_of_different_number(self) -> None:
        message = "one row of violations a log-weight, got 4 rows and 3 weights"
        with pytest.raises(ValueError, match=message):
            avoid_probability(np.zeros(3), np.zeros((4, 1), np.uint8), 5)

    @pytest.mark.parametrize("estimate", WEIGHING)
    def test_nothing_left_to_weigh(self, estimate) -> None:
        message = "all 7 sampled trajectories enter a known constraint: nothing is left to weigh"
        with pytest.raises(ValueError, match=message):
            estimate(np.full(7, -np.inf))
        with pytest.raises(ValueError, match=message):
            avoid_probability(np.full(7, -np.inf), np.zeros((7, 1), np.uint8), 5)

    @pytest.mark.parametrize("estimate", WEIGHING)
    def test_weights_that_are_nan(self, estimate) -> None:
        with pytest.raises(ValueError, match="2 of 4 log-weights are NaN"):
            estimate(np.array([0.0, np.nan, -np.inf, np.nan]))


def test_parts_tell_the_rarest_avoiding_apart_from_rounding() -> None:
    log_weight = np.concatenate([np.zeros(999), [-45.0]])
    violations = np.zeros((1000, 3), bool)
    violations[:999, 0] = True  # only the last, of a weight of 3e-20, avoids
    violations[:, 1] = True
    group = np.arange(1000) % 10
    bits = np.packbits(violations, axis=1, bitorder="little")
    found = parts(log_weight, bits, 3, group)
    whole = avoid_probability(log_weight, bits, 3).avoid_probability
    np.testing.assert_allclose(found.avoided.sum(axis=0), whole, rtol=1e-12)
    assert 0.0 < found.avoided[9, 0] < 1e-19
    without = found.avoid_without()
    assert without[9, 0] == 0.0  # without the group that it is of
    assert (without[:9, 0] > 0.0).all()
    assert (without[:, 1] == 0.0).all()
    np.testing.assert_allclose(without[:, 2], 1.0)


def test_nan_weights_are_refused() -> None:
    with pytest.raises(ValueError, match="1 of 2 log-weights are NaN"):
        avoid_probability(np.array([0.0, np.nan]), np.zeros((2, 1), np.uint8), 3)


def test_one_group_with_all_the_weight_shows_no_spread() -> None:
    log_weight = np.where(np.arange(100) < 10, 0.0, -np.inf)
    bits = pack(np.arange(200).reshape(100, 2) % 3 == 0)
    group = np.arange(100) // 10
    assert np.isinf(parts(log_weight, bits, 2, group).variance()).all()
    assert np.isfinite(parts(log_weight, bits, 2, np.arange(100) % 10).variance()).all()


def test_errors_of_the_same_sample_add_up_and_others_add_in_squares() -> None:
    error = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, 3.0]])
    np.testing.assert_allclose(joint_error(error, np.array([0, 0, 1])), [5.0, 3.0])
    np.testing.assert_allclose(joint_error(error[:, 0], np.array([1, 0, 1])), math.hypot(5.0, 2.0))
    np.testing.assert_allclose(joint_error(error, np.arange(3)), np.linalg.norm(error, axis=0))
    assert joint_error(np.zeros(0), np.zeros(0, int)) == 0.0
