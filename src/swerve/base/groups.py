"""Add up the rows of an array by group."""

from __future__ import annotations

import numpy as np


def sums_of_groups(values: np.ndarray, group: np.ndarray, num_groups: int) -> np.ndarray:
    """Return the sum [G, ...] of the rows [R, ...] of each group; 0 where a group has no rows.

    Args:
      values: [R, ...] numbers or booleans.
      group: [R] each row's group, from 0.
      num_groups: G.
    """
    sums = np.zeros((num_groups, *values.shape[1:]))
    for row, number in zip(values, group.tolist(), strict=True):
        sums[number] += row  # a loop of long rows is ten times as fast as np.add.at
    return sums
