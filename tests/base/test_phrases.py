"""Numbers that a message compares never look the same where they differ."""

from __future__ import annotations

import pytest

from swerve.base.phrases import told_apart


@pytest.mark.parametrize(
    ("value", "other", "digits", "texts"),
    [
        (1.0, 1.0, 4, ("1", "1")),
        (1.0, 2.0, 4, ("1", "2")),
        (1.00004, 1.0, 4, ("1.00004", "1")),
        (3.14159, 3.14162, 4, ("3.14159", "3.14162")),
        (0.00101, 0.001, 2, ("0.00101", "0.001")),
        (1e6 + 1.5, 1e6, 4, ("1000002", "1000000")),
        (0.1 + 0.2, 0.3, 4, ("0.3", "0.3")),  # the rounding of float64
        (0.0, -1e-9, 4, ("0", "-1e-09")),
        (3.1415927410125732, 3.1415927410125732, 4, ("3.142", "3.142")),
        (1.0 / 3.0, 1.0 / 3.0 + 1e-16, 2, ("0.33", "0.33")),
    ],
)
def test_digits_until_numbers_differ(
    value: float, other: float, digits: int, texts: tuple[str, str]
) -> None:
    assert told_apart(value, other, digits) == texts
    assert told_apart(other, value, digits) == texts[::-1]
