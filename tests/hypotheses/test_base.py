"""Lists of constraints as hypotheses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cells import PENDULUM, as_list, both_settings, entered, fewer, walks

from swerve.base.space import TWO_PI
from swerve.constraints.base import violates
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid
from swerve.hypotheses.windows import windows

seeds = st.integers(0, 2**32 - 1)
CELLS = grid(theta=(0.0, TWO_PI, 5), omega=(-4.0, 4.0, 4))
SETS = {
    "grid": CELLS,
    "line": grid(omega=(-4.0, 4.0, 8)),
    "windows": windows(2, theta=(0.0, TWO_PI, 1.0), omega=(-4.0, 4.0, 2.0)),
    "list": as_list(CELLS),
}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("shape", [(0,), (3, 0), (0, 3), (2,), ()], ids=str)
def test_distances_keep_the_shape_of_a_batch(name: str, shape: tuple[int, ...]) -> None:
    """Also of no states: options are checked against the hypotheses before there are any."""
    made = SETS[name]
    states = np.random.default_rng(0).uniform(-4.0, 4.0, (*shape, 2))
    found = made.distance(states, PENDULUM)
    assert found.shape == (*shape, len(made))
    each = [made.constraint(index).distance(states, PENDULUM) for index in range(len(made))]
    np.testing.assert_allclose(found, np.stack(each, axis=-1), atol=1e-9)


class TestLists:
    @both_settings
    def test_each_column_is_one_constraint(self, between_states: bool) -> None:
        constraints = [
            Box(theta=(0.0, 1.0)),
            Predicate("fast", lambda states: abs(states[..., 1]) > 2.0),
            Box(theta=(-1.0, 1.0), omega=(0.0, math.inf)),
            *(Box(omega=(k / 2, k / 2 + 1.0)) for k in range(-4, 4)),
        ]
        hypotheses = ConstraintHypotheses(constraints)
        states = walks(np.random.default_rng(1))
        columns = [violates(c, states, PENDULUM, between_states) for c in constraints]
        bits = hypotheses.violations(states, PENDULUM, between_states)
        assert bits.shape == (25, 2)
        np.testing.assert_array_equal(unpack(bits, len(hypotheses)), np.stack(columns, axis=-1))
        assert [hypotheses.constraint(k) for k in range(len(hypotheses))] == constraints

    @fewer
    @given(seed=seeds)
    def test_order_does_not_matter(self, seed) -> None:
        generator = np.random.default_rng(seed)
        boxes = as_list(grid(theta=(0.0, TWO_PI, 5), omega=(-4.0, 4.0, 4))).constraints
        order = generator.permutation(len(boxes))
        states = walks(generator)
        shuffled = ConstraintHypotheses(boxes[k] for k in order)
        np.testing.assert_array_equal(
            entered(shuffled, states, PENDULUM, True),
            entered(ConstraintHypotheses(boxes), states, PENDULUM, True)[:, order],
        )

    def test_state_names_and_code(self) -> None:
        boxes = ConstraintHypotheses([Box(omega=(0, 1)), Box(theta=(0, 1), omega=(0, 1))])
        assert boxes.state_names == ("omega", "theta")
        assert not boxes.needs_code
        assert ConstraintHypotheses([Predicate("p", lambda s: s[..., 0] > 0)]).needs_code
        assert not grid(theta=(0.0, 1.0, 2)).needs_code
        assert grid(omega=(0.0, 1.0, 2), theta=(0.0, 1.0, 2)).state_names == ("omega", "theta")

    def test_an_empty_list_is_refused(self) -> None:
        with pytest.raises(ValueError, match="hypotheses: expected at least one constraint, got"):
            ConstraintHypotheses([])

    def test_check_names_the_hypothesis(self) -> None:
        wrong: Any = [Box(theta=(0, 1)), "wall"]
        with pytest.raises(ValueError, match=r"hypotheses\[1\]: expected a Constraint, got 'wall'"):
            ConstraintHypotheses(wrong).check(PENDULUM, ())
        with pytest.raises(ValueError, match="no state named 'x'; the states are theta, omega"):
            ConstraintHypotheses([Box(x=(0, 1))]).check(PENDULUM, ())
