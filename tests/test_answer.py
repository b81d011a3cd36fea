"""How an inference says, lists and stores itself."""

from __future__ import annotations

import json
import math

import pytest
from support.rankings import evidence_with_chances
from support.synthetic import TASKS, make_demonstration

from swerve.answer import Inference, infer
from swerve.evidence.evidence import Evidence


class TestOutput:
    @pytest.fixture
    def result(self) -> Inference:
        evidence = evidence_with_chances([0.1 * k for k in range(10)])
        demonstrations = [make_demonstration(0, "a", x=3.5), make_demonstration(2, "b")]
        return infer(evidence, demonstrations)

    def test_json_holds_the_ranking_best_first(self, result: Inference) -> None:
        data = json.loads(json.dumps(result.to_json(), allow_nan=False))
        assert [entry["index"] for entry in data["ranking"]] == [8, 7, 6, 5, 4, 2, 0]
        for entry in data["ranking"]:
            index = entry["index"]
            assert {"index", "name", "log_likelihood", "standard_error"} <= entry.keys()
            assert entry["name"] == f"x [{index}, {index + 1})"
            assert entry["log_likelihood"] == result.log_likelihood[index]
            assert entry["standard_error"] == result.standard_error[index] > 0
            assert entry["average_violation"] == pytest.approx(0.1 * index)
        assert [entry["rank"] for entry in data["ranking"]] == [1, 2, 3, 4, 5, 6, 7]
        struck_out = {entry["index"]: entry["entered_by"] for entry in data["struck_out"]}
        assert struck_out == {1: ["a"], 3: ["a"], 9: ["b"]}
        assert data["headline"] == result.headline
        assert data["num_demonstrations"] == 2
        assert data["warnings"] == []
        assert data["score"] == "likelihood"
        assert data["problem"] == result.evidence.problem.summary

    def test_json_holds_diagnostics_of_the_tasks_used(self, result: Inference) -> None:
        first, last = result.to_json()["diagnostics"]
        assert (first["task"], last["task"]) == (0, 2)
        assert (first["demonstrations"], last["demonstrations"]) == (["a"], ["b"])
        assert last["start"] == TASKS.start[2].tolist()
        assert last["goal"] == TASKS.goal[2].tolist()
        assert last["effective_sample_size"] == pytest.approx(1000.0)
        assert last["num_trajectories"] == 1000
        assert last["method"] == "plain"
        assert last["kl"] == pytest.approx(0.0, abs=1e-9)
        assert last["log_partition"] == pytest.approx(-5 * math.log(3))

    def test_json_is_the_same_after_a_round_trip_of_the_evidence(self, result, tmp_path) -> None:
        result.evidence.save(tmp_path / "a.evidence")
        again = infer(Evidence.load(tmp_path / "a.evidence"), result.demonstrations)
        assert json.dumps(again.to_json()) == json.dumps(result.to_json())

    def test_headline_names_the_winner(self, result: Inference) -> None:
        for part in ("2 demonstrations", "cell 8: x [8, 9)", "3.22 ± 0.09 nats"):
            assert part in result.headline

    def test_headline_of_a_tie(self) -> None:
        result = infer(evidence_with_chances([0.0] * 10), [make_demonstration(0)])
        assert "No hypothesis explains 1 demonstration noticeably better" in result.headline
        assert "tied with cells 2, 3, 4, 5, 6, 7 and 2 more" in result.headline

    def test_table(self, result: Inference) -> None:
        lines = result.table(3).splitlines()
        columns = ["rank", "index", "nats", "+-", "posterior", "violated", "hypothesis"]
        assert lines[0].split() == columns
        probability = f"{result.posterior.hypotheses[8]:.4f}"
        assert lines[1].split() == [
            "1",
            "8",
            "3.22",
            "0.09",
            probability,
            "0.800",
            "x",
            "[8,",
            "9)",
        ]
        assert [line.split()[:2] for line in lines[1:4]] == [["1", "8"], ["2", "7"], ["3", "6"]]
        assert lines[4].strip() == "... 4 more"
        assert len(result.table(7).splitlines()) == 8

    def test_table_marks_ties(self) -> None:
        result = infer(evidence_with_chances([0.5, 0.5, 0.0, 0.0, *[0.9] * 6]))
        ranks = [line.split()[0] for line in result.table().splitlines()[1:]]
        assert ranks == ["1="] * 6 + ["7="] * 2 + ["9="] * 2

    def test_names(self, result: Inference) -> None:
        assert result.hypothesis_name(8) == "x [8, 9)"
        assert [result.task_name(k) for k in range(3)] == ["a", "task 1", "b"]
