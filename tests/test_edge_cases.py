"""Edge cases that were wrong once: lines, gaps and corners, open boxes, fingerprints, bad goals."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from constraints.test_constraints import meets_exactly
from hypothesis import given, settings
from hypothesis import strategies as st
from support.reference import Cart
from support.synthetic import (
    TASKS,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
)

from swerve import Box, Problem, Task, grid, hoeffding_error, infer
from swerve.base.space import TWO_PI, StateSpace
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.estimators import avoid_probability
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import GridHypotheses
from swerve.problem.loading import _is_user_source

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)


def entered(cells, states, space, between_states=True):
    return unpack(cells.violations(states, space, between_states), len(cells))


def test_a_segment_from_gap_to_gap_enters_the_cells_between() -> None:
    cells = grid(theta=(0.3, 2.0, 5))
    states = np.array(
        [[[-0.2, 0.0], [2.3, 0.0]], [[2.3, 0.0], [6.1, 0.0]], [[3.0, 0.0], [4.0, 0.0]]]
    )
    np.testing.assert_array_equal(entered(cells, states, PENDULUM).sum(axis=1), [5, 5, 0])


@settings(max_examples=25)
@given(seed=seeds)
def test_grid_agrees_with_boxes_on_a_small_range_of_an_angle(seed) -> None:
    generator = np.random.default_rng(seed)
    cells = grid(theta=(6.0, 7.5, 4), omega=(-4.0, 4.5, 7))
    boxes = ConstraintHypotheses([cells.constraint(k) for k in range(len(cells))])
    states = generator.uniform([-9.0, -5.0], [9.0, 5.0], (25, 6, 2))
    np.testing.assert_array_equal(
        cells.violations(states, PENDULUM, True), boxes.violations(states, PENDULUM, True)
    )


@settings(max_examples=50)
@given(seed=seeds, backwards=st.booleans())
def test_a_segment_that_ends_on_a_line_enters_all_cells_up_to_it(seed, backwards) -> None:
    """Whatever the rounding of its length."""
    generator = np.random.default_rng(seed)
    cells = grid(omega=(-6.0, 6.0, 10))
    starts, index = generator.uniform(-6.0, 6.0, 500), generator.integers(0, 10, 500)
    ends = -6.0 + 1.2 * index
    index = np.floor((ends + 6.0) / 1.2).astype(int)
    omega = np.stack([ends, starts] if backwards else [starts, ends], axis=1)
    hits = entered(cells, np.stack([0 * omega, omega], axis=-1), PENDULUM)
    first = np.floor((starts + 6.0) / 1.2).astype(int)
    np.testing.assert_array_equal(hits.sum(axis=1), 1 + np.abs(index - first))


def test_a_segment_that_ends_on_a_line_example() -> None:
    """A speed that comes to -6 + 9 * 1.2: cell 8 was missing."""
    states = np.array([[[1.25, -3.6020715567945087], [1.25, -6.0 + 9 * 1.2]]])
    hits = entered(grid(omega=(-6.0, 6.0, 10)), states, PENDULUM)[0]
    np.testing.assert_array_equal(np.flatnonzero(hits), np.arange(1, 10))


@settings(max_examples=30)
@given(seed=seeds)
def test_grid_agrees_with_exact_arithmetic(seed) -> None:
    """On quarters, where segments run through corners: a corner that is touched is not entered."""
    cells = grid(x=(-2.0, 2.0, 8), y=(-3.0, 3.0, 6))
    states = np.random.default_rng(seed).integers(-16, 17, (20, 2, 2)) / 4
    boxes = [list(cells.constraint(k).intervals.values()) for k in range(48)]
    expected = [[meets_exactly(a, b, box) for box in boxes] for a, b in states]
    np.testing.assert_array_equal(entered(cells, states, PLANE), expected)


def test_both_diagonals_are_alike() -> None:
    cells = grid(x=(0.0, 2.0, 2), y=(0.0, 2.0, 2))
    down, up = np.array([[[0.5, 1.5], [1.5, 0.5]], [[0.5, 0.5], [1.5, 1.5]]])
    hits = entered(cells, np.stack([down, up]), PLANE)
    assert [set(np.flatnonzero(row)) for row in hits] == [{1, 2}, {0, 3}]


def test_evidence_on_boxes_with_open_sides_is_saved(tmp_path: Path) -> None:
    boxes = ConstraintHypotheses([Box(x=(-math.inf, 2.0)), Box(x=(2.0, math.inf))])
    evidence = make_evidence(make_record(hypotheses=boxes, known=(Box(x=(9.5, math.inf)),)))
    evidence.save(tmp_path / "a.evidence")
    back = Evidence.load(tmp_path / "a.evidence").problem
    assert back.fingerprint == evidence.problem.fingerprint
    json.dumps(back.to_json(), allow_nan=False)
    assert [back.hypotheses.name(k) for k in range(2)] == ["x [-inf, 2)", "x [2, inf)"]


class Rigging(eqx.Module):
    kind: str = eqx.field(static=True, default="sloop")


class Ship(Cart):
    buoys: tuple = eqx.field(default=(1.0, 2.0), static=True)
    rigging: Rigging = Rigging()
    wind: object = None


def test_a_fingerprint_depends_on_static_fields_of_any_kind() -> None:
    cells = grid(x=(-1.5, 1.5, 6))
    ships = [Ship(), Ship(buoys=(1.0, 3.0)), Ship(rigging=Rigging("cat"))]
    assert len({Problem(ship, cells).record.fingerprint for ship in ships}) == 3


def test_a_fingerprint_does_not_depend_on_addresses() -> None:
    """A field that holds a function: the same problem in two processes."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_edge_cases as t, numpy as np;"
        "junk = [object() for _ in range(int(sys.argv[2]))];"
        "wind = eval('lambda x: x', {'__name__': 'm'});"
        "print(t.Problem(t.Ship(wind=wind), t.grid(x=(0, 1, 2))).record.fingerprint)"
    )
    folder = str(Path(__file__).parent)
    prints = {
        subprocess.run(
            [sys.executable, "-c", code, folder, num], capture_output=True, text=True, check=True
        ).stdout
        for num in ("0", "100000")
    }
    assert len(prints) == 1


