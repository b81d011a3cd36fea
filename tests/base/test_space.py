from __future__ import annotations

import json
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.space import TWO_PI, StateSpace, Task, Transitions

PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
angles = st.floats(-50.0, 50.0)
speeds = st.floats(-100.0, 100.0)
states = st.tuples(angles, speeds).map(np.array)


class TestDifference:
    @given(a=states, b=states)
    def test_takes_the_shorter_arc_to_the_same_direction(self, a, b) -> None:
        arc, change = PENDULUM.difference(a, b)
        assert abs(arc) <= math.pi + 1e-12
        assert math.cos(a[0] + arc) == pytest.approx(math.cos(b[0]), abs=1e-9)
        assert math.sin(a[0] + arc) == pytest.approx(math.sin(b[0]), abs=1e-9)
        assert change == b[1] - a[1]

    @given(a=states, b=states, turns=st.tuples(st.integers(-5, 5), st.integers(-5, 5)))
    def test_whole_turns_change_nothing(self, a, b, turns) -> None:
        turned_a, turned_b = (
            x + np.array([TWO_PI * k, 0.0]) for x, k in zip((a, b), turns, strict=True)
        )
        arc, turned = PENDULUM.difference(a, b)[0], PENDULUM.difference(turned_a, turned_b)[0]
        # half a turn may come out with either sign
        assert math.remainder(arc - turned, TWO_PI) == pytest.approx(0.0, abs=1e-12)

    def test_exact_values_on_batches(self) -> None:
        starts = np.array([[0.1, 1.0], [6.0, 1.0], [1.0, -2.0]])
        ends = np.array([[6.2, 4.0], [0.2, 0.5], [2.5, -2.0]])
        expected = [[6.1 - TWO_PI, 3.0], [0.2 - 6.0 + TWO_PI, -0.5], [1.5, 0.0]]
        np.testing.assert_allclose(PENDULUM.difference(starts, ends), expected, atol=1e-12)
        np.testing.assert_allclose(
            PENDULUM.difference(starts[None, :2], ends[None, :2]), [expected[:2]], atol=1e-12
        )

    def test_only_angles_wrap(self) -> None:
        line = StateSpace(("x",), (), np.array([[0.0, 100.0]]))
        assert line.difference(np.array([0.0]), np.array([50.0])) == 50.0

    def test_jax_arrays_give_the_same(self) -> None:
        generator = np.random.default_rng(0)
        a, b = generator.uniform(-9.0, 9.0, (2, 100, 2))
        by_jax = PENDULUM.difference(jnp.asarray(a), jnp.asarray(b))
        assert isinstance(by_jax, jnp.ndarray)
        np.testing.assert_allclose(by_jax, PENDULUM.difference(a, b), atol=1e-5)


class TestRelativeDistance:
    def test_is_the_largest_difference_in_units_of_the_extent(self) -> None:
        a = np.array([[0.1, 0.0], [1.0, 3.0], [0.1, 0.0]])
        b = np.array([[TWO_PI - 0.1, 0.0], [1.1, -3.0], [0.1, 0.0]])
        expected = [0.2 / TWO_PI, 0.5, 0.0]
        np.testing.assert_allclose(PENDULUM.relative_distance(a, b), expected, atol=1e-12)

    @given(a=states, b=states)
    def test_is_symmetric(self, a, b) -> None:
        there, back = PENDULUM.relative_distance(a, b), PENDULUM.relative_distance(b, a)
        assert there == pytest.approx(back, abs=1e-12)


class TestStateSpace:
    def test_extent_and_angles(self) -> None:
        np.testing.assert_allclose(PENDULUM.extent, [TWO_PI, 12.0])
        np.testing.assert_array_equal(PENDULUM.is_angle, [True, False])

    def test_column_is_the_index_of_a_name(self) -> None:
        assert [PENDULUM.column(name) for name in PENDULUM.names] == [0, 1]

    def test_unknown_names_are_refused_with_those_there_are(self) -> None:
        with pytest.raises(ValueError, match="no state named 'speed'; the states are theta, omega"):
            PENDULUM.column("speed")
        with pytest.raises(ValueError, match="no state named 'phi'; the states are x"):
            StateSpace(("x",), ("phi",), np.array([[0.0, 1.0]]))

    @pytest.mark.parametrize(
        ("names", "message"),
        [
            (("x", "x"), r"got 'x' more than once in \('x', 'x'\)"),
            (("x", "v", "x", "w", "v"), "got 'x', 'v' more than once in"),
        ],
    )
    def test_a_name_for_two_states_is_refused(self, names: tuple[str, ...], message: str) -> None:
        bounds = np.tile([0.0, 1.0], (len(names), 1))
        with pytest.raises(ValueError, match=f"a name of its own for each state, {message}"):
            StateSpace(names, (), bounds)

    @pytest.mark.parametrize(
        ("bounds", "shape"),
        [([[0.0, 1.0]], r"\(1, 2\)"), ([0.0, 1.0], r"\(2,\)"), ([[0.0], [1.0]], r"\(2, 1\)")],
    )
    def test_bounds_of_another_shape_are_refused(self, bounds: Any, shape: str) -> None:
        message = rf"bounds: expected shape \(2, 2\), .*\('x', 'y'\), got {shape}"
        with pytest.raises(ValueError, match=message):
            StateSpace(("x", "y"), (), np.array(bounds))

    @pytest.mark.parametrize("row", [[1.0, 1.0], [1.0, 0.0], [0.0, math.inf], [math.nan, 1.0]])
    def test_bounds_that_are_empty_or_infinite_are_refused(self, row: list[float]) -> None:
        with pytest.raises(ValueError, match="bounds: expected finite low < high in every row"):
            StateSpace(("x", "y"), (), np.array([[0.0, 1.0], row]))

    def test_json_round_trip(self) -> None:
        back = StateSpace.from_json(json.loads(json.dumps(PENDULUM.to_json(), allow_nan=False)))
        assert (back.names, back.angles) == (PENDULUM.names, PENDULUM.angles)
        np.testing.assert_array_equal(back.bounds, PENDULUM.bounds)
        assert back.to_json() == PENDULUM.to_json()


class TestTask:
    def test_stack_adds_a_leading_axis(self) -> None:
        batch = Task.stack([Task([0, 1], [2.0]), Task([3, 4], [5.0]), Task([6, 7], [8.0])])
        np.testing.assert_array_equal(batch.start, [[0.0, 1.0], [3.0, 4.0], [6.0, 7.0]])
        np.testing.assert_array_equal(batch.goal, [[2.0], [5.0], [8.0]])
        assert batch.start.dtype == np.float64

    def test_an_empty_list_is_refused(self) -> None:
        with pytest.raises(ValueError, match="at least one task, got an empty list"):
            Task.stack([])


class TestTransitions:
    def test_states_that_nobody_can_be_in(self) -> None:
        """On 3 x 2 points: a way along the lower row, whose last state offers nothing."""
        successors = np.array([[1, -1], [2, 0], [-1, -1], [-1, -1], [-1, -1], [4, -1]])
        transitions = Transitions((3, 2), successors, np.array([[1.0], [-1.0]]))
        np.testing.assert_array_equal(transitions.isolated, [[0.0, 1.0]])
