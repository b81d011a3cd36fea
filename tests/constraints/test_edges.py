"""The rule of edges: every way of judging gives the same answer at every float near an edge."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from swerve import (
    ActionBox,
    Ball,
    Box,
    HalfSpace,
    Occupancy,
    Polygon,
    Union,
    grid,
    windows,
)
from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import Constraint
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.stepwise import stepwise

LINE = StateSpace(("x", "y"), (), np.array([[-3.0, 3.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)


def around(values: np.ndarray) -> np.ndarray:
    """The numbers, their neighbours on both sides in either precision, and both roundings."""
    near = [values]
    for kind in (np.float64, np.float32):
        rounded = values.astype(kind)
        near += [rounded, *(np.nextafter(rounded, kind(side)) for side in (-np.inf, np.inf))]
    return np.unique(np.concatenate([x.astype(np.float64) for x in near]))


def by_jax(judge: Callable, *states: np.ndarray) -> np.ndarray:
    return np.asarray(judge(*(jnp.asarray(x, jnp.float32) for x in states)))


class AllWays:
    """Judges segments in all the ways there are, and compares the answers."""

    def __init__(self, hypotheses: HypothesisSet, space: StateSpace) -> None:
        self.hypotheses, self.space = hypotheses, space
        constraints = [hypotheses.constraint(k) for k in range(len(hypotheses))]
        self.listed = ConstraintHypotheses(constraints)
        self.known = jax.jit(
            lambda a, b: jnp.stack([c.crosses(a, b, space) for c in constraints], axis=-1)
        )

    def __call__(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return [S, H] which hypotheses segments enter."""
        states, num = np.stack([starts, ends], axis=1), len(self.hypotheses)
        cases = [(h, k) for h in (self.hypotheses, self.listed) for k in (np.float64, np.float32)]
        answers = [unpack(h.violations(states.astype(k), self.space, True), num) for h, k in cases]
        answers.append(
            np.asarray(self.known(*(jnp.asarray(x, jnp.float32) for x in (starts, ends))))
        )
        monitored = np.zeros((len(states), num), bool)
        for row, path in zip(monitored, states.tolist(), strict=True):
            steps = stepwise(self.hypotheses, self.hypotheses, self.space, True)
            for state in path:
                row[list(steps.enter(state))] = True
        for other in (*answers[1:], monitored):
            np.testing.assert_array_equal(other, answers[0])
        return answers[0]


