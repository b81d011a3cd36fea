"""Files that were written before the library was put into packages are read as they were meant."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swerve

STORED = Path(__file__).resolve().parents[1] / "data" / "before_packages"
EXPECTED = json.loads((STORED / "expected.json").read_text())
MADE: dict[str, Any] = runpy.run_path(str(STORED / "problems.py"))


@pytest.fixture(params=sorted(EXPECTED))
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_problems_have_the_fingerprints_that_they_had(name: str) -> None:
    assert MADE["problem_of"](name).record.fingerprint == EXPECTED[name]["fingerprint"]


def test_evidence_gives_the_answer_that_it_gave(name: str) -> None:
    evidence = swerve.Evidence.load(STORED / f"{name}.evidence")
    expected = EXPECTED[name]
    assert evidence.problem.fingerprint == expected["fingerprint"]
    result = swerve.infer(evidence)
    assert result.ranking.tolist() == expected["ranking"]
    np.testing.assert_array_equal(result.log_likelihood[result.ranking], expected["log_likelihood"])
    assert evidence.samples.total_reward.shape[0] == 1


def test_nominals_sample_what_they_sampled(name: str) -> None:
    problem, tasks = MADE["problem_of"](name), MADE["task_of"](name)
    nominal = swerve.load_nominal(STORED / f"{name}.nominal", problem)
    evidence = swerve.sample(nominal, tasks, num_trajectories=20, seed=0)
    before = swerve.Evidence.load(STORED / f"{name}.evidence")
    assert evidence.solver == before.solver
    assert evidence.log_partition == pytest.approx(EXPECTED[name]["log_partition"], rel=1e-4)
    same = evidence.samples.violations == before.samples.violations
    assert same.mean() > 0.99  # another processor may round a sampled action the other way
