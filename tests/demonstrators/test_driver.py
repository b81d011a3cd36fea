"""Drivers pass the obstacle, late and with noise, brake before they steer, and all differ."""

from __future__ import annotations

import numpy as np
import pytest

from swerve import Ball, Box, Car
from swerve.constraints.base import violates
from swerve.demonstrators.driver import drives

CAR = Car()
OBSTACLE = Box(x=(-0.3, 0.2), y=(6.7, 7.4))
AROUND = drives(CAR, OBSTACLE, 12)
FREE = drives(CAR, None, 12)


def test_they_pass_the_obstacle_and_go_back() -> None:
    for item in AROUND:
        assert not violates(OBSTACLE, item.states, CAR.space, True)
        x, y = item.states[:, 0], item.states[:, 1]
        assert (x[(y > 6.7) & (y < 7.4)] < -0.3).all()
        assert x[-1] > x.min() + 0.02
    assert sum(item.states[-1, 1] >= 8.5 for item in AROUND) >= 10


def test_with_nothing_in_the_way_they_keep_to_the_lane() -> None:
    for item in FREE:
        assert np.abs(item.states[:, 0]).max() < 0.2
        assert item.states[-1, 1] >= 8.5


def test_what_is_out_of_sight_changes_nothing() -> None:
    """Until 4 m before the obstacle, a drive (unless repeated) equals the one on a free track."""
    same = []
    for around, free in zip(AROUND, FREE, strict=True):
        unseen = int((around.states[:, 1] < 6.7 - 4.0).sum())
        assert unseen > 30
        same.append(np.array_equal(around.states[:unseen], free.states[:unseen]))
        assert around.states[:, 0].min() < free.states[:, 0].min() - 0.2
    assert sum(same) >= 10


def test_they_brake_before_they_steer() -> None:
    for item in AROUND:
        _, y, _, speed = item.states.T
        cruising = speed[y < 2.5][-1]
        swerving = np.flatnonzero((item.states[:, 0] < -0.15) & (y > 3.0))[0]
        assert speed[swerving] < 0.8 * cruising


def test_a_drive_is_what_the_dynamics_make_of_its_actions() -> None:
    for item in AROUND[:3]:
        assert item.actions is not None
        assert item.times is not None
        assert (np.abs(item.actions) <= [0.5, 1.0]).all()
        for state, action, after in zip(
            item.states[:-1], item.actions, item.states[1:], strict=True
        ):
            np.testing.assert_allclose(CAR.dynamics(state, action), after, atol=1e-6)
        np.testing.assert_allclose(np.diff(item.times), CAR.dt)


def test_they_differ_and_repeat() -> None:
    assert len({len(item.states) for item in AROUND}) > 6
    for item, again in zip(AROUND[:3], drives(CAR, OBSTACLE, 3), strict=True):
        np.testing.assert_array_equal(item.states, again.states)
    assert not np.array_equal(drives(CAR, OBSTACLE, 1, seed=1)[0].states, AROUND[0].states)


def test_they_pass_on_the_side_with_room() -> None:
    left = Box(x=(-0.8, -0.1), y=(4.0, 4.5))
    for item in drives(CAR, left, 3):
        x, y = item.states[:, 0], item.states[:, 1]
        assert (x[(y > 4.0) & (y < 4.5)] > -0.1).all()


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        (Ball(0.1, x=0.0, y=7.0), r"expected a box in x and y, .*got ball"),
        (Box(y=(6.7, 7.4)), r"expected a box in x and y"),
        (Box(x=(-0.3, 0.2), y=(-0.5, 0.5)), r"can pass, got .* hit 50 times: move it further"),
        (Box(x=(-0.6, 0.1), y=(6.7, 7.4)), r"expected 0.25 m of the track.*make it narrower"),
    ],
)
def test_obstacles_that_are_refused(obstacle: Box, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drives(CAR, obstacle, 1)