class TestSideOfAnEdge:
    @given(tenth=st.integers(-29, 29), width=st.integers(1, 30))
    @example(tenth=-12, width=3)
    def test_a_decimal_is_on_its_edge_in_either_precision(self, tenth, width) -> None:
        """And so is what sums of tenths come to, in float32 and float64."""
        low, high = tenth / 10, (tenth + width) / 10
        for kind in (np.float64, np.float32):
            sums = [kind(0.0)]
            for _ in range(abs(tenth)):
                sums.append(sums[-1] + kind(math.copysign(0.1, tenth)))
            on = np.array([kind(low), kind(tenth) * kind(0.1), kind(tenth) / kind(10), sums[-1]])
            states = np.stack([on, np.zeros(4, kind)], axis=-1)
            assert Box(x=(low, high)).contains(states, LINE).all()
            assert not Box(x=(low - 1.0, low)).contains(states, LINE).any()
            assert by_jax(lambda s: Box(x=(low, high)).contains(s, LINE), states).all()

    def test_only_a_millionth_of_the_extent_counts_as_on_the_edge(self) -> None:
        states = np.array([[0.5 - 1e-5, 0.0], [0.5 - 1e-6, 0.0], [0.5, 0.0]])
        inside = Box(x=(0.5, 1.0)).contains(states, LINE)
        np.testing.assert_array_equal(inside, [False, True, True])

    @pytest.mark.parametrize("offset", [2e-4, -0.002, 0.0, 0.03, 4.0])
    def test_states_on_the_edge_of_a_half_space_are_inside(self, offset: float) -> None:
        """However small the offset is beside the states, whose float32 is coarser."""
        space = StateSpace(("x", "y"), (), np.array([[-12.0, 12.0]] * 2))
        x = np.random.default_rng(0).uniform(-8.0, 8.0, 2_000)
        edge = HalfSpace(offset, x=1.0, y=-1.0)
        for kind in (np.float64, np.float32):
            states = np.stack([x, x - offset], axis=-1).astype(kind)
            assert edge.contains(states, space).all()
        assert by_jax(lambda s: edge.contains(s, space), states).all()

    def test_states_on_the_edge_of_a_small_region_far_from_zero_are_outside(self) -> None:
        space = StateSpace(("x", "y"), (), np.array([[0.0, 900.0]] * 2))
        angle = np.random.default_rng(0).uniform(0.0, TWO_PI, 2_000)
        round_it = np.stack([800.0 + 0.02 * np.cos(angle), 0.02 * np.sin(angle)], axis=-1)
        ball = Ball(0.02, x=800.0, y=0.0)
        side = np.stack([800.0 + 0.02 * np.sin(angle), np.full(2_000, 0.01)], axis=-1)
        square = Polygon([(799.9, 0.01), (800.1, 0.01), (800.1, 0.03), (799.9, 0.03)])
        for region, states in ((ball, round_it), (square, side)):
            assert not region.contains(states, space).any()
            assert not by_jax(lambda s, r=region: r.contains(s, space), states).any()
            assert region.contains(np.array([800.0, 0.02 if region is square else 0.0]), space)

    @pytest.mark.parametrize(("x", "width"), [(5.2e6, 4.0), (48.0, 3e-5)])
    def test_small_regions_where_float32_is_coarse_keep_most_of_their_width(
        self, x: float, width: float
    ) -> None:
        """Metres of a map grid, and degrees of latitude."""
        space = StateSpace(("x", "y"), (), np.array([[x - 50 * width, x + 50 * width]] * 2))
        low, high = x - width / 2, x + width / 2
        middle, aside = np.array([x, x]), np.array([width, 0.0])
        for region in (
            Ball(width / 2, x=x, y=x),
            Polygon([(low, low), (high, low), (high, high), (low, high)]),
        ):
            assert region.contains(middle, space)
            assert region.crosses(middle - aside, middle + aside, space)
            assert not region.contains(middle + aside, space)

    def test_narrow_windows_have_the_edges_of_boxes(self) -> None:
        slid = windows(x=(0.0, 1.0, 0.02), overlap=4)
        listed = ConstraintHypotheses([slid.constraint(k) for k in range(len(slid))])
        edges = np.concatenate(slid.edges()["x"])
        below = np.random.default_rng(0).uniform(0.0, 6e-6, len(edges))
        states = np.stack([edges - below, np.zeros(len(edges))], axis=-1)[:, None]
        answers = [h.violations(states, LINE, False) for h in (slid, listed)]
        np.testing.assert_array_equal(answers[0], answers[1])

    @pytest.mark.parametrize("bound", [10.0, 1e3, 1e5, 1e6])
    def test_wide_bounds_do_not_move_the_edges_of_small_regions(self, bound: float) -> None:
        """At most one state in a thousand lies within the resolution of an edge."""
        space = StateSpace(("x", "y"), (), np.array([[-bound, bound]] * 2))
        x, y = np.random.default_rng(0).uniform(-3.0, 3.0, (2, 20_000))
        states = np.stack([x, y], axis=-1)
        cells = grid(x=(-3.0, 3.0, 20)).cells(states, space)
        assert (cells != np.floor((x + 3.0) / 0.3)).mean() < 1e-3
        expected = {
            Box(x=(0.3, math.inf)): x >= 0.3,
            Ball(0.5, x=0.0, y=0.0): np.hypot(x, y) < 0.5,
            HalfSpace(0.3, x=1.0, y=-1.0): x - y >= 0.3,
            Polygon([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]): (x < 1) & (y > 0) & (y < x),
            Occupancy("map", np.eye(2, dtype=bool), (-3, -3), 3.0): (x < 0) == (y < 0),
        }
        for constraint, inside in expected.items():
            assert (constraint.contains(states, space) != inside).mean() < 1e-3

    def test_far_from_zero_the_resolution_is_that_of_float32(self) -> None:
        """Coordinates of a map grid, in metres."""
        space = StateSpace(("x",), (), np.array([[5e5, 5e5 + 10.0]]))
        assert space.resolution[0] == pytest.approx(0.0625)
        edge = 5e5 + 4.3
        assert Box(x=(edge, edge + 1)).contains(np.array([edge], np.float32), space)

    @pytest.mark.parametrize("edge", [0.0, math.pi, -math.pi, TWO_PI, 1.5 * math.pi, 7.0])
    def test_an_angle_is_on_its_edge_at_every_turn(self, edge: float) -> None:
        above, below = Box(theta=(edge, edge + 1.0)), Box(theta=(edge - 1.0, edge))
        cells = grid(theta=(edge, edge + TWO_PI, 4))
        theta = edge + TWO_PI * np.arange(-8, 9)
        for kind in (np.float64, np.float32):
            states = np.stack([theta, np.zeros(17)], axis=-1).astype(kind)
            assert above.contains(states, PENDULUM).all()
            assert not below.contains(states, PENDULUM).any()
            assert (cells.cells(states, PENDULUM) == 0).all()
            assert by_jax(lambda s: above.contains(s, PENDULUM), states).all()
            assert not by_jax(lambda s: below.contains(s, PENDULUM), states).any()

    @pytest.mark.parametrize("turns", [-120, -16, 15, 100])
    def test_an_interval_many_turns_away(self, turns: int) -> None:
        theta = np.arange(0.05, TWO_PI, 0.1)
        states = np.stack([theta, np.zeros(len(theta))], axis=-1)
        low = 1.0 + TWO_PI * turns
        expected = (theta >= 1.0) & (theta < 2.0)
        inside = Box(theta=(low, low + 1.0)).contains(states, PENDULUM)
        np.testing.assert_array_equal(inside, expected)
        cells = grid(theta=(low, low + 1.0, 1)).cells(states, PENDULUM)
        np.testing.assert_array_equal(cells == 0, expected)

    @pytest.mark.parametrize("turn", [6.283185, 6.2831853, TWO_PI])
    def test_a_full_turn_in_decimals(self, turn: float) -> None:
        cells = grid(theta=(0.0, turn, 7))
        ends = np.array([0.0, turn, TWO_PI])
        theta = around(np.concatenate([ends + TWO_PI * k for k in range(-3, 4)]))
        states = np.stack([theta, np.zeros(len(theta))], axis=-1)
        boxes = [cells.constraint(k).contains(states, PENDULUM) for k in range(7)]
        found = cells.cells(states, PENDULUM)
        np.testing.assert_array_equal(np.sum(boxes, axis=0), 1)
        np.testing.assert_array_equal(np.argmax(boxes, axis=0), found)

    def test_every_float_near_a_line_of_an_angle_is_in_one_cell(self) -> None:
        cells = grid(theta=(-math.pi, math.pi, 7), omega=(-6.0, 6.0, 10))
        lines = -math.pi + TWO_PI / 7 * np.arange(8)
        theta = around(np.concatenate([lines + TWO_PI * turn for turn in range(-11, 12)]))
        states = np.stack([theta, np.full(len(theta), 0.3)], axis=-1)
        found = cells.cells(states, PENDULUM)
        boxes = [cells.constraint(k) for k in range(len(cells))]
        inside = np.stack([box.contains(states, PENDULUM) for box in boxes], axis=1)
        np.testing.assert_array_equal(inside.sum(axis=1), 1)
        np.testing.assert_array_equal(inside.argmax(axis=1), found)
        within = np.abs(theta) < 10 * TWO_PI
        jitted = [by_jax(lambda s, b=b: b.contains(s, PENDULUM), states[within]) for b in boxes]
        np.testing.assert_array_equal(np.stack(jitted, axis=1), inside[within])

    @pytest.mark.parametrize(
        ("box", "expected"),
        [((0.7, 1.0), [False, True, True, False]), ((-0.1, 0.7), [True, False, False, False])],
    )
    def test_an_action_on_the_edge(self, box, expected) -> None:
        for kind in (np.float64, np.float32):
            values = np.array([0.0, 0.7, 0.9, 1.0], kind)[:, None]
            forbidden = ActionBox(force=box).forbids(Actions(("force",), values))
            np.testing.assert_array_equal(forbidden, expected)
            traced = by_jax(lambda v: ActionBox(force=box).forbids(Actions(("force",), v)), values)
            np.testing.assert_array_equal(traced, expected)

    def test_an_action_of_about_zero(self) -> None:
        """The middle of a range of actions may be off by the rounding of the range."""
        values = np.array([[-1e-8], [0.0], [1e-8], [-0.1]], np.float32)
        positive = ActionBox(force=(0.0, math.inf)).forbids(Actions(("force",), values))
        np.testing.assert_array_equal(positive, [True, True, True, False])


