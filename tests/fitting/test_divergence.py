"""The KL divergence of demonstrations from the nominal distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.walks import PROBLEM, ROUND, TASK, walk

from swerve import Demonstration, Task, divergence, infer, learn, sample


def test_divergence_by_hand() -> None:
    """Two of three alike, each 3 or 4 moves at a reward of -1, log Z = -2."""
    straight = walk("right", "right", "right")
    found = divergence(PROBLEM, [straight, straight, ROUND], np.full(3, -2.0))
    entropy = 2 / 3 * math.log(2 / 3) + 1 / 3 * math.log(1 / 3)
    assert found == pytest.approx(entropy + (3 + 3 + 4) / 3 - 2.0)


def test_actions_of_a_tabular_mdp_are_found_from_its_transitions() -> None:
    bare = Demonstration("bare", ROUND.states, TASK)
    value = np.array([-2.0])
    assert divergence(PROBLEM, [bare], value) == divergence(PROBLEM, [ROUND], value)


def test_an_impossible_transition_names_the_step() -> None:
    states = ROUND.states.copy()
    states[2] = [3.0, 2.0]
    message = r"jump: step 2 leads from \[0.0, 1.0\] to \[3.0, 2.0\], which no action does"
    for actions in (None, ROUND.actions):
        jump = Demonstration("jump", states, TASK, actions=actions)
        with pytest.raises(ValueError, match=message):
            divergence(PROBLEM, [jump], np.zeros(1))
    with pytest.raises(ValueError, match=message):
        infer(sample(learn(PROBLEM), TASK), [jump])


def test_an_action_that_does_not_make_the_step_is_named() -> None:
    assert ROUND.actions is not None
    wrong = Demonstration("wrong", ROUND.states, TASK, actions=ROUND.actions[::-1])
    with pytest.raises(ValueError, match=r"wrong: step 1 leads .* action \[1.0, -1.0\] does not"):
        divergence(PROBLEM, [wrong], np.zeros(1))


def test_resting_at_the_end_is_no_step() -> None:
    rests = Demonstration(
        "rests",
        np.concatenate([ROUND.states, ROUND.states[-1:]]),
        TASK,
        actions=np.concatenate([np.asarray(ROUND.actions), [[0.0, 1.0]]]),
    )
    result = infer(sample(learn(PROBLEM), TASK), [rests])
    assert result.entered[0].sum() > 3
    bare = Demonstration("bare", rests.states, TASK)
    expected = divergence(PROBLEM, [ROUND], np.zeros(1))
    assert divergence(PROBLEM, [rests], np.zeros(1)) == expected
    assert divergence(PROBLEM, [bare], np.zeros(1)) == expected


def test_going_on_after_the_end_is_refused() -> None:
    on = walk("right", "right", "right", "left", "right")
    with pytest.raises(ValueError, match=r"has ended in state 3 .*, and yet the demonstr"):
        divergence(PROBLEM, [on], np.zeros(1))


def test_more_steps_than_the_horizon_are_refused() -> None:
    long = walk("up", "up", "down", "right", "right", "down-right")
    with pytest.raises(ValueError, match="6 steps, more than the horizon of 5"):
        divergence(PROBLEM, [long], np.zeros(1))
    with pytest.raises(ValueError, match="6 steps, more than the horizon of 5"):
        infer(sample(learn(PROBLEM), TASK), [long])


def test_demonstrations_that_differ_by_rounding_are_the_same() -> None:
    straight = walk("right", "right", "right")
    near = Demonstration("near", straight.states + 1e-12, TASK, actions=straight.actions)
    minus = Demonstration("minus", straight.states, Task(-TASK.start, TASK.goal))
    alike = [straight, near, minus]
    assert divergence(PROBLEM, alike, np.full(3, -2.0)) == pytest.approx(3.0 - 2.0)


@pytest.mark.parametrize("values", [3.0, [1.0, 2.0], [[1.0]]])
def test_divergence_takes_one_number_for_each_demonstration(values) -> None:
    with pytest.raises(ValueError, match=r"one number for each of 1 demonstrations, .* got shape"):
        divergence(PROBLEM, [ROUND], values)
    with pytest.raises(ValueError, match="demonstrations: expected a list of at least one"):
        divergence(PROBLEM, [], np.zeros(0))
