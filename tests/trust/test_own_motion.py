"""What trajectories of the model itself do not fit is judged no more."""

from __future__ import annotations

import numpy as np
import pytest
from support.motions import FORCES, SPACE, cart_motion, cart_record, euler

from swerve.evidence.motion import UNTOLD
from swerve.trust.own_motion import without_alarms

RECORD, MOTION = cart_record(), cart_motion()


def rolled_out(speed: float, num_steps: int = 60) -> np.ndarray:
    """A trajectory [1, T+1, 2] of the cart from the middle, without a force."""
    states = [np.array([0.0, speed])]
    for _ in range(num_steps):
        states.append(euler(states[-1], FORCES[2]))
    return np.array(states)[None]


def test_trajectories_that_fit_change_nothing() -> None:
    assert without_alarms(MOTION, rolled_out(0.9), RECORD) is MOTION


def test_a_jump_leaves_out_single_steps_and_no_sums() -> None:
    own = rolled_out(0.9)
    own[:, 30:, 0] -= 0.2
    motion = without_alarms(MOTION, own, RECORD)
    assert motion.worst.tolist() == [UNTOLD * SPACE.extent[0], MOTION.worst[1]]
    assert motion.error.tolist() == MOTION.error.tolist()


def test_motion_against_the_dynamics_leaves_out_the_component() -> None:
    motion = without_alarms(MOTION, rolled_out(0.9) * [-1.0, 1.0], RECORD)
    assert motion.error.tolist() == [UNTOLD * SPACE.extent[0], MOTION.error[1]]
    np.testing.assert_array_equal(motion.forms, MOTION.forms)


@pytest.mark.parametrize("far", [np.nan, np.inf, 1e3])
def test_states_that_are_far_from_the_bounds_or_no_numbers_end_a_trajectory(far: float) -> None:
    own = rolled_out(0.9)
    own[:, 30, 0] = far
    own[:, 31:] *= -1.0
    assert without_alarms(MOTION, own, RECORD) is MOTION
    own[:, 0, 0] = far
    assert without_alarms(MOTION, own, RECORD) is MOTION
