"""One grammar of decimal numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.decimals import decimal_number, whole_decimal


@pytest.mark.parametrize("text", ["0", "-0", "+1", "007", "1.", ".5", "-1.5e3", "1E+05", "2e-400"])
def test_decimal_numbers_are_read(text: str) -> None:
    assert decimal_number(text) == float(text)


@pytest.mark.parametrize(
    "text",
    [
        "", " ", "1 ", " 1", "2_5", "1e5_0", "1,5", "1.2.3", "0x10", "1d3", "1e", "e5", ".", "+",
        "--1", "+-1", "1e5.", "1e+", "nan", "inf", "-inf", "Infinity", "TRUE", "true", "None", "1f",
        "1L", "1j", "\u0661", "\uff11", "1\u00a0", "\u22121", "1\n", "\n1", "1\x00", "1%", "$1",
        "1'000", "0b1", "1/2",
    ],
)  # fmt: skip
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a decimal number, got "):
        decimal_number(text)


def test_numbers_too_large_for_a_float_are_refused() -> None:
    with pytest.raises(ValueError, match="expected a number that a float can hold, got '1e400'"):
        decimal_number("1e400")


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_is_read_back(number: float) -> None:
    for text in (repr(number), f"{number:.17g}", f"{number:+.16E}"):
        assert decimal_number(text) == number


def test_whole_numbers() -> None:
    for text, number in (
        ("-3", -3),
        ("2e6", 2_000_000),
        ("12345678901234567890", 12345678901234567890),
    ):
        assert whole_decimal(text) == number
    with pytest.raises(ValueError, match=r"expected a whole number, got '1\.5'"):
        whole_decimal("1.5")
    for text in ("1_0", "0x10", "1e400"):
        with pytest.raises(ValueError, match="expected a "):
            whole_decimal(text)
