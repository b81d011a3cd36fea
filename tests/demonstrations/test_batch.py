"""Demonstrations are checked together, and each rests where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from swerve.base.space import StateSpace, Task
from swerve.demonstrations.batch import checked_states, rested
from swerve.demonstrations.demonstration import Demonstration

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))


def demonstration(name: str, length: int, start: float = 0.0) -> Demonstration:
    states = np.linspace([start, 0.0], [start + 1.0, 1.0], length)
    return Demonstration(name, states, Task(states[0], states[-1]))


def test_states_go_on_with_the_last() -> None:
    states = np.array([[0.0, 0.0], [1.0, 2.0]])
    expected = [[0.0, 0.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0]]
    np.testing.assert_array_equal(rested(states, 4), expected)
    assert rested(states, 2) is states


def test_a_batch_is_as_long_as_its_longest() -> None:
    short, long = demonstration("short", 3), demonstration("long", 7)
    states = checked_states([short, long], PLANE)
    assert states.shape == (2, 7, 2)
    np.testing.assert_array_equal(states[0], rested(short.states, 7))
    np.testing.assert_array_equal(states[1], long.states)


def test_the_one_at_fault_is_named() -> None:
    fine, broken = demonstration("fine", 3), demonstration("broken", 5)
    broken.states[2, 1] = np.nan
    with pytest.raises(ValueError, match="broken: row 3, column y: expected a finite number"):
        checked_states([fine, broken], PLANE)
    elsewhere = Demonstration("elsewhere", fine.states, demonstration("", 3, start=1.0).task)
    with pytest.raises(ValueError, match=r"elsewhere: the first state is .* but the task starts"):
        checked_states([fine, elsewhere], PLANE)
