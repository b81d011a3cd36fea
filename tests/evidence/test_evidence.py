"""Evidence by task: found, selected and joined."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.evidence_parts import PARTS, assert_equal
from support.synthetic import SPACE, TASKS, make_evidence, make_record

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.matching import MATCH_TOLERANCE


class TestFind:
    def test_every_task_is_found(self) -> None:
        evidence = make_evidence()
        assert evidence.num_tasks == 3
        for k in range(3):
            task = Task(TASKS.start[k], TASKS.goal[k])
            assert evidence.find(task) == evidence.match(task) == k

    @pytest.mark.parametrize("turns", [-3, -1, 1, 5])
    def test_angles_wrap(self, turns: int) -> None:
        shift = np.array([TWO_PI * turns, 0.0])
        evidence = make_evidence()
        assert evidence.find(Task(TASKS.start[2] + shift, TASKS.goal[2] - shift)) == 2
        across = Task(np.array([-1e-4, 1.0]), np.array([0.0, 0.0]))
        tasks = Task(np.array([[TWO_PI - 2e-4, 1.0]]), np.array([[TWO_PI, 0.0]]))
        assert make_evidence(tasks=tasks).find(across) == 0

    @pytest.mark.parametrize("part", ["start", "goal"])
    @pytest.mark.parametrize("column", [0, 1])
    @pytest.mark.parametrize("sign", [-1, 1])
    def test_tolerance_is_in_units_of_the_extent(self, part: str, column: int, sign: int) -> None:
        evidence = make_evidence()
        task = Task(TASKS.start[1], TASKS.goal[1])
        for share, found in ((0.99, 1), (1.01, None)):
            off = np.zeros(2)
            off[column] = sign * share * MATCH_TOLERANCE * SPACE.extent[column]
            assert evidence.find(task._replace(**{part: getattr(task, part) + off})) == found

    def test_the_nearest_of_several_is_taken(self) -> None:
        tasks = Task(np.array([[0.0, 1.0], [0.0, 1.004]]), np.zeros((2, 2)))
        evidence = make_evidence(tasks=tasks)
        assert evidence.find(Task(np.array([0.0, 1.0035]), np.zeros(2))) == 1
        assert evidence.find(Task(np.array([0.0, 1.0005]), np.zeros(2))) == 0

    def test_no_match_is_an_error_that_names_both(self) -> None:
        evidence = make_evidence()
        message = (
            r"demo_7: no evidence for start \(3, 5\.1\) and goal \(2, 2\); the nearest of 3 tasks "
            r"is start \(3, 5\), goal \(2, 2\)\. Sample this task too: "
            r"swerve\.sample\(nominal, tasks\)"
        )
        with pytest.raises(ValueError, match=message):
            evidence.match(Task(np.array([3.0, 5.1]), TASKS.goal[1]), "demo_7")
        with pytest.raises(ValueError, match="the task: no evidence for start"):
            evidence.match(Task(TASKS.start[0], TASKS.goal[1]))

    def test_no_match_tells_both_apart(self) -> None:
        """A kilometre from the origin, four digits would be the same for both."""
        space = StateSpace(SPACE.names, SPACE.angles, np.array([[0.0, TWO_PI], [1000.0, 1008.0]]))
        tasks = Task(np.array([[3.0, 1000.1]]), np.array([[2.0, 1004.0]]))
        message = (
            r"no evidence for start \(3, 1000\.11\) and goal \(2, 1004\); the nearest of 1 tasks "
            r"is start \(3, 1000\.1\), goal \(2, 1004\)\. Sample"
        )
        evidence = make_evidence(make_record(space=space), tasks=tasks)
        with pytest.raises(ValueError, match=message):
            evidence.match(Task(np.array([3.0, 1000.11]), tasks.goal[0]))

    def test_goals_that_are_no_states_are_compared_by_value(self) -> None:
        record = make_record(goal_names=("height",))
        tasks = Task(TASKS.start, np.array([[0.0], [1000.0], [TWO_PI]]))
        evidence = make_evidence(record, tasks=tasks)
        assert evidence.find(Task(TASKS.start[1], np.array([1000.9]))) == 1
        assert evidence.find(Task(TASKS.start[1], np.array([1001.1]))) is None
        assert evidence.find(Task(TASKS.start[2], np.array([0.0]))) is None  # no angle
        assert evidence.find(Task(TASKS.start[0], np.array([9e-4]))) == 0
        assert evidence.find(Task(TASKS.start[0], np.array([1.1e-3]))) is None

    def test_there_may_be_no_goal_at_all(self) -> None:
        record = make_record(goal_names=())
        evidence = make_evidence(record, tasks=Task(TASKS.start, np.zeros((3, 0))))
        assert evidence.find(Task(TASKS.start[1], np.zeros(0))) == 1


class TestSelectAndJoin:
    @pytest.mark.parametrize("indices", [[1], [2, 0], [0, 1, 2], [1, 1]])
    def test_select_takes_tasks_in_the_order_given(self, indices: list[int]) -> None:
        evidence = make_evidence()
        some = evidence.select(indices)
        assert some.num_tasks == len(indices)
        for part in PARTS:
            for taken, all_of_it in zip(getattr(some, part), getattr(evidence, part), strict=True):
                np.testing.assert_array_equal(taken, all_of_it[indices])
        np.testing.assert_array_equal(some.log_ratio, evidence.log_ratio[indices])
        np.testing.assert_array_equal(some.log_weight, evidence.log_weight[indices])

    def test_what_was_selected_joins_again(self, tmp_path: Path) -> None:
        evidence = make_evidence()
        joined = evidence.select([0]).joined(evidence.select([1, 2]))
        assert_equal(joined, evidence)
        joined.save(tmp_path / "joined.evidence")
        assert_equal(Evidence.load(tmp_path / "joined.evidence"), evidence)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"method": "plain"}, "different method cannot be joined: 'importance' and 'plain'"),
            ({"num_trajectories": 7}, "different num_trajectories cannot be joined: 400 and 7"),
            ({"solver": "Grid()"}, r"different solver cannot be joined: 'Toy\(\)' and 'Grid\(\)'"),
            ({"seed": 3}, "different seed cannot be joined: 0 and 3"),
            ({"sampling_beta": 0.25}, r"different sampling_beta cannot be joined: 0\.5 and 0\.25"),
            (
                {"problem": make_record(beta=0.25)},
                r"different problems cannot be joined: .* beta 0\.5, .* beta 0\.25",
            ),
        ],
    )
    def test_what_differs_is_not_joined(self, change: dict[str, Any], message: str) -> None:
        evidence = make_evidence()
        with pytest.raises(ValueError, match=f"evidence of {message}"):
            evidence.joined(dataclasses.replace(evidence, **change))

    def test_problems_that_only_look_alike_are_not_joined(self) -> None:
        a, b = (make_evidence(make_record(mdp_digest=digest)) for digest in ("0", "1"))
        with pytest.raises(ValueError, match="different problems"):
            a.joined(b)
        narrow = StateSpace(SPACE.names, SPACE.angles, SPACE.bounds * [[1.0], [0.5]])
        with pytest.raises(ValueError, match="different problems"):
            a.joined(make_evidence(make_record(space=narrow, mdp_digest="0")))
