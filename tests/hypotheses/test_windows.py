"""Overlapping windows are the list of boxes that they stand for."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic import SPACE

from swerve import Box, windows
from swerve.base.space import TWO_PI
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.stored import hypotheses_from_json

seeds = st.integers(0, 2**31 - 1)
SETS = {
    "plane": windows(x=(0.5, 9.0, 1.5), theta=(1.0, 5.0, 0.9)),
    "line": windows(2, x=(0.0, 10.0, 4.0)),
    "round": windows(3, theta=(0.4, 0.4 + TWO_PI, TWO_PI / 4), x=(2.0, 8.0, 2.0)),
    "over the seam": windows(3, theta=(5.0, 8.0, 1.5)),
    "cells": windows(1, x=(0.0, 10.0, 2.5)),
}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("between_states", [True, False])
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_are_entered_as_boxes_are(name: str, between_states: bool, seed: int) -> None:
    generator, made = np.random.default_rng(seed), SETS[name]
    states = np.cumsum(generator.normal(0.0, 0.6, (20, 8, 2)), axis=1)
    states = states + generator.uniform((0.0, 0.0), (TWO_PI, 10.0), (20, 1, 2))
    boxes = ConstraintHypotheses(made.constraint(index) for index in range(len(made)))
    found = made.violations(states, SPACE, between_states)
    np.testing.assert_array_equal(found, boxes.violations(states, SPACE, between_states))
    assert 0.0 < unpack(found, len(made)).mean() < 1.0


@pytest.mark.parametrize("name", SETS)
def test_distance_is_that_of_boxes(name: str) -> None:
    made = SETS[name]
    states = np.random.default_rng(0).uniform((-3.0, -2.0), (9.0, 12.0), (50, 2))
    boxes = np.stack(
        [made.constraint(index).distance(states, SPACE) for index in range(len(made))], axis=-1
    )
    np.testing.assert_allclose(made.distance(states, SPACE), boxes, atol=1e-9)
    inside = np.stack(
        [made.constraint(index).contains(states, SPACE) for index in range(len(made))], axis=-1
    )
    np.testing.assert_array_equal(boxes == 0.0, inside)


def test_lie_within_their_ranges_a_stride_apart() -> None:
    made = windows(4, x=(0.0, 3.1, 1.0))
    assert made.shape == (9,)  # 12 strides of 0.25 fit
    assert len(made) == 9
    assert made.constraint(0).intervals == {"x": (0.0, 1.0)}
    assert made.constraint(8).intervals == {"x": (2.0, 3.0)}
    assert windows(4, x=(0.0, 1.0, 1.0)).shape == (1,)


def test_go_round() -> None:
    made = windows(4, theta=(0.0, TWO_PI, TWO_PI / 4))
    assert made.shape == (16,)
    low, high = made.constraint(15).intervals["theta"]
    assert high > TWO_PI > low
    states = np.array([[[0.1, 0.0], [0.1, 0.0]]])
    entered = np.flatnonzero(unpack(made.violations(states, SPACE, True), 16)[0])
    np.testing.assert_array_equal(entered, [0, 13, 14, 15])


def test_round_trip() -> None:
    for made in SETS.values():
        again = hypotheses_from_json(json.loads(json.dumps(made.to_json())))
        assert again.to_json() == made.to_json()
        assert again.name(3) == made.name(3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "expected at least one axis"),
        ({"x": (0.0, 1.0)}, r"expected x=\(low, high, width\)"),
        ({"x": (1.0, 0.0, 0.5)}, "expected finite low < high for 'x'"),
        (
            {"x": (0.0, 1.0, 2.0)},
            "expected a width above 0 and at most 1, the range of 'x', got 2.0",
        ),
        ({"x": (0.0, 1.0, 0.0)}, "expected a width above 0"),
        ({"overlap": 0, "x": (0.0, 1.0, 0.5)}, "overlap: expected a whole number >= 1, got 0"),
    ],
)
def test_bad_ranges(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"windows: {message}"):
        windows(**arguments)


def test_a_full_turn_is_for_angles() -> None:
    with pytest.raises(ValueError, match="'x' has the range of a full turn, 2 pi, but is no angle"):
        windows(x=(0.0, TWO_PI, TWO_PI / 6)).check(SPACE, ("u",))
    windows(theta=(0.0, TWO_PI, TWO_PI / 6)).check(SPACE, ("u",))
    with pytest.raises(ValueError, match="no state named 'z'"):
        windows(z=(0.0, 1.0, 0.5)).check(SPACE, ("u",))


class TestErosion:
    def test_is_what_is_deeper_inside(self) -> None:
        made = windows(2, x=(0.0, 10.0, 4.0), theta=(0.0, 2.0, 1.0))
        eroded = made.eroded({"x": 0.5, "theta": 0.1}, SPACE)
        assert len(eroded) == len(made)
        for index in range(len(made)):
            before, after = made.constraint(index), eroded.constraint(index)
            assert isinstance(after, Box)
            for name, width in (("x", 0.5), ("theta", 0.1)):
                low, high = before.intervals[name]
                assert after.intervals[name] == (low + width, high - width)

    def test_bad_margins(self) -> None:
        made = windows(2, x=(0.0, 10.0, 4.0))
        message = "2 for 'x' leaves nothing of x .* expected less than half its width, 2"
        with pytest.raises(ValueError, match=message):
            made.eroded({"x": 2.0}, SPACE)
        with pytest.raises(ValueError, match="no state named 'z'"):
            made.eroded({"z": 0.1}, SPACE)
        for width in (-0.1, math.nan):
            with pytest.raises(ValueError, match="margin: expected a width >= 0 for 'x'"):
                made.eroded({"x": width}, SPACE)
