"""Problems are checked when they are made."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from support.reference import Cart
from support.small_mdps import ANGLES, CELLS, Bare

from swerve import Box, Problem, grid
from swerve.hypotheses.base import HypothesisSet


class TestProblem:
    def test_a_list_of_constraints_becomes_a_set(self) -> None:
        boxes = [Box(x=(0.0, 1.0)), Box(v=(0.0, 1.0))]
        problem = Problem(Cart(), boxes, known=[boxes[0]])
        assert isinstance(problem.hypotheses, HypothesisSet)
        assert [problem.hypotheses.constraint(k) for k in range(2)] == boxes
        assert problem.known == (boxes[0],)

    @pytest.mark.parametrize("beta", [0, -0.1, math.inf, math.nan, "1"])
    def test_beta_has_to_be_a_number_above_0(self, beta: Any) -> None:
        with pytest.raises(ValueError, match=f"beta: expected a finite number > 0, got {beta!r}"):
            Problem(Cart(), CELLS, beta=beta)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"mdp": Cart}, "mdp: expected a swerve.MDP, got <class"),
            ({"mdp": "pendulum"}, "mdp: expected a swerve.MDP, got 'pendulum'"),
            (
                {"measure": "flat"},
                r"measure: expected one of \('uniform', 'counting'\), got 'flat'",
            ),
            ({"hypotheses": []}, "hypotheses: expected at least one constraint"),
            ({"hypotheses": ["wall"]}, r"hypotheses\[0\]: expected a Constraint, got 'wall'"),
            ({"hypotheses": ANGLES}, "no state named 'theta'; the states are x, v"),
            ({"hypotheses": [Box(y=(0, 1))]}, "no state named 'y'; the states are x, v"),
            ({"known": [Box(x=(0, 1)), 7]}, r"known\[1\]: expected a Constraint, got 7"),
            ({"known": [Box(y=(0, 1))]}, "no state named 'y'; the states are x, v"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, arguments: dict[str, Any], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            Problem(**{"mdp": Cart(), "hypotheses": CELLS} | arguments)

    def test_an_angle_may_not_span_more_than_a_turn(self) -> None:
        with pytest.raises(ValueError, match="2 pi at most"):
            Problem(Bare(), grid(theta=(0.0, 7.0, 3)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"hypotheses": Box(x=(0.0, 1.0))}, "hypotheses: expected a list of constraints, got"),
        ({"known": Box(x=(0.0, 1.0))}, "known: expected a list of constraints, got"),
    ],
)
def test_one_constraint_in_the_place_of_a_list(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Problem(**({"mdp": Cart(), "hypotheses": grid(x=(0.0, 1.0, 2))} | settings))


class Windy(Bare):
    """Its dynamics call what they were given."""

    wind: Callable = None  # pyright: ignore

    def dynamics(self, state, action):
        return super().dynamics(state, action) + self.wind(state)


class Breeze:
    """An object that can be called."""

    def __call__(self, state):
        return 0.1 * state


def gust(state, speed):
    return speed * state


def test_parameters_that_can_be_called() -> None:
    """Named functions, functions with some arguments given, and objects of a class."""
    winds = [Breeze(), partial(gust, speed=0.1), partial(gust, speed=0.2)]
    digests = [Problem(Windy(wind=wind), ANGLES).record.mdp_digest for wind in winds]
    assert len(set(digests)) == 3
    assert Problem(Windy(wind=Breeze()), ANGLES).record.mdp_digest == digests[0]
