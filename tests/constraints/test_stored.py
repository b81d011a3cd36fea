"""Constraints are the same after a round trip through JSON."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.space import StateSpace
from swerve.constraints.base import Constraint, Union
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.stored import constraint_from_json

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
intervals = st.tuples(st.integers(-24, 20), st.integers(1, 12)).map(
    lambda pair: (pair[0] / 8, (pair[0] + pair[1]) / 8)
)


def in_disc(states: Any) -> Any:
    return (states**2).sum(axis=-1) < 1.0


class TestJson:
    @given(x=intervals, y=intervals)
    def test_boxes_round_trip(self, x, y) -> None:
        box = Box(y=y, x=x)
        back = constraint_from_json(json.loads(json.dumps(box.to_json(), allow_nan=False)))
        assert isinstance(back, Box)
        assert list(back.intervals.items()) == list(box.intervals.items())
        assert back.to_json() == box.to_json()

    def test_a_predicate_comes_back_without_its_function(self) -> None:
        predicate = Predicate("disc", in_disc, num_points=5)
        back: Constraint = constraint_from_json(json.loads(json.dumps(predicate.to_json())))
        assert isinstance(back, Predicate)
        assert (back.name, back.num_points) == ("disc", 5)
        message = "predicate 'disc' was read from a file, which holds its name and not its code"
        with pytest.raises(ValueError, match=message):
            back.contains(np.zeros(2), PLANE)

    def test_a_kind_that_is_not_known_is_named(self) -> None:
        data = {"kind": "annulus", "name": "ring", "num_points": 8}
        with pytest.raises(ValueError, match=r"no kind 'annulus' is known here: a newer version"):
            constraint_from_json(data)

    def test_different_constraints_have_different_json(self) -> None:
        kinds = [Box(x=(0, 1)), Box(y=(0, 1)), Box(x=(0, 2)), Predicate("x", in_disc)]
        kinds.append(Predicate("x", in_disc, 9))
        for a, b in itertools.combinations(kinds, 2):
            assert a.to_json() != b.to_json()


class TestUnion:
    def test_round_trips(self) -> None:
        union = Union("a", [Box(x=(0, math.inf)), ActionBox(f=(0.0, 1.0))])
        back = constraint_from_json(json.loads(json.dumps(union.to_json(), allow_nan=False)))
        assert repr(back) == repr(union)
        assert back.name == "a"
