"""How states move: fitted to steps, and the changes that follow."""

from __future__ import annotations

import numpy as np
import pytest
from support.motions import DT, FORCES, SPACE, cart_motion, drive, euler

from swerve.base.space import TWO_PI, StateSpace
from swerve.evidence.motion import features, fit_motion


def test_an_euler_step_is_told_by_the_state_where_it_begins() -> None:
    motion = cart_motion()
    assert motion.place.tolist() == [0.0, 0.5]
    np.testing.assert_allclose(motion.rates(np.array([[1.0, 2.0]]), SPACE)[0, 0], 2.0, atol=1e-4)
    np.testing.assert_allclose(motion.reach, [0.0, 2.0], atol=1e-3)  # the strongest force is 2
    assert (motion.error < 1e-3).all()
    assert motion.turning[0] == pytest.approx(1.2, rel=0.05)  # the average strength of a force


def test_steps_predict_what_recorded_states_do() -> None:
    item = drive(1.0)
    assert item.times is not None
    steps = cart_motion().steps(item.states, np.diff(item.times), SPACE)
    np.testing.assert_allclose(steps.moved[:, 0], np.diff(item.states[:, 0]))
    missed = np.abs(steps.moved - steps.predicted)[:, 0]
    assert (missed <= steps.bend[:, 0] + 1e-5).all()
    assert missed.max() > 1e-3  # real motion is not that of Euler steps


def test_accurate_integration_is_told_half_way_and_angles_wrap() -> None:
    space = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-4.0, 4.0]]))
    before = np.random.default_rng(0).uniform(space.bounds[:, 0], space.bounds[:, 1], (900, 2))
    omega = before[:, None, 1] + 0.1 * np.array([-1.0, 0.0, 1.0])
    middle = 0.5 * (before[:, None, 1] + omega)
    theta = (before[:, None, 0] + 0.1 * middle) % TWO_PI
    motion = fit_motion(before, np.stack([theta, omega], axis=-1), space, 0.1)
    assert motion.place[0] == 0.5
    np.testing.assert_allclose(motion.reach, [0.0, 1.0], atol=1e-3)
    states = np.array([[TWO_PI - 0.05, 1.0], [0.05, 1.0]])
    steps = motion.steps(states, np.array([0.1]), space)
    np.testing.assert_allclose(steps.moved[0, 0], steps.predicted[0, 0], atol=1e-4)


def test_rare_states_such_as_walls_do_not_bend_the_fit() -> None:
    before = np.random.default_rng(0).uniform(SPACE.bounds[:, 0], SPACE.bounds[:, 1], (900, 2))
    after = euler(before[:, None], FORCES)
    blocked = after[..., 0] > SPACE.bounds[0, 1] - 0.02
    after[blocked] = [2.98, 0.0]
    motion = fit_motion(before, after, SPACE, DT)
    np.testing.assert_allclose(motion.rates(np.array([[1.0, 2.0]]), SPACE)[0, 0], 2.0, atol=0.02)
    assert motion.worst[0] > 10.0 * (motion.reach + motion.error)[0]


def test_features_of_many_dimensions_have_no_waves_of_states_that_are_no_angles() -> None:
    names = tuple("abcdefgh")
    space = StateSpace(names, ("a",), np.array([[0.0, 1.0]] * 8))
    assert features(np.zeros((3, 8)), space).shape == (3, 1 + 7 + 2)
    assert features(np.zeros((3, 2)), SPACE).shape == (3, 1 + 2 + 4)