@pytest.mark.parametrize("goal", [[1.0], [1.0, 2.0, 3.0], []])
def test_a_goal_of_the_wrong_length_is_refused(goal: list[float]) -> None:
    states = make_demonstration(0).states
    wrong = Demonstration("demo_9", states, Task(TASKS.start[0], np.array(goal)))
    with pytest.raises(
        ValueError, match=f"demo_9: expected a goal of 2 numbers .*, got {len(goal)}"
    ):
        infer(make_evidence(), [wrong])


@pytest.mark.parametrize("num", [0, -3])
def test_hoeffding_needs_a_trajectory(num: int) -> None:
    with pytest.raises(ValueError, match=f"num_trajectories: expected .* >= 1, got {num}"):
        hoeffding_error(num)


def test_nan_weights_are_refused() -> None:
    with pytest.raises(ValueError, match="1 of 2 log-weights are NaN"):
        avoid_probability(np.array([0.0, np.nan]), np.zeros((2, 1), np.uint8), 3)


def test_the_whole_circle_contains_every_angle() -> None:
    box = Box(theta=(0.0, TWO_PI))
    tiny = np.array([0.0, -0.0, -1e-300, -1e-17, -1e-16, 1e-17, TWO_PI, -TWO_PI])
    assert box.contains(np.stack([tiny, tiny], axis=-1), PENDULUM).all()
    tiny = jnp.array([0.0, -1e-8, -1e-7, -1e-9])
    assert box.contains(jnp.stack([tiny, tiny], axis=-1), PENDULUM).all()


@pytest.mark.parametrize(
    "path",
    [
        "/home/me/.local/lib/python3.11/site-packages/jax/core.py",
        "/usr/lib/python3/dist-packages/yaml/nodes.py",
    ],
)
def test_packages_installed_elsewhere_are_no_sources(path: str) -> None:
    assert not _is_user_source(Path(path))


@pytest.mark.parametrize("cells", [math.nan, math.inf])
def test_a_number_of_cells_that_is_not_finite_is_refused(cells: float) -> None:
    with pytest.raises(ValueError, match="grid: expected a whole number of cells for 'x'"):
        GridHypotheses({"x": (0.0, 1.0, cells)})  # pyright: ignore[reportArgumentType]


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


def test_one_demonstration_in_the_place_of_a_list() -> None:
    evidence = make_evidence()
    with pytest.raises(ValueError, match=r"expected a list of demonstrations, got .* alone"):
        infer(evidence, make_demonstration())  # pyright: ignore[reportArgumentType]


def test_a_number_in_the_place_of_an_interval() -> None:
    with pytest.raises(ValueError, match=r"Box: expected x=\(low, high\), got 3"):
        Box(x=3)  # pyright: ignore[reportArgumentType]


def test_a_demonstration_through_a_known_wall_is_refused() -> None:
    evidence = make_evidence(make_record(known=(Box(x=(5.0, 6.0)),)))
    inside = make_demonstration(0, "ghost", x=5.5)
    with pytest.raises(ValueError, match=r"ghost enters the known constraint x \[5, 6\)"):
        infer(evidence, [inside])
    assert len(infer(evidence, [make_demonstration(0, x=4.5)]).demonstrations) == 1


def test_too_few_samples_are_told_from_a_bad_policy() -> None:
    cells = grid(x=(0.0, 9.0, 3))
    few = infer(evidence_of_columns(np.zeros((1, 50, 3)), cells)).warnings
    assert "Sample more trajectories" in few[0]
    assert "policy" not in few[0]
