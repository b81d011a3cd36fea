"""Properties that hold for the estimates of all samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.weighted_worlds import make_world, pack, random_sample

from swerve.evidence.estimators import (
    BLOCK,
    avoid_probability,
    effective_sample_size,
    kl_divergence,
    log_partition,
    normalise,
)
from swerve.hypotheses.bits import unpack

seeds = st.integers(0, 2**32 - 1)


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
