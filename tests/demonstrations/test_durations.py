"""Durations that are far too long, and the units that explain them."""

from __future__ import annotations

import pytest

from swerve.demonstrations.durations import (
    first_time_hint,
    is_since_1970,
    is_too_long,
    likely_unit,
    unit_hint,
)


@pytest.mark.parametrize(
    ("duration", "unit"),
    [
        (1e-300, ""),
        (5 / 3600, "hours"),
        (5 / 60, "minutes"),
        (0.2, "minutes"),
        (0.5, ""),  # a demonstration of 5 s that was cut short
        (1.0, ""),
        (5.0, ""),
        (100.0, ""),
        (250.0, ""),  # a long recording of a short task
        (900.0, ""),
        (1.1e3, "milliseconds"),
        (5e3, "milliseconds"),
        (2e4, "milliseconds"),
        (1e5, ""),
        (5e6, "microseconds"),
        (5e9, "nanoseconds"),
        (2e10, "nanoseconds"),
        (1e11, ""),
        (1e12, ""),
        (1e308, ""),
    ],
)
def test_the_unit_that_comes_nearest_to_five_seconds(duration: float, unit: str) -> None:

    assert likely_unit(duration, 5.0) == unit
    assert unit_hint(duration, 5.0) == (f". The times may be {unit}" if unit else "")


def test_too_long_is_a_thousand_horizons() -> None:
    assert not is_too_long(5000.0, 5.0)
    assert is_too_long(5001.0, 5.0)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_times_of_a_clock_are_no_unit_of_durations(unit: float) -> None:
    assert is_since_1970(1.7e9 * unit)
    assert not is_since_1970(9e8 * unit)
    assert not is_since_1970(5e9 * unit)
    hint = ". These may be times since 1970: subtract the time of the first state"
    assert first_time_hint(1.7e9 * unit, 5.0) == hint
    assert first_time_hint(5e3, 5.0) == ". The times may be milliseconds"
