"""Checks of arguments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swerve.base.arguments import MOST_SEED, seed_number, whole_number


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
