"""States, times and actions of a demonstration are checked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from support.demonstration_files import PENDULUM, PLANE, make

from swerve.base.space import TWO_PI, Task
from swerve.demonstrations.checks import check_states
from swerve.demonstrations.demonstration import Demonstration


class TestChecks:
    def test_good_states_pass(self) -> None:
        turns = np.linspace(0, 60, 100)
        for theta in (turns, turns % TWO_PI, -turns, -turns % TWO_PI):
            check_states(np.stack([theta, 0 * theta], axis=1), None, PENDULUM, "a")

    @pytest.mark.parametrize(
        ("states", "message"),
        [
            (np.zeros((3, 1)), r"a: expected states of shape \(any, 2\), got \(3, 1\)"),
            (np.zeros(2), r"a: expected states of shape \(any, 2\), got \(2,\)"),
            (np.zeros((0, 2)), r"a: expected at least 2 states, got 0"),
            (np.array([[0, 0], [180.0, 0]]), r"a: row 2, column theta: 180 is an angle of more"),
            (np.array([[-64, 0], [-64.0, 0]]), r"than 10 turns. Degrees\? Radians are expected; "),
            (np.array([[0, 0], [0, 61.0]]), r"row 2, column omega: 61 is more than 10 half-width"),
            (np.array([[0, 0], [0, 0], [3.0, 0]]), r"row 3, column theta: 3.000 rad from the row "),
            (np.array([[0, 0], [TWO_PI - 3, 0]]), r"too close to pi .* higher sampling rate. Degr"),
            (np.array([[0, 0], [0, np.nan]]), r"a: row 2, column omega: expected a finite number"),
        ],
    )
    def test_what_is_wrong_in_states(self, states: np.ndarray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            check_states(states, None, PENDULUM, "a")

    def test_limits(self) -> None:
        near = np.array([[0.0, 0.0], [0.999 * 0.9 * math.pi, 0.0]])
        check_states(near, None, PENDULUM, "a")
        check_states(near[:, ::-1] * [1, 4], None, PLANE, "a")  # no angles there
        with pytest.raises(ValueError, match="too close to pi"):
            check_states(near * 1.002, None, PENDULUM, "a")
        check_states(np.array([[0.0, 0.0], [0.0, 59.9]]), None, PENDULUM, "a")
        check_states(np.array([[55.0, 0.0], [-45.0, 0.0]]), None, PLANE, "a")
        with pytest.raises(ValueError, match=r"-45\.1 is more than"):
            check_states(np.array([[55.0, 0.0], [-45.1, 0.0]]), None, PLANE, "a")

    def test_times(self) -> None:
        states = np.zeros((3, 2))
        check_states(states, np.array([1.7e9, 1.7e9 + 1e-3, 1.7e9 + 1]), PENDULUM, "a")
        with pytest.raises(ValueError, match=r"a: expected times of shape \(3,\), got \(2,\)"):
            check_states(states, np.zeros(2), PENDULUM, "a")
        with pytest.raises(ValueError, match=r"a: row 2 has t = 1.0 and row 3 has t = 1.0"):
            check_states(states, np.array([0, 1, 1]), PENDULUM, "a")

    def test_demonstrations_made_in_code(self) -> None:
        item = make([[0, 1], [2, 3]], times=[0, 1], actions=[[5]])
        assert item.states.dtype == np.float64
        assert item.times is not None
        assert item.times.dtype == np.float64
        assert item.actions is not None
        assert item.actions.shape == (1, 1)
        assert isinstance(item.task.start, np.ndarray)

    @pytest.mark.parametrize(
        ("parts", "message"),
        [
            ({"states": np.zeros(3)}, r"d: expected states of shape \(any, any\), got \(3,\)"),
            ({"task": Task(np.zeros(3), np.zeros(2))}, r"d: expected a start of shape \(2,\), got"),
            (
                {"task": Task(np.zeros(2), np.zeros((1, 2)))},
                r"d: expected a goal of shape \(any,\)",
            ),
            ({"times": np.zeros(4)}, r"d: expected times of shape \(3,\), got \(4,\)"),
            ({"actions": np.zeros(3)}, r"d: expected actions of shape \(any, any\), got \(3,\)"),
            ({"actions": np.zeros((1, 1))}, "d: expected 2 or 3 actions for 3 states, got 1"),
            ({"actions": np.zeros((4, 1))}, "d: expected 2 or 3 actions for 3 states, got 4"),
        ],
    )
    def test_shapes_of_demonstrations_made_in_code(
        self, parts: dict[str, Any], message: str
    ) -> None:
        good = {"states": np.zeros((3, 2)), "task": Task(np.zeros(2), np.zeros(2))}
        with pytest.raises(ValueError, match=message):
            Demonstration("d", **(good | parts))
