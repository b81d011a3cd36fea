from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from swerve.evidence.estimators import (
    BLOCK,
    avoid_probability,
    effective_sample_size,
    hoeffding_error,
    hoeffding_sample_size,
    kl_divergence,
    log_partition,
    log_weights,
    normalise,
    parts,
)
from swerve.hypotheses.bits import unpack

seeds = st.integers(0, 2**32 - 1)
STANDARD_ERRORS = 4.5


class World(NamedTuple):
    """All M trajectories there are: log m exp(beta R), log pi, and what each enters."""

    log_target: np.ndarray
    log_proposal: np.ndarray
    violates: np.ndarray

    @property
    def log_partition(self) -> float:
        return math.log(np.exp(self.log_target).sum())

    @property
    def nominal(self) -> np.ndarray:
        return np.exp(self.log_target) / np.exp(self.log_target).sum()

    @property
    def avoid_probability(self) -> np.ndarray:
        return self.nominal @ ~self.violates

    @property
    def log_weight(self) -> np.ndarray:
        return self.log_target - self.log_proposal

    def sample(self, num: int, generator: np.random.Generator) -> np.ndarray:
        return generator.choice(len(self.log_target), num, p=np.exp(self.log_proposal))

    @property
    def bits(self) -> np.ndarray:
        return pack(self.violates)


def pack(violates: np.ndarray) -> np.ndarray:
    return np.packbits(violates, axis=-1, bitorder="little")


def make_world(seed: int, num: int = 40, num_hypotheses: int = 9, spread: float = 0.7) -> World:
    generator = np.random.default_rng(seed)
    log_target = generator.normal(2.0, 1.0, num)
    log_proposal = log_target + generator.normal(0.0, spread, num)
    log_proposal -= np.log(np.exp(log_proposal).sum())
    violates = generator.random((num, num_hypotheses)) < generator.uniform(0.3, 0.7, num_hypotheses)
    return World(log_target, log_proposal, violates)


def random_sample(
    generator: np.random.Generator, num: int = 60, num_hypotheses: int = 11
) -> tuple[np.ndarray, np.ndarray]:
    violates = generator.random((num, num_hypotheses)) < generator.random(num_hypotheses)
    return generator.normal(-100.0, 2.0, num), violates


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


