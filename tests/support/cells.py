"""State spaces, walks and grids for tests of hypotheses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import settings

from swerve.base.space import TWO_PI, StateSpace
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
fewer = settings(max_examples=25)  # each holds many trajectories
both_settings = pytest.mark.parametrize("between_states", [True, False])
angle_ranges = pytest.mark.parametrize(
    "theta",
    [
        pytest.param((0.0, TWO_PI, 10), id="full circle"),
        pytest.param((7.0, 7.0 + TWO_PI, 9), id="full circle from beyond 2 pi"),
        pytest.param((-20.3, -20.3 + TWO_PI, 1), id="one cell for the circle"),
        pytest.param((-20.3, -20.3 + TWO_PI, 2), id="two cells for the circle"),
        pytest.param((1.0, 5.7, 5), id="most of the circle"),
        pytest.param((13.0, 17.5, 1), id="one cell for most of the circle"),
    ],
)


def as_list(cells: GridHypotheses) -> ConstraintHypotheses:
    return ConstraintHypotheses([cells.constraint(k) for k in range(len(cells))])


def entered(
    hypotheses: HypothesisSet, states: np.ndarray, space: StateSpace, between_states: bool
) -> np.ndarray:
    return unpack(hypotheses.violations(states, space, between_states), len(hypotheses))


def walks(generator: np.random.Generator, num: int = 25, length: int = 6) -> np.ndarray:
    """Random walks [N, L, 2] of short and long steps that leave the grid now and then."""
    steps = generator.normal(size=(num, length, 2)) * generator.choice([0.1, 1.0, 3.0], (num, 1, 1))
    return generator.uniform([-9.0, -5.0], [9.0, 5.0], (num, 1, 2)) + np.cumsum(steps, axis=1)


def refined(states: np.ndarray, generator: np.random.Generator, space: StateSpace) -> np.ndarray:
    """The same polylines with two points more on each segment, somewhere."""
    steps = space.difference(states[:, :-1], states[:, 1:])
    fractions = np.sort(generator.uniform(0.0, 1.0, (2, *steps.shape[:2], 1)), axis=0)
    parts = [states[:, :-1], *(states[:, :-1] + fraction * steps for fraction in fractions)]
    finer = np.stack(parts, axis=2).reshape(len(states), -1, states.shape[-1])
    return np.concatenate([finer, states[:, -1:]], axis=1)


def corners_cut(segments: np.ndarray, widths: Sequence[float]) -> np.ndarray:
    """Return [S] how often a segment [S, 2, 2] in PLANE comes less than twice its resolution deep.

    Into a cell, that is, of a grid with these widths and a line through -4; such a cell need not
    be entered.
    """
    counts = []
    for start, end in segments:
        shares = [
            (-4.0 + width * np.arange(np.ceil(8 / width) + 1) - a) / (b - a)
            for a, b, width in zip(start, end, widths, strict=True)
        ]
        share = np.sort(np.concatenate(shares))
        share = share[(share > 0.0) & (share < 1.0)]
        deep = np.diff(share)[:, None] * np.abs(end - start) / PLANE.resolution
        counts.append((deep.min(axis=1, initial=np.inf) < 4.0).sum())
    return np.array(counts)
