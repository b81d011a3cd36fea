"""Which trajectories enter which cells: properties that hold for all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cells import (
    PENDULUM,
    PLANE,
    angle_ranges,
    as_list,
    both_settings,
    corners_cut,
    entered,
    fewer,
    refined,
    walks,
)

from swerve.base.space import TWO_PI
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid

seeds = st.integers(0, 2**32 - 1)


class TestViolations:
    @angle_ranges
    @both_settings
    @fewer
    @given(seed=seeds, turns=st.integers(-4, 4))
    def test_whole_turns_change_nothing(self, theta, between_states, seed, turns) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(generator)
        turned = states.copy()
        turned[..., 0] += TWO_PI * generator.integers(-2, 3, states.shape[:2]) + TWO_PI * turns
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, between_states),
            cells.violations(turned, PENDULUM, between_states),
        )

    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_points_inserted_on_segments_change_nothing(self, theta, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(generator)
        finer = refined(states, generator, PENDULUM)
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, True), cells.violations(finer, PENDULUM, True)
        )

    @fewer
    @given(seed=seeds)
    def test_inserted_points_add_violations_where_states_alone_are_judged(self, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(generator)
        coarse = entered(cells, states, PENDULUM, False)
        finer = entered(cells, refined(states, generator, PENDULUM), PENDULUM, False)
        between = entered(cells, states, PENDULUM, True)
        assert not (coarse & ~finer).any()
        assert not (finer & ~between).any()

    @angle_ranges
    @fewer
    @given(seed=seeds)
    def test_segments_only_add_to_states(self, theta, seed) -> None:
        cells = grid(theta=theta, omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        alone, between = (entered(cells, states, PENDULUM, flag) for flag in (False, True))
        assert not (alone & ~between).any()
        found = cells.cells(states, PENDULUM)
        for row in range(len(states)):
            assert set(np.flatnonzero(alone[row])) == set(found[row][found[row] >= 0])

    @both_settings
    @fewer
    @given(seed=seeds)
    def test_direction_does_not_matter(self, between_states, seed) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(seed))
        np.testing.assert_array_equal(
            cells.violations(states, PENDULUM, between_states),
            cells.violations(states[:, ::-1], PENDULUM, between_states),
        )

    @both_settings
    def test_each_trajectory_is_judged_alone(self, between_states: bool) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), omega=(-4.0, 4.5, 7))
        states = walks(np.random.default_rng(3), num=40)
        together = cells.violations(states, PENDULUM, between_states)
        alone = [cells.violations(states[k : k + 1], PENDULUM, between_states) for k in range(40)]
        np.testing.assert_array_equal(together, np.concatenate(alone))

    @fewer
    @given(seed=seeds)
    def test_a_segment_enters_one_cell_more_than_it_crosses_lines(self, seed) -> None:
        generator = np.random.default_rng(seed)
        cells = grid(x=(-4.0, 4.0, 16), y=(-4.0, 4.0, 10))
        states = generator.uniform(-4.0, 4.0, (50, 2, 2))
        lines = np.abs(np.diff(np.floor((states + 4.0) / [0.5, 0.8]), axis=1)).sum(axis=(1, 2))
        hits = entered(cells, states, PLANE, True).sum(axis=1)
        assert (hits <= 1 + lines).all()
        assert (hits >= 1 + lines - corners_cut(states, [0.5, 0.8])).all()

    def test_cells_of_single_segments(self) -> None:
        cells = grid(x=(0.0, 4.0, 4), y=(0.0, 3.0, 3))
        paths = {
            ((0.5, 0.5), (3.5, 0.5)): {0, 3, 6, 9},
            ((0.5, 0.5), (0.5, 2.5)): {0, 1, 2},
            ((0.5, 0.2), (2.5, 2.1)): {0, 3, 4, 7, 8},
            ((-5.0, 1.5), (9.0, 1.5)): {1, 4, 7, 10},
            ((-5.0, 1.5), (-1.0, 9.0)): set(),
            ((2.5, -1.0), (2.5, 0.5)): {6},
        }
        for ends, expected in paths.items():
            hits = entered(cells, np.array([ends]), PLANE, True)[0]
            assert set(np.flatnonzero(hits)) == expected, ends

    def test_the_shorter_arc_is_taken(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 8))
        states = np.array([[[0.1, 0.0], [TWO_PI - 0.9, 0.0]], [[3.0, 0.0], [3.5 - TWO_PI, 0.0]]])
        hits = entered(cells, states, PENDULUM, True)
        assert [set(np.flatnonzero(row)) for row in hits] == [{0, 7, 6}, {3, 4}]

    @pytest.mark.parametrize("kind", [np.float32, np.float64])
    def test_a_tenth_is_on_its_line_in_either_precision(self, kind) -> None:
        """In float32 0.7 lies below 0.7, and in float64 0.30000000000000004 above 0.3."""
        cells = grid(x=(0.0, 1.0, 10))
        for k in range(10):
            states = np.full((1, 2, 2), k / 10, kind)
            for hypotheses in (cells, as_list(cells)):
                hits = entered(hypotheses, states, PLANE, True)[0]
                assert set(np.flatnonzero(hits)) == {k}

    def test_a_million_cells(self) -> None:
        """Each trajectory enters few of them, and exactly those that its states or segments do."""
        cells = grid(x=(-4.0, 4.0, 1000), y=(-4.0, 4.0, 1000))
        assert len(cells) == 10**6
        generator = np.random.default_rng(0)
        states = generator.uniform(-4.0, 4.0, (4, 3, 2))
        index = np.floor((states + 4.0) / 0.008).astype(int)
        alone = cells.violations(states, PLANE, False)
        assert alone.shape == (4, 125_000)
        for row, found in zip(unpack(alone, 10**6), index, strict=True):
            expected = np.unique(np.ravel_multi_index(tuple(found.T), (1000, 1000)))
            np.testing.assert_array_equal(np.flatnonzero(row), expected)
        between = unpack(cells.violations(states[:, :2], PLANE, True), 10**6)
        lines = np.abs(np.diff(index[:, :2], axis=1)).sum(axis=(1, 2))
        assert (between.sum(axis=1) <= 1 + lines).all()
        cut = corners_cut(states[:, :2], [0.008, 0.008])
        assert (between.sum(axis=1) >= 1 + lines - cut).all()
        assert (cut < 10).all()
        dense = states[:, :1] + np.linspace(0, 1, 20_001)[:, None] * (
            states[:, 1:2] - states[:, :1]
        )
        for row, found in zip(between, cells.cells(dense, PLANE), strict=True):
            assert set(found) <= set(np.flatnonzero(row))
            assert len(set(found)) > 0.95 * row.sum()

    def test_a_long_way_through_a_million_cells(self) -> None:
        cells = grid(x=(-4.0, 4.0, 1000), y=(-4.0, 4.0, 1000))
        across = np.array([[[-9.0, 0.004], [9.0, 0.004]]])
        hits = np.flatnonzero(entered(cells, across, PLANE, True)[0])
        np.testing.assert_array_equal(hits, 500 + 1000 * np.arange(1000))