class TestProperties:
    @given(seed=seeds, shift=st.floats(-1e4, 1e4))
    def test_a_constant_moves_only_log_partition(self, seed, shift) -> None:
        log_weight, violates = random_sample(np.random.default_rng(seed))
        moved = log_weight + shift
        a, b = (avoid_probability(values, pack(violates), 11) for values in (log_weight, moved))
        np.testing.assert_allclose(a.avoid_probability, b.avoid_probability, atol=1e-9)
        np.testing.assert_allclose(a.avoid_variance, b.avoid_variance, atol=1e-9)
        assert effective_sample_size(moved) == pytest.approx(effective_sample_size(log_weight))
        log_z = log_partition(log_weight)
        assert log_partition(moved) == pytest.approx(log_z + shift, abs=1e-8)
        assert kl_divergence(moved, log_z + shift) == pytest.approx(
            kl_divergence(log_weight, log_z), abs=1e-8
        )

    @given(seed=seeds)
    def test_order_of_trajectories_and_hypotheses_does_not_matter(self, seed) -> None:
        generator = np.random.default_rng(seed)
        log_weight, violates = random_sample(generator)
        rows, columns = generator.permutation(60), generator.permutation(11)
        a = avoid_probability(log_weight, pack(violates), 11)
        b = avoid_probability(log_weight[rows], pack(violates[rows][:, columns]), 11)
        np.testing.assert_allclose(a.avoid_probability[columns], b.avoid_probability, rtol=1e-12)
        np.testing.assert_allclose(a.avoid_variance[columns], b.avoid_variance, atol=1e-15)
        assert log_partition(log_weight[rows]) == pytest.approx(log_partition(log_weight))
        assert effective_sample_size(log_weight[rows]) == pytest.approx(
            effective_sample_size(log_weight)
        )

    @given(seed=seeds)
    def test_one_more_constraint_never_raises_the_partition_function(self, seed) -> None:
        """A trajectory avoids two constraints only if it avoids each."""
        log_weight, violates = random_sample(np.random.default_rng(seed))
        unions = violates[:, :-1] | violates[:, 1:]
        single = avoid_probability(log_weight, pack(violates), 11).avoid_probability
        union = avoid_probability(log_weight, pack(unions), 10).avoid_probability
        assert (union <= np.minimum(single[:-1], single[1:]) + 1e-12).all()
        assert (union >= single[:-1] + single[1:] - 1.0 - 1e-12).all()

    @given(seed=seeds, scale=st.floats(0.0, 50.0))
    def test_ranges(self, seed, scale) -> None:
        log_weight, violates = random_sample(np.random.default_rng(seed))
        log_weight = scale * log_weight
        assert 1.0 - 1e-9 <= effective_sample_size(log_weight) <= 60.0 + 1e-9
        estimate = avoid_probability(log_weight, pack(violates), 11)
        assert (estimate.avoid_probability >= 0.0).all()
        assert (estimate.avoid_probability <= 1.0).all()
        assert (estimate.avoid_variance >= 0.0).all()
        assert normalise(log_weight).sum() == pytest.approx(1.0)
        # Jensen: the estimated log Z is never below the mean log-weight
        assert kl_divergence(log_weight, log_partition(log_weight)) >= -1e-9

    @given(seed=seeds, num=st.integers(2, 300))
    def test_equal_weights_are_plain_fractions(self, seed, num) -> None:
        generator = np.random.default_rng(seed)
        violates = generator.random((num, 11)) < generator.random(11)
        estimate = avoid_probability(np.full(num, -3.7), pack(violates), 11)
        fraction = 1.0 - violates.mean(axis=0)
        np.testing.assert_allclose(estimate.avoid_probability, fraction, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            estimate.avoid_variance, fraction * (1.0 - fraction) / num, rtol=0, atol=1e-14
        )
        assert effective_sample_size(np.full(num, -3.7)) == pytest.approx(num)

    def test_equal_weights_are_exact_fractions_of_a_power_of_two(self) -> None:
        violates = np.arange(64)[:, None] < np.arange(65)
        estimate = avoid_probability(np.full(64, 2.5), pack(violates), 65)
        np.testing.assert_array_equal(estimate.avoid_probability, 1.0 - np.arange(65) / 64)
        assert effective_sample_size(np.full(64, 2.5)) == 64.0
        assert log_partition(np.full(64, 2.5)) == 2.5

    def test_a_policy_that_is_the_nominal_one_has_kl_zero(self) -> None:
        world = make_world(4)
        same = world._replace(log_proposal=world.log_target - world.log_partition)
        drawn = same.sample(500, np.random.default_rng(4))
        log_weight = same.log_weight[drawn]
        assert log_partition(log_weight) == pytest.approx(world.log_partition, abs=1e-12)
        assert kl_divergence(log_weight, world.log_partition) == pytest.approx(0.0, abs=1e-12)
        assert effective_sample_size(log_weight) == pytest.approx(500.0)

    @given(seed=seeds)
    def test_trajectories_of_weight_zero_might_as_well_not_be_there(self, seed) -> None:
        """But for log Z_0, whose mean is over all that were drawn."""
        generator = np.random.default_rng(seed)
        log_weight, violates = random_sample(generator)
        forbidden = generator.random(60) < 0.5
        assume(0 < forbidden.sum() < 60)
        log_weight[forbidden] = -np.inf
        kept = ~forbidden
        a = avoid_probability(log_weight, pack(violates), 11)
        b = avoid_probability(log_weight[kept], pack(violates[kept]), 11)
        np.testing.assert_allclose(a.avoid_probability, b.avoid_probability, rtol=1e-12)
        np.testing.assert_allclose(a.avoid_variance, b.avoid_variance, atol=1e-15)
        assert effective_sample_size(log_weight) == pytest.approx(
            effective_sample_size(log_weight[kept])
        )
        missing = math.log(kept.mean())
        log_z = log_partition(log_weight)
        assert log_z == pytest.approx(log_partition(log_weight[kept]) + missing)
        assert kl_divergence(log_weight, log_z) == pytest.approx(
            kl_divergence(log_weight[kept], log_z - missing)
        )

    @settings(max_examples=20)
    @given(seed=seeds, num=st.sampled_from([1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 5]))
    def test_many_hypotheses_are_taken_in_blocks(self, seed, num) -> None:
        generator = np.random.default_rng(seed)
        log_weight, violates = random_sample(generator, num=20, num_hypotheses=num)
        estimate = avoid_probability(log_weight, pack(violates), num)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        avoided = weight @ ~violates
        assert estimate.avoid_probability.shape == estimate.avoid_variance.shape == (num,)
        np.testing.assert_allclose(estimate.avoid_probability, avoided, atol=1e-12)
        variance = weight**2 @ (~violates - avoided) ** 2
        np.testing.assert_allclose(estimate.avoid_variance, variance, atol=1e-12)
        np.testing.assert_array_equal(unpack(pack(violates), num), violates)

    def test_extreme_weights_neither_overflow_nor_vanish(self) -> None:
        log_weight = np.array([1e5, 1e5 + math.log(3.0), -1e5])
        assert log_partition(log_weight) == pytest.approx(1e5 + math.log(4.0 / 3.0), abs=1e-9)
        violates = np.array([[True], [False], [True]])
        estimate = avoid_probability(log_weight, pack(violates), 1)
        assert estimate.avoid_probability[0] == pytest.approx(0.75, abs=1e-9)


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


