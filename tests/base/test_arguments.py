"""Checks of arguments."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from swerve.base.arguments import (
    MOST_SEED,
    number_or_nan,
    real_numbers,
    seed_number,
    whole_number,
)


@pytest.mark.parametrize("value", [3, np.int32(3), np.uint8(3)])
def test_whole_numbers_of_any_kind(value: Any) -> None:
    assert whole_number(value, "seed", 3) == 3
    assert type(whole_number(value, "seed", 3)) is int


@pytest.mark.parametrize("value", [2, -1, 3.0, 1e3, True, "3", None])
def test_what_is_no_whole_number_or_too_small(value: Any) -> None:
    with pytest.raises(ValueError, match=f"^seed: expected a whole number >= 3, got {value!r}$"):
        whole_number(value, "seed", 3)


@pytest.mark.parametrize("value", [-1, 2**32, 2**63, 10**30, 0.5])
def test_what_is_no_seed(value: Any) -> None:
    """JAX would take the last 32 bits of a larger seed, which are those of another seed."""
    assert seed_number(MOST_SEED) == MOST_SEED
    with pytest.raises(ValueError, match=rf"^seed: .* from 0 to 4,294,967,295, got {value!r}$"):
        seed_number(value)


NO_NUMBERS = (
    "2_5",
    b"25",
    None,
    np.datetime64("2024-01-01", "ns"),
    np.timedelta64(5, "s"),
    object(),
    10**400,
    np.void(b"12345678"),
)


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_what_are_no_numbers(value: Any) -> None:
    for values in (value, [[value, value]], [[1.0, value]], np.array([1.0, value], object)):
        with pytest.raises(ValueError, match=r"^x: expected numbers, got "):
            real_numbers(values, "x")
    assert np.isnan(number_or_nan(value))


def test_arrays_of_text_and_of_dates_are_no_numbers() -> None:
    for values in (
        [["2_5", "1"]],
        np.array(["1", "2"]),
        np.array([b"1", b"2"]),
        np.array(["2020-01-01"], "datetime64[ns]"),
    ):
        with pytest.raises(ValueError, match=r"^x: expected numbers, got "):
            real_numbers(values, "x")
    with pytest.raises(ValueError, match=r"^x: expected real numbers, got "):
        real_numbers([1.0, 2j], "x")


@pytest.mark.parametrize(
    "value", [25, 25.0, Decimal(25), Fraction(25), np.float32(25), np.uint8(25)]
)
def test_real_numbers_of_any_kind(value: Any) -> None:
    for values in ([value, value], [value, Decimal(25)], np.array([value, 25.0], object)):
        found = real_numbers(values, "x")
        assert found.dtype == np.float64
        assert found.tolist() == [25.0, 25.0]
    assert number_or_nan(value) == 25.0
    assert real_numbers([True, 2**70], "x").tolist() == [1.0, 2.0**70]
    assert np.isnan(number_or_nan(True))
