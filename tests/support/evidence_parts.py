"""Parts of evidence, and when two are the same."""

from __future__ import annotations

import dataclasses

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


def resolved(evidence: Evidence, task: int, hypothesis: int, error: float = 0.05) -> Evidence:
    """Return evidence with one ratio as if it had been resolved: -30 nats."""
    values = {"avoid_probability": np.exp(-30.0), "log_ratio": -30.0, "log_ratio_error": error}
    changed = {name: getattr(evidence.summary, name).copy() for name in values}
    for name, value in values.items():
        changed[name][task, hypothesis] = value
    return dataclasses.replace(evidence, summary=evidence.summary._replace(**changed))
