"""Samples are summed up task by task, with floors and errors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic import evidence_of_columns, make_evidence, make_record, make_samples

from swerve.constraints.boxes import Box
from swerve.evidence import estimators
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import summarise
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid


class TestSummary:
    @pytest.mark.parametrize("measure", ["uniform", "counting"])
    def test_each_task_is_estimated_from_its_own_samples(self, measure: str) -> None:
        record, samples = make_record(measure=measure), make_samples()
        evidence = make_evidence(record, samples)
        log_weight = 0.5 * samples.total_reward - samples.log_probability
        if measure == "uniform":
            log_weight = log_weight - samples.length * math.log(3)
        np.testing.assert_allclose(evidence.importance_log_weight, log_weight, rtol=1e-13)
        np.testing.assert_allclose(evidence.log_weight, log_weight, rtol=1e-13)
        for k in range(3):
            weight = np.exp(log_weight[k])
            avoids = ~unpack(samples.violations[k], 12)
            log_z = math.log(weight.mean())
            ess = weight.sum() ** 2 / (weight**2).sum()
            np.testing.assert_allclose(
                evidence.violation_probability[k], 1.0 - weight @ avoids / weight.sum(), atol=1e-12
            )
            assert evidence.log_partition[k] == pytest.approx(log_z)
            assert evidence.kl[k] == pytest.approx(log_z - log_weight[k].mean())
            assert evidence.effective_sample_size[k] == pytest.approx(ess)
            assert 100 < ess < 399

    def test_plain_weighs_all_alike_and_still_reports_the_weights(self) -> None:
        samples = make_samples()
        plain, weighted = (
            make_evidence(samples=samples, method=m) for m in ("plain", "importance")
        )
        fraction = unpack(samples.violations, 12).mean(axis=1)
        np.testing.assert_allclose(plain.violation_probability, fraction, atol=1e-12)
        np.testing.assert_array_equal(plain.log_weight, 0.0)
        for name in ("log_partition", "kl", "effective_sample_size", "importance_log_weight"):
            np.testing.assert_array_equal(getattr(plain, name), getattr(weighted, name))
        assert np.abs(plain.violation_probability - weighted.violation_probability).max() > 0.01

    @pytest.mark.parametrize("method", ["plain", "importance"])
    def test_trajectories_in_a_known_constraint_do_not_count(self, method: str) -> None:
        samples = make_samples()
        forbidden = np.arange(400) % 4 == 0
        samples.total_reward[:, forbidden] = -np.inf
        evidence = make_evidence(samples=samples, method=method)
        left = samples._replace(
            total_reward=samples.total_reward[:, ~forbidden],
            log_probability=samples.log_probability[:, ~forbidden],
            length=samples.length[:, ~forbidden],
            log_correction=samples.log_correction[:, ~forbidden],
            ancestor=samples.ancestor[:, : np.count_nonzero(~forbidden)],
            violations=samples.violations[:, ~forbidden],
        )
        alone = make_evidence(samples=left, method=method)
        np.testing.assert_allclose(
            evidence.violation_probability, alone.violation_probability, atol=1e-12
        )
        np.testing.assert_allclose(
            evidence.log_partition, alone.log_partition + math.log(0.75), atol=1e-12
        )
        np.testing.assert_allclose(evidence.kl, alone.kl, atol=1e-12)
        assert np.isneginf(evidence.log_weight[:, forbidden]).all()
        assert np.isfinite(evidence.log_weight[:, ~forbidden]).all()

    def test_nan_is_refused(self) -> None:
        samples = make_samples()
        samples.total_reward[1, 7] = np.nan
        with pytest.raises(ValueError, match="1 of 1200 log-weights are not finite"):
            summarise(make_record(), samples, "importance")

    def test_a_task_that_no_sample_survives_is_refused(self) -> None:
        samples = make_samples()
        samples.total_reward[2] = -np.inf
        with pytest.raises(ValueError, match="all 400 sampled trajectories enter a known"):
            summarise(make_record(), samples, "importance")


class TestFloorAndErrors:
    """128 equal weights: fractions are exact."""

    @pytest.fixture
    def evidence(self) -> Evidence:
        num_avoiding = np.array([0, 1, 2, 64, 127, 128])
        columns = np.arange(128)[:, None] >= num_avoiding
        return evidence_of_columns(columns[None], grid(x=(0.0, 6.0, 6)))

    def test_log_ratio_is_at_least_minus_log_n(self, evidence: Evidence) -> None:
        fractions = np.array([1, 1, 2, 64, 127, 128]) / 128
        np.testing.assert_allclose(evidence.log_ratio[0], np.log(fractions), atol=1e-14)
        np.testing.assert_array_equal(
            evidence.violation_probability[0], 1.0 - np.array([0, 1, 2, 64, 127, 128]) / 128
        )

    def test_floored_where_fewer_than_one_trajectory_avoids(self, evidence: Evidence) -> None:
        np.testing.assert_array_equal(evidence.is_floored[0], [True, *[False] * 5])

    def test_standard_error(self, evidence: Evidence) -> None:
        """1 where floored; sqrt((1 - p) / (p N)) by the delta method; 1 / N at least."""
        p = np.array([1, 2, 64, 127, 128]) / 128
        expected = np.maximum(np.sqrt((1.0 - p) / (128 * p)), 1 / 128)
        assert evidence.standard_error[0, 0] == 1.0
        np.testing.assert_allclose(evidence.standard_error[0, 1:], expected, rtol=1e-12)
        assert evidence.standard_error[0, -1] == 1 / 128

    def test_one_heavy_trajectory_resolves_nothing(self) -> None:
        """The floor rests on the effective sample size: here one of two has all the weight."""
        samples = make_samples(2, num_hypotheses=12)
        samples.total_reward[:] = [0.0, -20.0]
        samples.log_probability[:], samples.length[:] = -1.0, 5
        avoids = np.ones((3, 2, 12), bool)
        avoids[:, 0, 0] = avoids[:, 1, 1] = False  # 0 is avoided by the light one alone
        evidence = make_evidence(
            samples=samples._replace(violations=np.packbits(~avoids, axis=-1, bitorder="little"))
        )
        np.testing.assert_array_equal(evidence.is_floored[:, :3], [[True, False, False]] * 3)
        np.testing.assert_allclose(evidence.log_ratio[:, 0], 0.0, atol=1e-3)
        plain = dataclasses.replace(evidence, method="plain")
        np.testing.assert_allclose(plain.resolution, 0.5)
        np.testing.assert_array_equal(evidence.standard_error[:, 0], 1.0)
        # and no error is less than what one trajectory could change, 1 / ESS
        assert evidence.effective_sample_size == pytest.approx([1.0] * 3, abs=1e-3)
        np.testing.assert_allclose(evidence.standard_error[:, 2], 1.0, atol=1e-3)

    @given(seed=st.integers(0, 2**32 - 1))
    @settings(max_examples=30)
    def test_one_more_constraint_never_raises_the_ratio(self, seed) -> None:
        samples = make_samples(100, seed=seed)
        violates = unpack(samples.violations, 12)
        violates[..., 2] = violates[..., 0] | violates[..., 1]
        packed = np.packbits(violates, axis=-1, bitorder="little")
        ratio = make_evidence(samples=samples._replace(violations=packed)).log_ratio
        assert (ratio[:, 2] <= np.minimum(ratio[:, 0], ratio[:, 1]) + 1e-12).all()
        assert (ratio <= 0.0).all()
        assert (ratio >= -math.log(100)).all()

    @pytest.mark.parametrize("method", ["plain", "importance"])
    def test_what_enters_a_known_constraint_is_no_trajectory(self, method: str) -> None:
        """Of 400, 100 are allowed, and all of these enter 11: the bound is that of 100."""
        record = make_record(known=(Box(x=(9.9, 10.0)),))
        samples = make_samples()
        samples.total_reward[:] = np.where(np.arange(400) < 100, 0.0, -np.inf)
        samples.log_probability[:], samples.length[:] = -5.0, 5
        samples.violations[..., 1] |= 1 << 3
        evidence = make_evidence(record, samples, method=method)
        np.testing.assert_allclose(evidence.resolution, 0.01)
        np.testing.assert_allclose(evidence.log_ratio[:, 11], -math.log(100.0))
        np.testing.assert_array_equal(evidence.standard_error[:, 11], 1.0)
        for task in range(3):
            rows = np.arange(30, 100)
            assert evidence.resolution_among(task, rows) == pytest.approx(1.0 / 70.0)
        if method == "plain":
            assert evidence.hoeffding_error() == estimators.hoeffding_error(100)

    @pytest.mark.parametrize("method", ["plain", "importance"])
    @pytest.mark.parametrize("beta", [0.5, 0.8])
    def test_the_share_among_all_is_that_of_the_task(self, method: str, beta: float) -> None:
        evidence = make_evidence(method=method)
        evidence = evidence if beta == 0.5 else evidence.at_beta(beta)
        for task, share in enumerate(evidence.resolution):
            assert evidence.resolution_among(task, np.arange(400)) == pytest.approx(share)

    def test_hoeffding_is_for_equal_weights_alone(self) -> None:
        plain = make_evidence(method="plain", num_trajectories=10_000)
        assert plain.hoeffding_error() == pytest.approx(0.0136, abs=5e-5)
        assert plain.hoeffding_error(0.99) == estimators.hoeffding_error(10_000, 0.99)
        message = r"needs equal weights \(method 'plain'\), .* by 'importance': use standard_error"
        with pytest.raises(ValueError, match=message):
            make_evidence().hoeffding_error()
