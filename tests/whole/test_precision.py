"""Where JAX is told to use 64 bits, every solver works, and the answers are the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.every_solver import sampled

import swerve

SCRIPT = Path(__file__).parents[1] / "support" / "every_solver.py"


@pytest.fixture(scope="module")
def in_64_bits() -> dict[str, np.ndarray]:
    """What the script prints in a process of its own."""
    told = os.environ | {"JAX_ENABLE_X64": "1"}
    run = subprocess.run(
        [sys.executable, SCRIPT], env=told, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return {name: np.array(values) for name, values in json.loads(run.stdout).items()}


def test_what_is_sampled_is_the_same(in_64_bits: dict[str, np.ndarray]) -> None:
    expected = sampled()
    assert len(expected) == 11
    for name, values in expected.items():
        np.testing.assert_allclose(in_64_bits[name], values, rtol=1e-4, atol=2e-5, err_msg=name)


def test_every_solver_solves(in_64_bits: dict[str, np.ndarray]) -> None:
    """The solvers that learn agree with enumeration; tables of cells are another model."""
    exact = in_64_bits["enumeration"]
    for name in ("ppo", "soft-value", "distilled"):
        np.testing.assert_allclose(in_64_bits[name], exact, atol=0.15, err_msg=name)
    np.testing.assert_allclose(in_64_bits["smc"][-1], exact[-1], atol=0.5)
    assert np.isfinite(in_64_bits["discrete"]).all()
    np.testing.assert_allclose(in_64_bits["soft-paths"], in_64_bits["tabular"], atol=0.1)


def test_the_enumeration_is_the_same(in_64_bits: dict[str, np.ndarray]) -> None:
    from support.every_solver import TASK, push

    evidence = swerve.sample(swerve.learn(push(), "enumeration"), TASK)
    expected = np.append(evidence.violation_probability, evidence.log_partition)
    np.testing.assert_allclose(in_64_bits["enumeration"], expected, rtol=1e-5, atol=1e-6)
