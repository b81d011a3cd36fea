"""Sums by group."""

from __future__ import annotations

import numpy as np
import pytest

from swerve.base.groups import sums_of_groups


@pytest.mark.parametrize(
    "shape", [(200,), (200, 3), (200, 0), (0, 3), (200, 2, 3), (20, 90), (20, 5, 9)]
)
@pytest.mark.parametrize("kind", [bool, int, float])
def test_each_group_has_the_sum_of_its_rows(shape: tuple[int, ...], kind: type) -> None:
    generator = np.random.default_rng(0)
    values = (10.0 * generator.normal(size=shape)).astype(kind)
    group = generator.integers(0, 5, shape[0]) * 2  # 1, 3, 5, 7 and 9 have no rows
    found = sums_of_groups(values, group, 10)
    assert found.shape == (10, *shape[1:])
    assert found.dtype == float
    for number, total in enumerate(found):
        np.testing.assert_allclose(total, values[group == number].sum(axis=0), atol=1e-12)
