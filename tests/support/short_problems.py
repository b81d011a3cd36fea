"""Short problems that enumeration answers, and how near estimates of them must be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.reference import CART_TASK, PENDULUM_TASK, Exact, short_cart, short_pendulum

from swerve import Box, Evidence
from swerve.evidence.samples import NUM_ISLANDS

STANDARD_ERRORS = 4.5
OF_ISLANDS = 6.1  # as unlikely, of Student's t with 19 degrees of freedom, as 4.5 of a normal
WALL = Box(x=(0.2, 0.5), v=(-2.0, -0.6))
PROBLEMS = {
    "pendulum": (short_pendulum(beta=0.15), PENDULUM_TASK),
    "ends-early": (short_cart(beta=2.0), CART_TASK),
    "counting": (short_cart(beta=2.0, measure="counting"), CART_TASK),
    "known": (short_cart(beta=2.0, known=[WALL]), CART_TASK),
}


def assert_within_errors(evidence: Evidence, truth: Exact) -> None:
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / evidence.effective_sample_size[0]
    difference = evidence.violation_probability[0] - truth.violation_probability
    is_open = (truth.violation_probability > 0.1) & (truth.violation_probability < 0.9)
    assert np.count_nonzero(is_open) >= 3
    assert (error[is_open] < 0.05).all()
    assert np.abs(difference / error).max() < OF_ISLANDS
    islands = evidence.island_log_partition[0]
    spread = islands.std() / math.sqrt(NUM_ISLANDS)
    assert evidence.log_partition[0] == pytest.approx(
        truth.log_partition, abs=OF_ISLANDS * spread + 1e-3
    )
