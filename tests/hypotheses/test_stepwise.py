from __future__ import annotations

import numpy as np
import pytest
from support.synthetic import SPACE

from swerve import Box, Predicate
from swerve.base.space import TWO_PI, StateSpace
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid
from swerve.hypotheses.stepwise import stepwise


@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize(
    "hypotheses",
    [
        grid(theta=(0.0, TWO_PI, 7), x=(0.0, 9.0, 5)),
        grid(x=(1.0, 8.0, 9), theta=(-1.0, 2.0, 4)),
        grid(theta=(0.5, 0.5 + TWO_PI, 1)),
        grid(x=(0.0, 10.0, 20)),
        ConstraintHypotheses(
            [
                Box(theta=(1.0, 2.0)),
                Box(x=(3.0, 4.0), theta=(5.0, 7.0)),
                Predicate("far", lambda states: states[..., 1] > 7.0),
            ]
        ),
    ],
)
def test_states_one_by_one_enter_what_the_whole_enters(
    hypotheses: HypothesisSet, between_states: bool
) -> None:
    generator = np.random.default_rng(0)
    for scale in (0.05, 0.3, 1.5):
        steps = scale * generator.normal(size=(300, 2)) * [1.0, 2.0]
        steps[:, 0] = np.clip(steps[:, 0], -2.8, 2.8)
        states = np.array([3.0, 5.0]) + np.cumsum(steps, axis=0)
        states[:, 1] = np.abs(states[:, 1]) % 12.0
        if scale == 0.3:
            states[:, 0] %= TWO_PI
        judge = stepwise(hypotheses, hypotheses, SPACE, between_states)
        entered = np.zeros(len(hypotheses), bool)
        for k, state in enumerate(states):
            entered[list(judge.enter(state.tolist()))] = True
            if k % 60 == 59 or k < 3:
                bits = hypotheses.violations(states[None, : k + 1], SPACE, between_states)[0]
                np.testing.assert_array_equal(entered, unpack(bits, len(hypotheses)))


@pytest.mark.parametrize("between_states", [True, False])
def test_a_margin_leaves_the_inner_part_of_cells(between_states: bool) -> None:
    hypotheses, margin = grid(theta=(0.0, TWO_PI, 5), x=(0.0, 9.0, 4)), {"x": 0.8, "theta": 0.2}
    left = hypotheses.eroded(margin, SPACE)
    generator = np.random.default_rng(3)
    for scale in (0.1, 0.6):
        states = np.array([3.0, 5.0]) + np.cumsum(scale * generator.normal(size=(150, 2)), axis=0)
        states[:, 1] = np.clip(states[:, 1], -1.0, 10.0)
        judge = stepwise(hypotheses, hypotheses.eroded(margin, SPACE), SPACE, between_states)
        entered = np.zeros(len(hypotheses), bool)
        for k, state in enumerate(states):
            entered[list(judge.enter(state.tolist()))] = True
            if k % 30 == 29 or k < 3:
                bits = left.violations(states[None, : k + 1], SPACE, between_states)[0]
                np.testing.assert_array_equal(entered, unpack(bits, len(hypotheses)))
        whole = hypotheses.violations(states[None], SPACE, between_states)[0]
        assert unpack(whole, len(hypotheses)).sum() > entered.sum() > 0


def test_a_tiny_negative_angle_is_a_whole_turn() -> None:
    space = StateSpace(("theta",), ("theta",), np.array([[0.0, TWO_PI]]))
    cells = grid(theta=(0.0, TWO_PI, 4))
    judge = stepwise(cells, cells, space, between_states=True)
    for angle in (-1e-17, 0.0, 1e-17, 0.1, -0.1):
        states = np.array([[[angle]]])
        bits = cells.violations(states, space, between_states=True)
        fresh = stepwise(cells, cells, space, between_states=True)
        assert list(fresh.enter([angle])) == np.flatnonzero(unpack(bits[0], 4)).tolist()
    assert list(judge.enter([0.1])) == [0]
    assert list(judge.enter([-0.1])) == [3]
