"""Check demonstrations together, with the states of a batch in one array.

    states[d, i] = s_min(i, L_d - 1) of demonstration d,

so that each demonstration rests in its last state until the longest demonstration ends. A resting
demonstration enters no further constraint.

Shapes: D demonstrations, L states of the longest demonstration, n state dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swerve.base.space import StateSpace
from swerve.demonstrations.checks import (
    START_TOLERANCE,
    are_plausible,
    check_path,
    check_start,
    check_states,
)
from swerve.demonstrations.demonstration import Demonstration


def checked_states(demonstrations: Sequence[Demonstration], space: StateSpace) -> np.ndarray:
    """Return the states [D, L, n] of checked demonstrations; each rests in its last state.

    All demonstrations are checked together, which is quick. If that check fails, they are checked
    one by one, to name the demonstration at fault.

    Raises:
      ValueError: as from `check_states` and `check_start`.
    """
    for item in demonstrations:
        check_path(item.states, item.times, space, item.name)
    longest = max(len(item.states) for item in demonstrations)
    states = np.stack([rested(item.states, longest) for item in demonstrations])
    starts = np.stack([item.task.start for item in demonstrations])
    is_there = space.relative_distance(states[:, 0], starts) <= START_TOLERANCE
    if not (is_there.all() and are_plausible(states, space)):
        for item in demonstrations:
            check_states(item.states, item.times, space, item.name)
            check_start(item.states[0], item.task, space, item.name)
    return states


def rested(states: np.ndarray, num: int) -> np.ndarray:
    """Return `num` states: the given states [L, n], then the last of them again and again."""
    if len(states) == num:
        return states
    return states[np.minimum(np.arange(num), len(states) - 1)]
