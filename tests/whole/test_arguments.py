"""Arguments of the wrong kind, at every public entry: what was expected, what came, what to do."""

from __future__ import annotations

from typing import Any

import pytest
from support.reference import CART_TASK, short_cart
from support.synthetic import make_evidence

import swerve
from swerve.solvers.grid.grid import Grid

PROBLEM = short_cart()
GRID = Grid(num_points=21)
NOMINAL = swerve.learn(PROBLEM, GRID)
WALL = swerve.Box(x=(0.0, 0.2))


@pytest.mark.parametrize(
    ("function", "arguments", "settings", "message"),
    [
        (swerve.learn, ["pendulum"], {}, r"problem: .* got 'pendulum': make .* swerve.load_prob"),
        (swerve.learn, [PROBLEM, swerve.Grid], {}, r"solver: expected a name .*, or an object"),
        (swerve.learn, [PROBLEM, 3], {}, r"solver: expected a name such as 'grid', .*, got 3"),
        (swerve.learn, [PROBLEM, GRID], {"seed": 0.5}, r"seed: expected a whole .*, got 0.5"),
        (swerve.sample, [PROBLEM, CART_TASK], {}, "nominal: expected what swerve.learn returns"),
        (swerve.sample, [NOMINAL, CART_TASK, 1e3], {}, r"num_trajectories: .*, got 1000.0"),
        (
            swerve.sample,
            [NOMINAL, CART_TASK, 9],
            {"seed": -1},
            r"seed: .* from 0 to 4,294,967,295, got -1",
        ),
        (swerve.sample, [NOMINAL, None], {}, r"tasks: expected swerve.Task\(start, goal\), got"),
        (swerve.sample, [NOMINAL, [[1.0]]], {}, r"expected swerve.Task\(start, goal\), got"),
        (swerve.infer, [NOMINAL], {}, "evidence: expected a swerve.Evidence, got GridNominal"),
        (swerve.infer, [make_evidence(), ["a.csv"]], {}, "got a str in it: make one with"),
        (swerve.demonstrate, [PROBLEM, 7, CART_TASK], {}, r"constraint: .*hypotheses\.constraint"),
        (
            swerve.demonstrate,
            [PROBLEM, WALL, CART_TASK],
            {"solver": "ppo"},
            r"solver: expected one of grid, .*, got 'ppo'",
        ),
        (swerve.Grid, [2.5], {}, r"Grid: num_points: expected a whole number .* 2.5"),
        (swerve.Grid, [(21, 0)], {}, r"Grid: num_points: .* >= 4, got 0"),
        (swerve.PPO, [1e6], {}, r"PPO: num_steps: .*, got 1000000.0"),
    ],
)
def test_arguments_of_the_wrong_kind(
    function: Any, arguments: list, settings: dict, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        function(*arguments, **settings)


def test_texts_name_solvers_and_problems_in_python_too() -> None:
    assert swerve.load_problem("pendulum?max_torque=3").mdp.max_torque == 3.0
    nominal = swerve.learn(PROBLEM, "grid?num_points=21,31")
    assert nominal.solver == Grid(num_points=(21, 31))
    made = swerve.demonstrate(PROBLEM, WALL, [CART_TASK], solver="grid?num_points=41")
    assert not WALL.contains(made[0].states, PROBLEM.mdp.space).any()
