"""The samples of all tasks are checked together, whatever is said of each."""

from __future__ import annotations

import numpy as np
import pytest
from support.synthetic import make_demonstration, make_evidence

from swerve import infer
from swerve.inference.ranking import Ranking
from swerve.trust import verdicts
from swerve.trust.sample_checks import Checks, sample_checks


def test_checks_are_made_once_for_all_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made anew for each of 10,000 tasks, they take minutes."""
    calls = []

    def counting(inference: Ranking) -> Checks:
        calls.append(inference)
        return sample_checks(inference)

    monkeypatch.setattr(verdicts, "sample_checks", counting)
    result = infer(make_evidence(), [make_demonstration(task) for task in (0, 1, 2, 0)])
    told = [task["verdict"] for task in result.to_json()["diagnostics"]]
    assert told == [result.verdict(task) for task in (0, 1, 2)]
    calls.clear()
    result.verdicts()
    assert len(calls) == 1
    calls.clear()
    headline_and_all = result.to_json()
    assert len(headline_and_all["diagnostics"]) == 3
    assert len(calls) == 2  # for the headline and for the verdicts


def test_no_other_check_is_made_where_effective_samples_are_too_few() -> None:
    evidence = make_evidence()
    summary = evidence.summary._replace(
        effective_sample_size=np.array([50.0, 300.0, 50.0]), kl=np.full(3, 9.0)
    )
    result = infer(make_evidence(summary=summary), [make_demonstration(k) for k in (0, 1)])
    checks = sample_checks(result)
    assert checks.too_few.tolist() == [True, False, False]  # nobody asks about the third
    assert checks.far.tolist() == [False, True, False]
