"""Hypotheses are the same after a round trip through JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.cells import PENDULUM, PLANE, walks

from swerve.base.space import TWO_PI
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import grid
from swerve.hypotheses.stored import hypotheses_from_json


class TestJson:
    @pytest.mark.parametrize(
        "hypotheses",
        [
            grid(theta=(-0.3, TWO_PI - 0.3, 10), omega=(-6.0, 6.0, 7)),
            ConstraintHypotheses([Box(theta=(6.0, 7.1)), Box(omega=(0.1, 0.3), theta=(1, 2))]),
        ],
    )
    def test_round_trip(self, hypotheses: HypothesisSet) -> None:
        text = json.dumps(hypotheses.to_json(), allow_nan=False)
        back = hypotheses_from_json(json.loads(text))
        assert type(back) is type(hypotheses)
        assert json.dumps(back.to_json()) == text
        assert [back.name(k) for k in range(len(back))] == [
            hypotheses.name(k) for k in range(len(hypotheses))
        ]
        states = walks(np.random.default_rng(0), num=50)
        np.testing.assert_array_equal(
            back.violations(states, PENDULUM, True), hypotheses.violations(states, PENDULUM, True)
        )

    def test_a_predicate_comes_back_without_its_code(self) -> None:
        hypotheses = ConstraintHypotheses([Predicate("fast", lambda s: s[..., 0] > 1)])
        back = hypotheses_from_json(json.loads(json.dumps(hypotheses.to_json())))
        assert back.needs_code
        assert back.name(0) == "fast"
        with pytest.raises(ValueError, match="load the problem that defines it"):
            back.violations(np.zeros((1, 2, 2)), PLANE, True)
