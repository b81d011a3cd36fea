"""Evidence by which each hypothesis is entered with a chosen chance."""

from __future__ import annotations

import numpy as np
from support.synthetic import evidence_of_columns

from swerve.evidence.evidence import Evidence
from swerve.hypotheses.grid import grid

CELLS = grid(x=(0.0, 10.0, 10))  # hypothesis k: k <= x < k + 1; the tasks start in 1, 5 and 9


def evidence_with_chances(
    chances: list[float] | np.ndarray, num: int = 1000, num_tasks: int = 3, seed: int = 0
) -> Evidence:
    """Equal weights; hypothesis k is entered by this share of the trajectories of every task."""
    generator = np.random.default_rng(seed)
    columns = np.zeros((num_tasks, num, len(chances)), bool)
    for task in columns:
        for k, chance in enumerate(chances):
            task[generator.permutation(num)[: round(chance * num)], k] = True
    return evidence_of_columns(columns, CELLS)


RISING = [0.05 * k for k in range(10)]
