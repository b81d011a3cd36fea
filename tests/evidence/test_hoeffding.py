"""Hoeffding's bound for equal weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.evidence.estimators import hoeffding_error, hoeffding_sample_size


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


@pytest.mark.parametrize("num", [0, -3])
def test_hoeffding_needs_a_trajectory(num: int) -> None:
    with pytest.raises(ValueError, match=f"num_trajectories: expected .* >= 1, got {num}"):
        hoeffding_error(num)