class TestHoeffding:
    def test_the_numbers_of_the_paper(self) -> None:
        assert hoeffding_error(10_000) == pytest.approx(0.0136, abs=5e-5)
        assert hoeffding_error(10_000, 0.99) == pytest.approx(0.01628, abs=5e-6)

    @given(num=st.integers(1, 10**8), confidence=st.floats(0.01, 0.999))
    def test_solves_the_bound(self, num, confidence) -> None:
        error = hoeffding_error(num, confidence)
        assert 2.0 * math.exp(-2.0 * error**2 * num) == pytest.approx(1.0 - confidence, rel=1e-9)

    @given(error=st.floats(1e-3, 0.9), confidence=st.floats(0.01, 0.999))
    def test_the_sample_size_is_the_smallest_that_suffices(self, error, confidence) -> None:
        num = hoeffding_sample_size(error, confidence)
        assert hoeffding_error(num, confidence) <= error * (1 + 1e-12)
        if num > 1:
            assert hoeffding_error(num - 1, confidence) >= error * (1 - 1e-12)

    def test_bounds_the_errors_of_equal_weights(self) -> None:
        generator = np.random.default_rng(0)
        fractions = generator.binomial(200, 0.5, 4000) / 200
        missed = np.mean(np.abs(fractions - 0.5) > hoeffding_error(200, 0.9))
        assert 0.0 < missed < 0.1

    @pytest.mark.parametrize("confidence", [0.0, 1.0, -0.5, 95.0, math.nan])
    def test_confidence_out_of_range_is_refused(self, confidence: float) -> None:
        message = f"confidence: expected a number between 0 and 1, got {confidence}"
        with pytest.raises(ValueError, match=message):
            hoeffding_error(100, confidence)
        with pytest.raises(ValueError, match=message):
            hoeffding_sample_size(0.1, confidence)

    @pytest.mark.parametrize("error", [0.0, 1.0, -0.1, math.nan])
    def test_an_error_out_of_range_is_refused(self, error: float) -> None:
        with pytest.raises(
            ValueError, match=f"error: expected a number between 0 and 1, got {error}"
        ):
            hoeffding_sample_size(error)


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
