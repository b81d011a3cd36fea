"""Sets that are the same, whatever their names and however they are written."""

from __future__ import annotations

from support.synthetic import SPACE

from swerve import Ball, Box, Union, grid
from swerve.base.space import TWO_PI
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.same import same_as


def test_each_has_the_first_that_is_the_same() -> None:
    hypotheses = ConstraintHypotheses(
        [
            Box(theta=(0.5, 1.0), x=(1.0, 2.0)),
            Ball(0.5, x=1.0),
            Box(theta=(0.5 + TWO_PI, 1.0 + TWO_PI), x=(1.0, 2.0)),
            Box(theta=(0.5, 1.0), x=(1.0, 2.0 + 1e-6)),
            Union("left", [Box(x=(1.0, 2.0)), Box(x=(4.0, 5.0))]),
            Union("right", [Box(x=(4.0, 5.0)), Box(theta=(0.0, TWO_PI), x=(1.0, 2.0))]),
            Ball(0.5 * (1.0 + 1e-12), x=1.0),
        ]
    )
    assert same_as(hypotheses, SPACE).tolist() == [0, 1, 0, 3, 4, 4, 1]


def test_cells_of_a_grid_all_differ() -> None:
    assert same_as(grid(x=(0.0, 10.0, 3)), SPACE).tolist() == [0, 1, 2]