SETS = {
    "cells": grid(x=(-3.0, 3.0, 20), y=(-4.0, 4.0, 2)),
    "cells of tenths": grid(x=(-0.3, 0.5, 8), y=(-0.3, 0.4, 7)),
    "windows": windows(x=(-0.8, 0.8, 0.8), y=(-0.9, 0.9, 0.6), overlap=2),
    "boxes": ConstraintHypotheses(
        [Box(x=(-0.3, 0.6)), Box(y=(0.1, math.inf)), Box(x=(0.3, 0.4), y=(0.2, 0.3))]
    ),
    "shapes": ConstraintHypotheses(
        [
            Ball(0.5, x=0.1, y=0.3),
            HalfSpace(0.7, x=1.0, y=-2.0),
            Polygon([(0.1, 0.2), (0.7, 0.2), (0.7, 0.8), (0.1, 0.8)]),
            Occupancy("map", np.eye(6, dtype=bool), (-0.6, -0.6), 0.2),
        ]
    ),
}
ROUND = AllWays(grid(theta=(-math.pi, math.pi, 8), omega=(-6.0, 6.0, 5)), PENDULUM)
fewer = settings(max_examples=20)  # each holds a dozen segments


class TestSegments:
    @pytest.mark.parametrize("ways", [AllWays(s, LINE) for s in SETS.values()], ids=[*SETS])
    @fewer
    @given(seed=seeds)
    def test_all_ways_agree_on_decimals(self, ways: AllWays, seed: int) -> None:
        """Through corners, along lines, at rest; with rounding from sums in either precision."""
        generator = np.random.default_rng(seed)
        tenths = generator.integers(-9, 10, (2, 12, 2))
        sums = np.where(generator.random(tenths.shape) < 0.5, tenths / 10, tenths * 0.1)
        noise = generator.choice([0.0, 1e-16, -6e-8, 6e-8], tenths.shape)
        np.testing.assert_array_equal(ways(*(sums + noise)), ways(*(tenths / 10)))

    @fewer
    @given(seed=seeds)
    def test_all_ways_agree_on_angles(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        first, change = generator.integers(-24, 25, 12), generator.integers(-3, 4, 12)
        theta = np.stack([first, first + change]) * TWO_PI / 8
        omega = generator.integers(-5, 6, (2, 12)) * 1.2
        exact = np.stack([theta, omega], axis=-1)
        noise = generator.choice([0.0, 4e-7, -4e-7], exact.shape)
        np.testing.assert_array_equal(ROUND(*(exact + noise)), ROUND(*exact))

    @pytest.mark.parametrize(
        "constraint", [s.constraint(len(s) // 2) for s in SETS.values()], ids=[*SETS]
    )
    def test_the_answer_does_not_hang_on_company(self, constraint: Constraint) -> None:
        generator = np.random.default_rng(0)
        starts, ends = generator.uniform(-1.5, 1.5, (2, 300, 2))
        ends = starts + 0.2 * (ends - starts)
        ends[0] = [60.0, -80.0]
        together = constraint.crosses(starts, ends, LINE)
        alone = [constraint.crosses(a, b, LINE) for a, b in zip(starts, ends, strict=True)]
        np.testing.assert_array_equal(together, alone)
        assert 0 < together.sum() < 300

    @pytest.mark.parametrize("noise", [1e-6, 3e-6, 1e-5, 2e-5, 1e-4])
    def test_no_path_along_a_line_of_the_map_passes_a_wall(self, noise: float) -> None:
        wall = np.zeros((10, 10), bool)
        wall[:, 5] = True
        room = Occupancy("room", wall, (-4.0, -4.0), 0.8)
        y = np.random.default_rng(1).normal(0.0, noise, (2, 2000))
        starts, ends = (
            np.stack([0 * z + x, z], axis=-1) for x, z in zip((-2, 3.9), y, strict=True)
        )
        assert room.crosses(starts, ends, LINE).all()
        traced = jax.jit(lambda a, b: room.crosses(a, b, LINE))
        assert np.asarray(traced(jnp.asarray(starts), jnp.asarray(ends))).all()

    @pytest.mark.parametrize("noise", [1e-6, 3e-6, 1e-5, 2e-5, 1e-4])
    def test_windows_along_a_line_inside_are_judged_as_boxes(self, noise: float) -> None:
        slid = windows(2, x=(-4.0, 4.0, 2.0), y=(-4.0, 4.0, 2.0))
        y = np.random.default_rng(2).normal(0.0, noise, (2, 300))
        starts, ends = (
            np.stack([0 * z + x, z], axis=-1) for x, z in zip((-3.5, 3.7), y, strict=True)
        )
        states = np.stack([starts, ends], axis=1)
        boxes = ConstraintHypotheses(slid.constraint(k) for k in range(len(slid)))
        found = slid.violations(states, LINE, True)
        np.testing.assert_array_equal(found, boxes.violations(states, LINE, True))

    def test_a_map_is_judged_as_its_blocked_cells_are(self) -> None:
        blocked = np.random.default_rng(3).random((6, 8)) < 0.2
        room = Occupancy("map", blocked, (-0.8, -0.6), 0.2)
        x, y = ((low + 0.2 * np.arange(9)).tolist() for low in (-0.8, -0.6))
        boxes = [
            Box(x=(x[j], x[j + 1]), y=(y[i], y[i + 1]))
            for i, j in zip(*np.nonzero(blocked), strict=True)
        ]
        beyond = [Box(x=(-math.inf, -0.8)), Box(x=(0.8, math.inf)), Box(y=(-math.inf, -0.6))]
        whole = Union("map", [*boxes, *beyond, Box(y=(0.6, math.inf))])
        generator = np.random.default_rng(4)
        for count in (9, 900):
            starts, ends = generator.integers(-count, count, (2, 3000, 2)) * (0.9 / count)
            ends = starts + np.round(generator.uniform(0.0, 0.5, (3000, 1)) * (ends - starts), 3)
            expected = whole.crosses(starts, ends, LINE)
            np.testing.assert_array_equal(room.crosses(starts, ends, LINE), expected)
            assert 300 < expected.sum() < 2700
