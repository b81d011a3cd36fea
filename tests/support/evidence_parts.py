"""Parts of evidence, and when two are the same."""

from __future__ import annotations

import numpy as np

from swerve.evidence.evidence import Evidence

PARTS = ("tasks", "summary", "samples")


def assert_equal(a: Evidence, b: Evidence) -> None:
    assert a.problem.to_json() == b.problem.to_json()
    assert a.problem.fingerprint == b.problem.fingerprint
    for name in ("method", "num_trajectories", "solver", "seed", "sampling_beta"):
        assert getattr(a, name) == getattr(b, name)
    for part in PARTS:
        for x, y in zip(getattr(a, part), getattr(b, part), strict=True):
            np.testing.assert_array_equal(x, y, strict=True)
