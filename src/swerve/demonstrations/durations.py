"""Tell how long demonstrations may last, and in which unit the times are of one that is far off.

The unit is the one by which the duration D comes nearest to what is expected, E, in decades:

    min over units of |log10(D / E) - log10(units in a second)|.
"""

from __future__ import annotations

import math

MAX_HORIZONS = 1000.0
"""Horizons that rows may rest after the end of an episode, and that a monitor waits for a state."""

UNITS = {
    "milliseconds": 1e3,
    "microseconds": 1e6,
    "nanoseconds": 1e9,
    "minutes": 1 / 60,
    "hours": 1 / 3600,
}
"""Units that times may be in where seconds are expected, and how many are a second."""

# Decades: no unit explains a duration that is further off.
FARTHEST_SMALLER = 0.7  # demonstrators take up to five times as long as expected, or a fifth
FARTHEST_LARGER = 0.5  # for minutes and hours: demonstrations that are cut short are brief as well

FIRST_CLOCK, LAST_CLOCK = 1e9, 4e9  # s since 1970: from 2001 to 2096


def is_since_1970(time: float) -> bool:
    """Return whether a time may be one of a computer's clock, in seconds or a smaller unit."""
    units = (1.0, *(number for number in UNITS.values() if number > 1.0))
    return any(FIRST_CLOCK <= time / number <= LAST_CLOCK for number in units)


def is_too_long(duration: float, horizon: float) -> bool:
    """Return whether a duration [s] is far too long for an episode of at most `horizon` seconds."""
    return duration > MAX_HORIZONS * horizon


def likely_unit(duration: float, expected: float) -> str:
    """Return the unit in which a duration is about as expected [s]; '' for seconds, or for none."""
    decades = math.log10(duration) - math.log10(expected)  # their ratio might overflow
    away = {unit: abs(decades - math.log10(number)) for unit, number in UNITS.items()}
    unit = min(away, key=lambda unit: away[unit])
    farthest = FARTHEST_SMALLER if UNITS[unit] > 1.0 else FARTHEST_LARGER
    return unit if away[unit] < farthest else ""


def unit_hint(duration: float, expected: float) -> str:
    """Return the end of a message, which names the likely unit; '' where there is none."""
    unit = likely_unit(duration, expected)
    return f". The times may be {unit}" if unit else ""


def first_time_hint(time: float, horizon: float) -> str:
    """Return the end of a message about a first time that is far too late: its clock, or unit."""
    if is_since_1970(time):
        return ". These may be times since 1970: subtract the time of the first state"
    return unit_hint(time, horizon)
