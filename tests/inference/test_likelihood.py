"""Likelihood ratios with a tolerance, and what tasks say nothing of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic import evidence_of_columns, make_demonstration

from swerve.answer import infer
from swerve.hypotheses.grid import grid
from swerve.inference import likelihood

CELLS = grid(x=(0.0, 10.0, 5))
CHANCES = np.array([0.05, 0.3, 0.6, 0.9, 0.5])

seeds = st.integers(0, 2**31 - 1)


def sampled(seed: int = 0):
    """Evidence of three tasks."""
    generator = np.random.default_rng(seed)
    return evidence_of_columns(generator.random((3, 1_000, 5)) < CHANCES, CELLS)


@given(seed=seeds, tolerance=st.sampled_from([0.0, 1e-3, 0.1, 0.5]))
@settings(max_examples=50)
def test_is_the_product_over_demonstrations(seed: int, tolerance: float) -> None:
    generator = np.random.default_rng(seed)
    tasks = generator.integers(3, size=4)
    log_ratio = -generator.exponential(2.0, (3, 5))
    entered = generator.random((4, 5)) < 0.3
    counts = likelihood.Counts(np.zeros((3, 5)), np.zeros((3, 5)))
    product = np.ones(5)
    for task, row in zip(tasks, entered, strict=True):
        counts.entering[task] += row
        counts.avoiding[task] += ~row
        product *= tolerance + (1 - tolerance) * ~row / np.exp(log_ratio[task])
    found = np.exp(likelihood.log_likelihood(log_ratio, counts, tolerance))
    np.testing.assert_allclose(found, product, rtol=1e-10)


def test_sensitivity_is_the_slope() -> None:
    log_ratio, step = np.array([-20.0, -3.0, -0.5, 0.0]), 1e-6
    for tolerance in (0.0, 1e-4, 0.3):
        rise = likelihood.avoiding_term(log_ratio + step, tolerance) - likelihood.avoiding_term(
            log_ratio, tolerance
        )
        found = likelihood.sensitivity(log_ratio, tolerance)
        np.testing.assert_allclose(found, -rise / step, rtol=1e-4)


class TestTolerance:
    def test_one_stray_track_does_not_veto(self) -> None:
        evidence = sampled()
        stray = make_demonstration(0, "stray", x=7.0)  # enters cell 3, as all start in cell 0
        good = [make_demonstration(0, f"d{k}") for k in range(5)]
        strict, tolerant = (
            infer(evidence, [*good, stray]),
            infer(evidence, [*good, stray], tolerance=0.02),
        )
        assert strict.struck_out[3]
        assert not tolerant.struck_out.any()
        assert tolerant.ranking[0] == 3
        ratio = 1.0 - evidence.violation_probability[0, 3]
        expected = 5 * math.log(0.02 + 0.98 / ratio) + math.log(0.02)
        assert tolerant.log_likelihood[3] == pytest.approx(expected)
        np.testing.assert_allclose(tolerant.contributions.sum(axis=0), tolerant.log_likelihood)
        assert tolerant.contributions[5, 3] == pytest.approx(math.log(0.02))
        assert strict.contributions[5, 3] == -math.inf

    def test_a_tolerance_of_zero_is_the_limit(self) -> None:
        evidence, demonstrations = sampled(), [make_demonstration(0), make_demonstration(2, "c")]
        strict = infer(evidence, demonstrations)
        tolerant = infer(evidence, demonstrations, tolerance=1e-9)
        left = ~strict.struck_out
        assert left.any()
        np.testing.assert_allclose(
            tolerant.log_likelihood[left], strict.log_likelihood[left], atol=1e-6
        )
        np.testing.assert_allclose(
            tolerant.standard_error[left], strict.standard_error[left], rtol=1e-6
        )
        np.testing.assert_allclose(tolerant.posterior.none, strict.posterior.none, atol=1e-6)

    @pytest.mark.parametrize("tolerance", [1.0, -0.1, math.nan, 0.51, "a", None])
    def test_out_of_range(self, tolerance: Any) -> None:
        with pytest.raises(ValueError, match=f"from 0 to 0.5, got {tolerance!r}"):
            infer(sampled(), [make_demonstration(0)], tolerance=tolerance)

    def test_none_of_these_and_the_tolerance_that_would_change_it(self) -> None:
        evidence = sampled()
        wanderer = make_demonstration(0, "wanderer")
        wanderer.states[:, 1] = [wanderer.states[0, 1], 3.0, 5.0, 7.0, 9.0]
        good = [make_demonstration(0, f"d{k}") for k in range(5)]
        result = infer(evidence, [*good, wanderer])
        assert result.struck_out.all()
        assert result.posterior.none == 1.0
        assert result.credible_set().has_none
        least = result.least_tolerance
        assert least is not None
        above = infer(evidence, [*good, wanderer], tolerance=1.002 * least).posterior
        assert above.hypotheses.max() > above.none
        below = infer(evidence, [*good, wanderer], tolerance=0.998 * least).posterior
        assert below.hypotheses.max() < below.none
        [warning] = [text for text in result.warnings if "no hypothesis is left" in text]
        assert f"; with a tolerance of about {least:.2g} or more (some demonstrations" in warning
        alone = infer(evidence, [wanderer])
        assert alone.least_tolerance is None
        assert "no tolerance makes a hypothesis more probable" in alone.warnings[0]


class TestClearance:
    def test_hypotheses_near_the_ends_of_a_task_are_left_out_for_it(self) -> None:
        """Starts are at x = 1, 5, 9 and goals at 2, 2, 8; cells are 2 wide."""
        evidence = sampled()
        near = infer(evidence, clearance=1.5)
        expected = [[0, 0, 1, 1, 1], [0, 0, 0, 0, 1], [1, 1, 1, 0, 0]]
        np.testing.assert_array_equal(near.is_counted, np.array(expected, bool))
        demonstrations = [make_demonstration(k, f"d{k}") for k in range(3)]
        result = infer(evidence, demonstrations, clearance=1.5)
        assert not result.struck_out.any()  # each rests at its start, in a cell that it leaves out
        expected = -(near.is_counted * evidence.log_ratio).sum(axis=0)
        np.testing.assert_allclose(result.log_likelihood, expected)
        np.testing.assert_allclose(result.contributions.sum(axis=0), result.log_likelihood)
        error = (near.is_counted * evidence.standard_error**2).sum(axis=0) ** 0.5
        np.testing.assert_allclose(result.standard_error, error)

    def test_what_nothing_is_told_of_is_said(self) -> None:
        evidence = sampled()
        demonstrations = [make_demonstration(2)]  # counts no cells but 0, 1 and 2
        [warning] = infer(evidence, demonstrations, clearance=1.5).warnings
        assert warning.startswith("these demonstrations tell nothing about 2 of the 5 hypotheses")
        assert not infer(evidence, demonstrations).warnings

    def test_none_counts_all(self) -> None:
        assert infer(sampled()).is_counted.all()

    @pytest.mark.parametrize("clearance", [-1.0, math.nan, math.inf, "far", True])
    def test_bad_distance(self, clearance: Any) -> None:
        with pytest.raises(ValueError, match="clearance: expected a distance >= 0"):
            infer(sampled(), clearance=clearance)


class TestMargin:
    def test_noise_at_the_edge_does_not_strike_out(self) -> None:
        evidence = sampled()
        grazing = make_demonstration(2, "grazing", x=2.1)
        assert infer(evidence, [grazing]).struck_out[1]
        assert not infer(evidence, [grazing], margin={"x": 0.2}).struck_out[1]
        deep = make_demonstration(2, "deep", x=3.0)
        assert infer(evidence, [deep], margin={"x": 0.2}).struck_out[1]
        added = infer(evidence, margin={"x": 0.2}).add(grazing)
        assert not added.struck_out[1]

    def test_what_an_end_of_the_task_grazes_is_left_out_for_it(self) -> None:
        evidence = sampled()  # tasks 0 and 1 end at x = 2.0, in cell 1: [2, 4)
        grazing, deep = make_demonstration(0, "grazing"), make_demonstration(0, "deep", x=3.0)
        for margin, counts in ((None, True), ({"x": 0.2}, False), ({"theta": 0.2}, True)):
            result = infer(evidence, [grazing, deep], margin=margin)
            assert result.is_counted[:, 1].tolist() == [counts, counts, True]
            assert result.struck_out[1] == counts
        assert infer(evidence, margin={"x": 0.2}).is_counted[:, [0, 2, 3]].all()
