"""The reference stands alone, is right where one can tell by hand, and covers what is public."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest
from brute_force.reference.answers import Weighted
from brute_force.reference.geometry import AmbiguousError, Axes, meets, polygon_depth
from brute_force.reference.paths import all_paths, log_sum
from brute_force.reference.regions import BallRegion, BoxRegion, MapRegion, Region, Steps
from brute_force.reference.worlds import TableWorld

import swerve

HERE = Path(__file__).parent
PLANE = Axes(("x", "y"))
COVERED = {
    "test_exact": (
        "Box Ball HalfSpace Polygon Occupancy Predicate Union ActionBox StateAction Constraint "
        "HypothesisSet grid windows MDP Problem Task Demonstration tabular TabularMDP Enumeration "
        "Tabular learn sample Evidence infer Inference greedy Pick Picks best_pair Pair divergence"
    ),
    "test_known_weights": "fit_beta BetaFit hoeffding_error hoeffding_sample_size",
    "test_monitoring": "Monitor follow Course",
    "test_tables": "Discrete SoftPaths",
    "test_systems": (
        "Pendulum DoublePendulum Car Walker Gridworld StateSpace rk4 read_demonstrations "
        "write_demonstrations"
    ),
    "test_sampled": (
        "Grid Nominal resolve Rollouts demonstrate foresee Foresight PPO SoftValue load_nominal "
        "save_nominal"
    ),
}
ELSEWHERE = {
    "Distilled": "tests/solvers/trained/test_distilled.py",  # a network fitted to a grid's values
    "Optimum": "tests/demonstrators",  # continuous actions, which nobody can enumerate
    "optimal_control": "tests/demonstrators",
}
NO_NUMBER = {  # give pictures, problems, or random tasks
    "animate_course", "plot_contributions", "plot_course", "plot_posterior", "draw_tasks",
    "load_problem", "read_tasks",
}  # fmt: skip


def test_every_public_name_that_gives_a_number_is_covered() -> None:
    covered = [name for names in COVERED.values() for name in names.split()]
    assert len(covered) == len(set(covered))
    assert {*covered, *ELSEWHERE, *NO_NUMBER} == set(swerve.__all__)
    for test, names in COVERED.items():
        assert (HERE / f"{test}.py").is_file(), names
    for place in ELSEWHERE.values():
        assert (HERE.parents[1] / place).exists()


def test_the_reference_holds_no_code_of_the_library() -> None:
    files = sorted((HERE / "reference").glob("*.py"))
    assert files
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            for name in names:
                top = name.partition(".")[0]
                assert top not in ("swerve", "jax", "support"), f"{path.name} imports {name}"
                inside = name.startswith("brute_force.reference")
                assert top != "brute_force" or inside, f"{path.name} imports {name}"


SQUARE = BoxRegion({"x": (1.0, 2.0), "y": (1.0, 2.0)})
CHECKED = MapRegion(((False, True), (True, False)), (0.0, 0.0), 1.0, ("x", "y"))


@pytest.mark.parametrize(
    ("region", "start", "end", "expected"),
    [
        (SQUARE, (0.0, 1.5), (3.0, 1.5), True),  # right through
        (SQUARE, (0.0, 1.5), (0.9, 1.5), False),
        (SQUARE, (0.0, 0.1), (3.0, 3.0), True),
        (SQUARE, (0.5, 1.6), (1.6, 2.6), False),  # past a corner, 2.1 - 0.5 sqrt(2) away at least
        (BallRegion(1.0, {"x": 0.0, "y": 0.0}), (-2.0, 0.99), (2.0, 0.99), True),
        (BallRegion(1.0, {"x": 0.0, "y": 0.0}), (-2.0, 1.01), (2.0, 1.01), False),
        (CHECKED, (0.2, 0.2), (0.8, 0.8), False),
        (CHECKED, (0.2, 0.2), (1.2, 0.2), True),  # into a blocked cell
        (CHECKED, (0.2, 0.2), (-0.2, 0.2), True),  # beyond the map
    ],
)
def test_segments(region: Region, start: tuple, end: tuple, expected: bool) -> None:
    steps = Steps(np.array([start]), np.array([end]), np.zeros((1, 1)), ("a",))
    assert region.entered(steps, PLANE, True)[0] == expected


def test_what_passes_an_edge_closely_is_refused() -> None:
    ball = BallRegion(1.0, {"x": 0.0, "y": 0.0})
    steps = Steps(np.array([[-2.0, 1.0]]), np.array([[2.0, 1.0]]), np.zeros((1, 1)), ("a",))
    with pytest.raises(AmbiguousError):
        ball.entered(steps, PLANE, True)


def test_segments_agree_with_many_points() -> None:
    generator = np.random.default_rng(0)
    vertices = np.array([(0.0, 0.0), (2.0, 0.2), (0.6, 0.8), (0.3, 2.0)])
    depth = lambda points: polygon_depth(vertices, points)  # noqa: E731
    starts, ends = generator.uniform(-1.0, 3.0, (2, 300, 2))
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    deepest = np.array(
        [depth(a + share * (b - a)).max() for a, b in zip(starts, ends, strict=True)]
    )
    clear = np.abs(deepest) > 2e-3
    found = meets(depth, starts[clear], (ends - starts)[clear])
    np.testing.assert_array_equal(found, deepest[clear] > 0.0)
    assert 50 < found.sum() < 250


def test_an_interval_of_an_angle_lies_anywhere() -> None:
    axes, box = Axes(("theta",), ("theta",)), BoxRegion({"theta": (3.0, 3.5)})
    assert box.holds(np.array([[3.2], [3.2 - 2 * math.pi], [3.2 + 4 * math.pi]]), axes).all()
    steps = Steps(np.array([[2.9]]), np.array([[3.6 - 2 * math.pi]]), np.zeros((1, 1)), ("a",))
    assert box.entered(steps, axes, True)[0]
    assert not box.entered(steps, axes, False)[0]


def test_a_world_of_two_states_by_hand() -> None:
    """Stay (0) or move (1), two steps, from state 0: R is 0, -1, -1 and -2, by moves."""
    world = TableWorld(
        successors=np.array([[0, 1], [1, 0]]),
        rewards=np.array([[0.0, -1.0], [0.0, -1.0]]),
        terminal=np.zeros(2),
        absorbing=np.zeros(2, bool),
        num_steps=2,
    )
    paths = all_paths(world, np.zeros(1), np.zeros(0))
    assert sorted(paths.reward) == [-2.0, -1.0, -1.0, 0.0]
    weight = 1.0 + 2.0 * math.exp(-1.0) + math.exp(-2.0)
    assert log_sum(paths.log_weight(1.0, "counting")) == pytest.approx(math.log(weight))
    assert log_sum(paths.log_weight(1.0, "uniform")) == pytest.approx(math.log(weight / 4.0))
    enters = paths.enters(BoxRegion({"state": (0.5, 1.5)}), False)
    task = Weighted(paths.log_weight(1.0, "counting"), enters[:, None])
    assert task.avoid_probability([0]) == pytest.approx(1.0 / weight)
