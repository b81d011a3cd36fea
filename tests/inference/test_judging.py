"""Demonstrations are judged against the hypotheses, or refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.rankings import RISING, evidence_with_chances
from support.synthetic import TASKS, make_demonstration, make_evidence, make_record
from support.walks import PROBLEM, ROUND, TASK

from swerve import Box, learn, sample
from swerve.answer import infer
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration


class TestRefused:
    def test_a_demonstration_of_an_unknown_task(self) -> None:
        stranger = Demonstration(
            "demo_17", np.array([[0.5, 1.0], [0.5, 1.1]]), Task(np.array([0.5, 1.0]), TASKS.goal[0])
        )
        with pytest.raises(
            ValueError, match=r"demo_17: no evidence for start \(0\.5, 1\) and goal"
        ):
            infer(evidence_with_chances(RISING), [make_demonstration(0), stranger])

    def test_nan_is_named_with_its_row(self) -> None:
        broken = make_demonstration(1, "demo_5", num_states=30)
        broken.states[16, 1] = np.nan
        with pytest.raises(ValueError, match="demo_5: row 17, column x: expected a finite number"):
            infer(evidence_with_chances(RISING), [make_demonstration(0), broken])

    def test_states_of_another_problem(self) -> None:
        other = Demonstration("demo_3", np.zeros((5, 3)), Task(np.zeros(3), np.zeros(3)))
        message = r"demo_3: expected states of shape \(any, 2\), got \(5, 3\)"
        with pytest.raises(ValueError, match=message):
            infer(evidence_with_chances(RISING), [other])

    def test_a_start_elsewhere_than_that_of_the_task(self) -> None:
        states = np.repeat(TASKS.start[:1], 3, axis=0) + np.array([0.0, 0.5])
        elsewhere = Demonstration("demo_4", states, Task(TASKS.start[0], TASKS.goal[0]))
        with pytest.raises(ValueError, match=r"demo_4: the first state is .* but the task starts"):
            infer(evidence_with_chances(RISING), [elsewhere])

    def test_a_step_of_half_a_turn(self) -> None:
        states = np.array([[0.1, 1.0], [0.1 + math.pi, 1.0]])
        jump = Demonstration("demo_4", states, Task(states[0], TASKS.goal[0]))
        with pytest.raises(ValueError, match=r"demo_4: row 2, column theta: 3\.142 rad from"):
            infer(evidence_with_chances(RISING), [jump])


def test_a_shorter_demonstration_rests_where_it_ends() -> None:
    """It does not enter what lies on the straight way back to its start."""
    evidence = make_evidence(make_record(between_states=True))
    start, goal = TASKS.start[0], TASKS.goal[0]
    corner = np.array([[0.1, 1.0], [1.0, 1.0], [2.0, 1.0], [2.0, 4.0], [2.0, 8.0]])
    short = Demonstration("short", corner, Task(start, goal))
    longer = make_demonstration(0, "longer", num_states=12)
    together = infer(evidence, [short, longer])
    alone = infer(evidence, [short])
    np.testing.assert_array_equal(together.entered[0], alone.entered[0])
    back = Demonstration("back", np.concatenate([corner, corner[:1]]), Task(start, goal))
    assert infer(evidence, [back]).entered.sum() > alone.entered.sum()


@pytest.mark.parametrize("goal", [[1.0], [1.0, 2.0, 3.0], []])
def test_a_goal_of_the_wrong_length_is_refused(goal: list[float]) -> None:
    states = make_demonstration(0).states
    wrong = Demonstration("demo_9", states, Task(TASKS.start[0], np.array(goal)))
    with pytest.raises(
        ValueError, match=f"demo_9: expected a goal of 2 numbers .*, got {len(goal)}"
    ):
        infer(make_evidence(), [wrong])


def test_one_demonstration_in_the_place_of_a_list() -> None:
    evidence = make_evidence()
    with pytest.raises(ValueError, match=r"expected a list of demonstrations, got .* alone"):
        infer(evidence, make_demonstration())  # pyright: ignore[reportArgumentType]


def test_a_demonstration_through_a_known_wall_is_refused() -> None:
    evidence = make_evidence(make_record(known=(Box(x=(5.0, 6.0)),)))
    inside = make_demonstration(0, "ghost", x=5.5)
    with pytest.raises(ValueError, match=r"ghost enters the known constraint x \[5, 6\)"):
        infer(evidence, [inside])
    assert len(infer(evidence, [make_demonstration(0, x=4.5)]).demonstrations) == 1


def test_inference_refuses_actions_that_do_not_make_the_steps() -> None:
    assert ROUND.actions is not None
    evidence = sample(learn(PROBLEM), TASK)
    wrong = Demonstration("wrong", ROUND.states, TASK, actions=ROUND.actions[::-1])
    with pytest.raises(ValueError, match=r"wrong: step 1 leads .* action \[1.0, -1.0\] does not"):
        infer(evidence, [wrong])
    narrow = Demonstration("narrow", ROUND.states, TASK, actions=ROUND.actions[:, :1])
    with pytest.raises(ValueError, match=r"narrow: .* columns dx, dy, got 1 of them"):
        infer(evidence, [narrow])


def test_states_between_the_lattice_points_are_refused() -> None:
    states = ROUND.states.copy()
    states[1] += 0.4
    between = Demonstration("between", states, TASK, actions=ROUND.actions)
    with pytest.raises(ValueError, match=r"between: row 2, column x: 0.4 lies between two states"):
        infer(sample(learn(PROBLEM), TASK), [between])
    with pytest.raises(ValueError, match=r"task 0: goal, column y: 0.3 lies between two states"):
        sample(learn(PROBLEM), Task(TASK.start, TASK.goal + np.array([0.0, 0.3])))
