"""What all comparisons with brute force share."""

from __future__ import annotations

import pytest

from swerve.problem import repeatable


@pytest.fixture(autouse=True)
def code_that_is_known_to_be_repeatable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the code of the worlds as Swerve's own: to try it takes a quarter of the time.

    `tests/problem/test_repeatable.py` is about that check.
    """
    monkeypatch.setattr(repeatable, "OWN", (repeatable.OWN, "brute_force."))
