"""States and actions may have any name, those of parameters and of columns included."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import swerve
from swerve import MDP, Problem, Task
from swerve.problem.record import ProblemRecord

NAMES = (
    "self",
    "cls",
    "name",
    "names",
    "axes",
    "overlap",
    "radius",
    "centre",
    "offset",
    "normal",
    "intervals",
    "corner",
    "states",
    "margin",
    "kind",
    "space",
    "class",
    "theta 1",
    "größe",
)


class Named(MDP):
    """Two states: one of any name, and its speed."""

    state_names: Any
    action_names: Any
    actions = jnp.array([[-1.0], [1.0]])
    bounds = ((-2.0, 2.0), (-2.0, 2.0))
    dt = 0.5
    num_steps = 3

    def __init__(self, name: str) -> None:
        self.state_names, self.action_names = (name, "v"), (name,)

    def dynamics(self, state: Any, action: Any) -> Any:
        return jnp.stack([state[0] + 0.5 * state[1], state[1] + 0.5 * action[0]])

    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        return -(action[0] ** 2)


@pytest.mark.parametrize("name", NAMES)
def test_a_state_and_an_action_may_have_the_name(name: str) -> None:
    mdp = Named(name)
    axis = {name: (-1.0, 1.0)}
    sets: list[Any] = [
        swerve.grid(**{name: (-1.0, 1.0, 2)}),
        swerve.windows(**{name: (-1.0, 1.0, 0.5)}),
        swerve.windows(2, **{name: (-1.0, 1.0, 0.5), "v": (-1.0, 1.0, 0.5)}),
        [
            swerve.Box(**axis),
            swerve.ActionBox(**{name: (0.5, 1.5)}),
            swerve.Ball(0.5, **{name: 0.0}),
            swerve.HalfSpace(0.5, **{name: 1.0}),
            swerve.Polygon([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], (name, "v")),
            swerve.Occupancy("map", [[True]], (0.0, 0.0), 0.5, (name, "v")),
            swerve.StateAction(swerve.Box(**axis), swerve.ActionBox(**{name: (0.5, 1.5)})),
        ],
    ]
    for hypotheses in sets:
        record = Problem(mdp, hypotheses).record
        again = ProblemRecord.from_json(record.to_json())
        assert again.fingerprint == record.fingerprint
        states = np.array([[-1.5, 0.0], [0.2, 0.3], [0.4, 0.0]])
        constraints = [record.hypotheses.constraint(k) for k in range(len(record.hypotheses))]
        for one, other in zip(
            constraints, map(again.hypotheses.constraint, range(len(constraints))), strict=True
        ):
            assert one.name == other.name
            np.testing.assert_array_equal(
                one.contains(states, record.space), other.contains(states, record.space)
            )


def test_an_answer_comes_whatever_the_name() -> None:
    problem = Problem(Named("self"), swerve.grid(self=(-2.0, 2.0, 4)))
    evidence = swerve.sample(swerve.learn(problem, "enumeration"), Task([-1.5, 0.0], [1.0, 0.0]))
    inference = swerve.infer(evidence)
    assert "self" in inference.table()
    margin = swerve.infer(evidence, margin={"self": 0.1})
    assert margin.table()


def test_the_overlap_of_windows_may_be_given_by_name() -> None:
    windows = swerve.windows(x=(0.0, 4.0, 1.0), overlap=2)
    assert windows.overlap == 2
    assert swerve.windows(3, x=(0.0, 4.0, 1.0)).overlap == 3
    both = swerve.windows(2, overlap=(0.0, 4.0, 1.0))
    assert (both.overlap, list(both.axes)) == (2, ["overlap"])
    with pytest.raises(ValueError, match="windows: overlap: expected a whole number >= 1, got 'x'"):
        swerve.windows(x=(0.0, 4.0, 1.0), overlap="x")
