from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from support.synthetic import SPACE, make_record

from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.stored import constraint_from_json
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import grid
from swerve.presentation.plane import Path, Plane, plane_of, runs

FLAT = StateSpace(("x", "y", "v"), (), np.array([[0.0, 10.0], [-5.0, 5.0], [-1.0, 3.0]]))
TORUS = StateSpace(("a", "b"), ("a", "b"), np.array([[0.0, TWO_PI], [-np.pi, np.pi]]))
seeds = st.integers(0, 2**32 - 1)


def plane(hypotheses: HypothesisSet, *states: ArrayLike, space: StateSpace = SPACE) -> Plane:
    record = make_record(space=space, hypotheses=hypotheses)
    return plane_of(record, [Path(np.array(s, float), None) for s in states])


def covered(rectangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points [P, 2] lie in at least one rectangle."""
    x, y = points[:, None, 0], points[:, None, 1]
    x0, x1, y0, y1 = rectangles.T
    return ((x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)).any(axis=1)


class TestPlaneOf:
    def test_the_first_two_states_of_the_hypotheses_are_drawn(self) -> None:
        cells = grid(v=(-1.0, 3.0, 2), x=(0.0, 10.0, 3), y=(-5.0, 5.0, 4))
        assert plane(cells, space=FLAT).names == ("v", "x")

    def test_one_state_is_drawn_against_time(self) -> None:
        drawn = plane(grid(v=(-1.0, 3.0, 2)), np.zeros((4, 3)), space=FLAT)
        assert drawn.labels == ("share of the trajectory", "v")
        np.testing.assert_array_equal(drawn.limits, [[0, 1], [-1, 3]])

    def test_time_is_in_seconds_from_the_start_if_all_paths_have_times(self) -> None:
        record = make_record(space=FLAT, hypotheses=grid(v=(-1.0, 3.0, 2)))
        with_times = Path(np.zeros((3, 3)), np.array([10.0, 11.0, 14.0]))
        drawn = plane_of(record, [with_times])
        assert drawn.labels[0] == "time [s]"
        np.testing.assert_array_equal(drawn.line(with_times)[:, 0], [0.0, 1.0, 4.0])
        assert drawn.limits[0, 1] >= 4.0
        without = plane_of(record, [with_times, Path(np.zeros((3, 3)), None)])
        assert without.labels[0] == "share of the trajectory"

    def test_predicates_are_drawn_over_the_first_two_states(self) -> None:
        nowhere = ConstraintHypotheses([Predicate("nowhere", lambda s: s[..., 0] > 99)])
        drawn = plane(nowhere, space=FLAT)
        assert drawn.names == ("x", "y")
        np.testing.assert_array_equal(drawn.limits, FLAT.bounds[:2])
        mixed = [Box(v=(0.0, 1.0)), Predicate("nowhere", lambda s: s[..., 0] > 99)]
        assert plane(ConstraintHypotheses(mixed), space=FLAT).names == ("v", "x")

    def test_only_angles_have_a_unit(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 4), x=(0.0, 9.0, 3))
        assert plane(cells).labels == ("theta [rad]", "x")

    def test_paths_that_leave_the_hypotheses_fit_in(self) -> None:
        cells = grid(x=(2.0, 4.0, 2), y=(0.0, 1.0, 2))
        low, high = plane(cells, [[-3.0, 0.5, 0], [3.0, 4.0, 0]], space=FLAT).limits.T
        assert (low <= [-3.0, 0.0]).all()
        assert (high >= [4.0, 4.0]).all()
        np.testing.assert_allclose([low[1], high[0]], [0.0, 4.0])

    def test_open_sides_and_far_boxes_end_at_the_bounds(self) -> None:
        boxes = [Box(x=(2.0, np.inf), y=(-1e6, 0.0)), Box(x=(1.0, 3.0))]
        np.testing.assert_array_equal(
            plane(ConstraintHypotheses(boxes), space=FLAT).limits, [[1, 10], [-5, 0]]
        )

    def test_an_axis_that_nearly_reaches_a_bound_ends_there(self) -> None:
        boxes = ConstraintHypotheses([Box(x=(0.45, 3.0), y=(-2.0, 4.5)), Box(x=(7.0, 9.85))])
        np.testing.assert_array_equal(plane(boxes, space=FLAT).limits, [[0, 10], [-2, 5]])
        cells = grid(x=(0.45, 9.85, 2), y=(0.0, 1.0, 2))
        np.testing.assert_array_equal(plane(cells, space=FLAT).limits[0], [0.45, 9.85])

    def test_the_turn_of_an_angle_begins_where_its_cells_do(self) -> None:
        drawn = plane(grid(theta=(-2.0, TWO_PI - 2.0, 4), x=(0.0, 9.0, 3)))
        np.testing.assert_allclose(drawn.limits[0], [-2.0, TWO_PI - 2.0])

    def test_part_of_a_turn_is_enough_where_nothing_else_is_to_be_seen(self) -> None:
        drawn = plane(grid(theta=(1.0, 2.0, 4), x=(0.0, 9.0, 3)), [[1.5, 1.0], [2.5, 1.0]])
        low, high = drawn.limits[0]
        np.testing.assert_allclose(low, 1.0)
        assert 2.5 <= high < 2.7

    @pytest.mark.parametrize(("y", "is_map"), [((-5.0, 5.0), True), ((0.0, 1.0), False)])
    def test_positions_are_a_map_unless_it_would_be_a_slit(self, y, is_map) -> None:
        cells = grid(x=(0.0, 10.0, 3), y=(*y, 4))
        assert plane(cells, space=FLAT).is_map is is_map
        assert not plane(grid(x=(0.0, 10.0, 3), v=(-1.0, 3.0, 4)), space=FLAT).is_map


class TestPieces:
    @given(seed=seeds, num=st.integers(2, 60))
    @settings(max_examples=60)
    def test_never_jump_and_show_every_point_where_it_belongs(self, seed, num) -> None:
        generator = np.random.default_rng(seed)
        walk = generator.uniform(-9, 9, 2) + generator.uniform(-1.4, 1.4, (num, 2)).cumsum(axis=0)
        cells = grid(a=(0.0, TWO_PI, 4), b=(-np.pi, np.pi, 4))
        wrapped = walk - TWO_PI * generator.integers(-2, 3, walk.shape)  # as a file may hold it
        drawn = plane(cells, wrapped, space=TORUS)
        pieces = drawn.pieces(Path(wrapped, None))
        steps = np.diff(pieces, axis=0)
        assert (np.abs(steps[np.isfinite(steps)]) <= 1.4 + 1e-9).all()
        low, high = drawn.limits.T
        shown = pieces[np.isfinite(pieces).all(axis=1)]
        shown = shown[((shown >= low - 1e-9) & (shown <= high + 1e-9)).all(axis=1)]
        expected = drawn.wrapped(walk)
        distance = np.abs(expected[:, None] - shown).max(axis=2).min(axis=1)
        np.testing.assert_allclose(distance, 0.0, atol=1e-6)

    def test_reach_both_edges_where_an_angle_wraps(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 4), x=(0.0, 9.0, 3))
        states = np.array([[5.9, 1.0], [6.2, 2.0], [0.2, 3.0], [0.5, 4.0]])
        before, after = np.split(plane(cells, states).pieces(Path(states, None)), [4])
        assert np.nanmax(before[:, 0]) > TWO_PI
        assert np.nanmin(after[:, 0]) < 0
        np.testing.assert_allclose(before[:3, 0], [5.9, 6.2, TWO_PI + 0.2])
        assert np.isnan(after[0]).all()


class TestRectangles:
    @given(seed=seeds)
    @settings(max_examples=60)
    def test_of_a_box_are_the_states_it_contains(self, seed) -> None:
        generator = np.random.default_rng(seed)
        low, width = generator.uniform(-9, 9, 2), generator.uniform(0.1, 6.0, 2)
        box = Box(a=(low[0], low[0] + width[0]), b=(low[1], low[1] + width[1]))
        cells = grid(a=(0.0, TWO_PI, 4), b=(-np.pi, np.pi, 4))
        points = generator.uniform([0, -np.pi], [TWO_PI, np.pi], (300, 2))
        away = points[:, None] - [low, low + width]  # a picture knows nothing of the resolution
        away = np.abs(away - TWO_PI * np.round(away / TWO_PI)).min(axis=(1, 2))
        points = points[away > 1e-4]
        shown = plane(cells, space=TORUS).rectangles(box)
        np.testing.assert_array_equal(covered(shown, points), box.contains(points, TORUS))

    def test_of_every_cell_are_one_each(self) -> None:
        cells = grid(a=(-0.3, TWO_PI - 0.3, 7), b=(1.1, 1.1 + TWO_PI, 9))
        drawn = plane(cells, space=TORUS)
        for index in range(len(cells)):
            rectangle = drawn.rectangles(cells.constraint(index))
            expected = [side for interval in cells.constraint(index).intervals.values()
                        for side in interval]  # fmt: skip
            np.testing.assert_allclose(rectangle, [expected], atol=1e-9)

    def test_free_and_open_sides_fill_the_picture(self) -> None:
        drawn = plane(grid(x=(0.0, 10.0, 3), y=(-5.0, 5.0, 4)), space=FLAT)
        np.testing.assert_array_equal(drawn.rectangles(Box(x=(2.0, 3.0))), [[2, 3, -5, 5]])
        open_box = Box(x=(2.0, np.inf), v=(0.0, 1.0))
        np.testing.assert_array_equal(drawn.rectangles(open_box), [[2, 10, -5, 5]])

    def test_there_are_none_of_what_the_plane_cannot_show(self) -> None:
        drawn = plane(grid(x=(0.0, 10.0, 3), y=(-5.0, 5.0, 4)), space=FLAT)
        lost = constraint_from_json({"kind": "predicate", "name": "lost", "num_points": 8})
        for constraint in (Box(v=(0.0, 1.0)), Box(x=(20.0, 21.0)), lost):
            assert drawn.rectangles(constraint).shape == (0, 4)

    def test_of_a_predicate_cover_it(self) -> None:
        drawn = plane(grid(x=(0.0, 10.0, 3), y=(-5.0, 5.0, 4)), space=FLAT)
        disc = Predicate("disc", lambda s: (s[..., 0] - 4) ** 2 + s[..., 1] ** 2 < 9 * s[..., 2])
        shown = drawn.rectangles(disc)
        area = ((shown[:, 1] - shown[:, 0]) * (shown[:, 3] - shown[:, 2])).sum()
        np.testing.assert_allclose(area, 9 * np.pi, rtol=0.01)  # v in the middle of its bounds: 1

    @given(mask=st.lists(st.lists(st.booleans(), min_size=3, max_size=3), min_size=1, max_size=5))
    def test_runs_cover_a_mask_and_nothing_else(self, mask) -> None:
        x, y = np.array([0.0, 1.0, 3.0, 4.0]), np.arange(len(mask) + 1.0)
        middles = np.stack(np.meshgrid((x[1:] + x[:-1]) / 2, y[:-1] + 0.5), axis=-1)
        shown = runs(np.array(mask), x, y)
        np.testing.assert_array_equal(covered(shown, middles.reshape(-1, 2)), np.ravel(mask))


class TestPlace:
    def test_is_inside_beside_the_constraint_and_off_what_is_busy(self) -> None:
        drawn = plane(grid(x=(0.0, 10.0, 3), y=(-5.0, 5.0, 4)), space=FLAT)
        shown, label = np.array([[4.0, 5.0, -1.0, 0.0]]), np.array([0.1, 0.05])
        place, end = drawn.place(shown, np.zeros((0, 2)), label)
        assert ((place >= label) & (place <= 1 - label)).all()
        assert (np.abs(place - [0.45, 0.45]) >= 0.05 + label).any()
        assert np.isclose(np.abs(end - [0.45, 0.45]), 0.05).any()
        other, _ = drawn.place(shown, np.array([place * 10 + [0, -5]]), label)
        assert not np.allclose(other, place)
