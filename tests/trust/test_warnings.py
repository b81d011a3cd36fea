"""Warnings of an inference."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from support.rankings import CELLS, RISING, evidence_with_chances
from support.synthetic import (
    TASKS,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve.answer import infer
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.grid import grid


def everywhere(name: str = "wanderer") -> Demonstration:
    states = np.stack([np.full(10, 0.1), np.arange(10) + 0.5], axis=-1)
    states[0] = TASKS.start[0]
    states = np.concatenate([states[:1], [[0.1, 0.5]], states[1:]])
    return Demonstration(name, states, Task(TASKS.start[0], TASKS.goal[0]))


class TestWarnings:
    def test_there_are_none_where_nothing_is_wrong(self) -> None:
        evidence = evidence_with_chances(RISING)
        assert infer(evidence).warnings == ()
        assert infer(evidence, [make_demonstration(0)]).warnings == ()

    def test_no_hypothesis_is_left(self) -> None:
        result = infer(evidence_with_chances(RISING), [make_demonstration(1, "b"), everywhere()])
        assert result.struck_out.all()
        assert len(result.ranking) == len(result.rank) == len(result.leaders) == 0
        assert result.headline.startswith("No hypothesis is left: each of the 10 is entered by")
        (warning,) = result.warnings
        assert warning.startswith("no hypothesis is left: each of the 10 is entered by at least")
        assert "(wanderer alone enters 10)" in warning
        data = json.loads(json.dumps(result.to_json(), allow_nan=False))
        assert data["ranking"] == []
        assert len(data["struck_out"]) == 10
        assert result.table().count("\n") == 0  # the header alone

    def low_evidence(self, task: int) -> Evidence:
        samples = make_samples(1000, num_hypotheses=10)
        samples.total_reward[task, 0] += 40.0  # with beta 0.5 it outweighs the rest
        return make_evidence(make_record(hypotheses=CELLS), samples)

    def test_low_effective_sample_size(self) -> None:
        evidence = self.low_evidence(2)
        assert evidence.effective_sample_size[2] < 2
        demonstrations = [make_demonstration(0, "a"), make_demonstration(2, "b")]
        warning, *_ = infer(evidence, demonstrations).warnings
        assert warning.startswith(
            "not to be trusted: the effective sample size is too low for 1 of"
        )
        assert "1 of 2 tasks (worst: b, 1 of 1000)" in warning
        assert infer(evidence, demonstrations[:1]).warnings == ()
        prior, *_ = infer(evidence).warnings
        assert "1 of 3 tasks (worst: task 2, 1 of 1000)" in prior

    def test_plain_weights_do_not_hide_it(self) -> None:
        samples = make_samples(1000, num_hypotheses=10)
        samples.total_reward[0, 0] += 40.0
        evidence = make_evidence(make_record(hypotheses=CELLS), samples, method="plain")
        warning, *_ = infer(evidence, [make_demonstration(0, "a")]).warnings
        assert "not to be trusted" in warning

    @pytest.mark.parametrize(("ess", "low"), [(99.0, True), (101.0, False)])
    def test_few_effective_samples_are_too_few(self, ess: float, low: bool) -> None:
        evidence = evidence_with_chances(RISING)
        summary = evidence.summary._replace(effective_sample_size=np.full(3, ess))
        object.__setattr__(evidence, "summary", summary)
        assert bool(infer(evidence).warnings) == low

    @pytest.mark.parametrize(("ess", "low"), [(1990.0, True), (2010.0, False)])
    def test_a_small_share_of_many_is_too_few(self, ess: float, low: bool) -> None:
        evidence = evidence_with_chances(RISING)
        summary = evidence.summary._replace(effective_sample_size=np.full(3, ess))
        object.__setattr__(evidence, "summary", summary)
        object.__setattr__(evidence, "num_trajectories", 100_000)
        assert bool(infer(evidence).warnings) == low

    def test_a_floored_leader(self) -> None:
        chances = [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.2, 0.0]
        result = infer(evidence_with_chances(chances), [make_demonstration(0)])
        np.testing.assert_array_equal(result.leaders, [6])
        assert result.log_likelihood[6] == pytest.approx(math.log(1000))
        (warning,) = result.warnings
        assert warning.startswith("the score of hypothesis 6 is only a lower bound: almost every")
        assert warning.endswith(
            "the samples tell no more than about 6.9 nats. The solvers grid and soft-value "
            "can tell more"
        )
        np.testing.assert_array_equal(np.flatnonzero(result.is_lower_bound), [6])
        assert "(≥ 6.9 nats)" in result.headline
        assert " 6 ≥    6.91 " in result.table()
        assert [row["is_lower_bound"] for row in result.to_json()["ranking"][:2]] == [True, False]

    def test_a_floored_hypothesis_that_is_not_first(self) -> None:
        """First by three good tasks; the second might be far better in the one that floors it."""
        columns = np.zeros((3, 1000, 10), bool)
        columns[:, :990, 6] = True
        columns[1, :, 2] = True
        evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
        result = infer(evidence, [make_demonstration(task, f"d{task}") for task in range(3)])
        assert result.ranking[:2].tolist() == [6, 2]
        (warning,) = result.warnings
        assert warning.startswith("the score of hypothesis 2 is only a lower bound")

    def test_a_floored_hypothesis_that_is_struck_out_is_no_matter(self) -> None:
        chances = [0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.3, 0.0, 0.2, 0.0]
        assert infer(evidence_with_chances(chances), [make_demonstration(0)]).warnings == ()


def test_too_few_samples_are_told_from_a_bad_policy() -> None:
    cells = grid(x=(0.0, 9.0, 3))
    few = infer(evidence_of_columns(np.zeros((1, 50, 3)), cells)).warnings
    assert "Sample more trajectories" in few[0]
    assert "policy" not in few[0]
