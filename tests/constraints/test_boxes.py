"""Boxes of states and of actions: what they contain, what crosses them, their names."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.exact_boxes import meets_exactly

from swerve.base.space import TWO_PI, Actions, StateSpace
from swerve.constraints.base import violates
from swerve.constraints.boxes import ActionBox, Box

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
seeds = st.integers(0, 2**32 - 1)
eighths = st.integers(-32, 32).map(lambda k: k / 8)
points = st.tuples(eighths, eighths)
intervals = st.tuples(st.integers(-24, 20), st.integers(1, 12)).map(
    lambda pair: (pair[0] / 8, (pair[0] + pair[1]) / 8)
)


def grown(box: Box, margins: dict[str, float], space: StateSpace) -> Box:
    """A box wider by a margin on either side, at most a full turn for angles."""
    wider = {}
    for name, (low, high) in box.intervals.items():
        margin = margins[name]
        if name in space.angles:
            margin = min(margin, 0.5 * (TWO_PI - (high - low)))
        wider[name] = (low - margin, high + margin)
    return Box(**wider)


class TestContains:
    @given(point=points, x=intervals, y=intervals)
    def test_is_half_open(self, point, x, y) -> None:
        inside = x[0] <= point[0] < x[1] and y[0] <= point[1] < y[1]
        assert Box(x=x, y=y).contains(np.array(point), PLANE) == inside

    def test_unnamed_components_are_free(self) -> None:
        states = np.array([[0.5, -1e9], [0.5, 1e9], [1.0, 0.0]])
        np.testing.assert_array_equal(Box(x=(0, 1)).contains(states, PLANE), [True, True, False])

    def test_keeps_the_shape_of_a_batch(self) -> None:
        states = np.zeros((2, 3, 4, 2))
        states[1, 2, 3] = 5.0
        inside = Box(y=(0.0, 1.0)).contains(states, PLANE)
        assert inside.shape == (2, 3, 4)
        assert inside.sum() == 23
        assert not inside[1, 2, 3]

    @given(seed=seeds, turns=st.integers(-4, 4), shift=st.integers(-4, 4))
    def test_whole_turns_of_state_or_interval_change_nothing(self, seed, turns, shift) -> None:
        generator = np.random.default_rng(seed)
        low, width = generator.uniform(0.0, TWO_PI), generator.uniform(0.1, TWO_PI)
        states = np.stack([generator.uniform(-20, 20, 50), generator.uniform(-6, 6, 50)], axis=-1)
        box = Box(theta=(low, low + width))
        moved = Box(theta=(low + TWO_PI * shift, low + width + TWO_PI * shift))
        np.testing.assert_array_equal(
            box.contains(states, PENDULUM),
            moved.contains(states + np.array([TWO_PI * turns, 0.0]), PENDULUM),
        )

    def test_angle_intervals_wrap(self) -> None:
        box = Box(theta=(-0.5, 0.5))
        theta = np.array([0.0, 0.49, 0.5, 3.0, TWO_PI - 0.5, TWO_PI - 0.51, -0.4, 7 * TWO_PI + 0.4])
        states = np.stack([theta, np.zeros(8)], axis=-1)
        expected = [True, True, False, False, True, False, True, True]
        np.testing.assert_array_equal(box.contains(states, PENDULUM), expected)

    def test_open_sides(self) -> None:
        box = Box(x=(-math.inf, 0.0), y=(1.0, math.inf))
        states = np.array([[-1e300, 1e300], [0.0, 2.0], [-1.0, 1.0], [-1.0, 0.9]])
        np.testing.assert_array_equal(box.contains(states, PLANE), [True, False, True, False])


class TestCrosses:
    @given(start=points, end=points, x=intervals, y=intervals)
    def test_agrees_with_exact_arithmetic(self, start, end, x, y) -> None:
        """On eighths everything is exact: touched corners and edges are judged exactly."""
        crossed = Box(x=x, y=y).crosses(np.array(start), np.array(end), PLANE)
        assert crossed == meets_exactly(start, end, [x, y])

    @given(start=points, end=points, y=intervals)
    def test_a_free_component_does_not_matter(self, start, end, y) -> None:
        crossed = Box(y=y).crosses(np.array(start), np.array(end), PLANE)
        assert crossed == meets_exactly(start[1:], end[1:], [y])

    @given(seed=seeds)
    def test_agrees_with_dense_sampling_across_the_wrap(self, seed) -> None:
        generator = np.random.default_rng(seed)
        low = generator.uniform(-10.0, 10.0)
        box = Box(
            theta=(low, low + generator.uniform(0.2, 6.2)),
            omega=tuple(np.sort(generator.uniform(-4.0, 4.0, 2))),
        )
        starts, ends = (
            np.stack([generator.uniform(-9, 9, 60), generator.uniform(-5, 5, 60)], axis=-1)
            for _ in range(2)
        )
        steps = PENDULUM.difference(starts, ends)
        num = 400
        dense = starts + steps * np.linspace(0.0, 1.0, num + 1)[:, None, None]
        crossed = box.crosses(starts, ends, PENDULUM)
        assert not (box.contains(dense, PENDULUM).any(axis=0) & ~crossed).any()
        spacing = np.abs(steps).max(axis=0) / num
        wider = grown(box, {"theta": spacing[0], "omega": spacing[1]}, PENDULUM)
        assert not (crossed & ~wider.contains(dense, PENDULUM).any(axis=0)).any()

    @given(seed=seeds)
    def test_direction_does_not_matter(self, seed) -> None:
        generator = np.random.default_rng(seed)
        box = Box(theta=(1.0, 2.5), omega=(-1.0, 1.0))
        starts, ends = generator.uniform(-6.0, 6.0, (2, 100, 2))
        there = box.crosses(starts, ends, PENDULUM)
        np.testing.assert_array_equal(there, box.crosses(ends, starts, PENDULUM))
        assert there.any()
        assert not there.all()

    def test_passes_through_without_a_state_inside(self) -> None:
        box = Box(x=(0.0, 1.0), y=(0.0, 1.0))
        start, end = np.array([-1.0, 0.5]), np.array([2.0, 0.5])
        assert box.crosses(start, end, PLANE)
        assert not box.contains(np.stack([start, end]), PLANE).any()
        assert not box.crosses(np.array([-1.0, 1.5]), np.array([2.0, 1.5]), PLANE)

    def test_touching_from_outside_is_not_crossing(self) -> None:
        """A corner met by the way, or an edge of the open side that is followed."""
        box = Box(x=(0.0, 1.0), y=(0.0, 1.0))
        ways = {
            "through the corner below": ((-0.5, 0.5), (0.5, -0.5), False),
            "through the corner above": ((0.5, 1.5), (1.5, 0.5), False),
            "ends in the corner below": ((-0.5, 0.5), (0.0, 0.0), True),
            "ends in the corner above": ((0.5, 1.5), (1.0, 1.0), False),
            "along the closed edge": ((-1.0, 0.0), (2.0, 0.0), True),
            "along the open edge": ((-1.0, 1.0), (2.0, 1.0), False),
            "along the diagonal": ((-1.0, -1.0), (2.0, 2.0), True),
            "up to the open edge": ((2.0, 0.5), (1.0, 0.5), False),
            "up to the closed edge": ((-1.0, 0.5), (0.0, 0.5), True),
        }
        for name, (start, end, expected) in ways.items():
            assert meets_exactly(start, end, [(0, 1), (0, 1)]) == expected, name
            assert box.crosses(np.array(start), np.array(end), PLANE) == expected, name

    def test_follows_the_shorter_arc(self) -> None:
        box = Box(theta=(1.0, 2.0))
        start, end = np.array([0.5, 0.0]), np.array([6.0, 0.0])
        assert not box.crosses(start, end, PENDULUM)
        assert Box(theta=(6.1, 6.2)).crosses(start, end, PENDULUM)
        assert box.crosses(start, np.array([2.5, 0.0]), PENDULUM)
        assert box.crosses(start + TWO_PI, np.array([2.5 - TWO_PI, 0.0]), PENDULUM)

    def test_resting_is_the_same_as_containing(self) -> None:
        box = Box(theta=(1.0, 2.0), omega=(-1.0, 1.0))
        states = np.array([[1.0, -1.0], [2.0, 0.0], [1.5, 1.0], [1.5, 0.5], [1.5 + TWO_PI, 0.0]])
        np.testing.assert_array_equal(
            box.crosses(states, states, PENDULUM), box.contains(states, PENDULUM)
        )

    def test_open_sides(self) -> None:
        box = Box(x=(1.0, math.inf))
        starts = np.array([[0.0, 0.0], [0.0, 0.0], [5.0, 0.0], [0.0, 1.0], [2.0, 1.0]])
        ends = np.array([[0.5, 0.0], [3.0, 0.0], [9.0, 0.0], [0.0, 2.0], [2.0, 3.0]])
        np.testing.assert_array_equal(
            box.crosses(starts, ends, PLANE), [False, True, True, False, True]
        )

    @pytest.mark.parametrize("between_states", [True, False])
    def test_jax_judges_like_numpy(self, between_states: bool) -> None:
        """Eighths and a whole-numbered interval are exact in float32 too."""
        generator = np.random.default_rng(0)
        box = Box(x=(-1.0, 2.0), y=(0.0, 1.5))
        starts, ends = generator.integers(-32, 33, (2, 4000, 2)) / 8
        if between_states:
            by_numpy = box.crosses(starts, ends, PLANE)
            traced = jax.jit(jax.vmap(lambda a, b: box.crosses(a, b, PLANE)))
            by_jax = traced(jnp.asarray(starts), jnp.asarray(ends))
        else:
            by_numpy = box.contains(starts, PLANE)
            by_jax = jax.jit(jax.vmap(lambda a: box.contains(a, PLANE)))(jnp.asarray(starts))
        np.testing.assert_array_equal(by_jax, by_numpy)
        assert 0.05 < by_numpy.mean() < 0.95

    def test_jax_judges_angles_like_numpy(self) -> None:
        generator = np.random.default_rng(1)
        box = Box(theta=(5.5, 7.0), omega=(-1.0, 1.5))
        starts, ends = generator.uniform(-8.0, 8.0, (2, 4000, 2)).astype(np.float32)
        traced = jax.jit(jax.vmap(lambda a, b: box.crosses(a, b, PENDULUM)))
        by_jax = np.asarray(traced(jnp.asarray(starts), jnp.asarray(ends)))
        margins = {"theta": 1e-5, "omega": 1e-5}
        starts, ends = starts.astype(float), ends.astype(float)
        sure = box.crosses(starts, ends, PENDULUM) == grown(box, margins, PENDULUM).crosses(
            starts, ends, PENDULUM
        )
        assert sure.mean() > 0.99
        np.testing.assert_array_equal(by_jax[sure], box.crosses(starts, ends, PENDULUM)[sure])
        assert 0.05 < by_jax.mean() < 0.95


class TestBox:
    def test_name(self) -> None:
        box = Box(theta=(math.pi, 1.2 * math.pi), omega=(0.0, 1.2))
        assert box.name == "theta [3.14, 3.77), omega [0, 1.2)"
        assert Box(x=(-math.inf, -0.0)).name == "x [-inf, 0)"

    @given(x=st.floats(), width=st.floats(), y=intervals)
    def test_its_repr_makes_it_again(self, x, width, y) -> None:
        assume(x < x + width)
        box = Box(y=y, x=(x, x + width))
        back = eval(repr(box), {"Box": Box})  # noqa: S307
        assert list(back.intervals.items()) == list(box.intervals.items())

    def test_repr(self) -> None:
        box = Box(theta=(3.14, 3.77), omega=(0, 1.2))
        assert repr(box) == "Box(theta=(3.14, 3.77), omega=(0.0, 1.2))"
        assert repr(Box(x=(-math.inf, 0.0))) == "Box(x=(float('-inf'), 0.0))"
        assert repr(Box(**{"x [m]": (0, 1), "y": (0, 2)})) == (
            "Box(**{'x [m]': (0.0, 1.0), 'y': (0.0, 2.0)})"
        )
        assert repr(Box(**{"lambda": (0, 1)})) == "Box(**{'lambda': (0.0, 1.0)})"

    def test_no_interval_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"at least one interval, as in Box\(x=\(0.0, 1.0\)\)"):
            Box()

    @pytest.mark.parametrize("interval", [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.nan)])
    def test_empty_intervals_are_refused(self, interval: tuple[float, float]) -> None:
        with pytest.raises(ValueError, match=r"Box: expected low < high for 'x', got \("):
            Box(y=(0, 1), x=interval)

    def test_check_refuses_unknown_names(self) -> None:
        with pytest.raises(ValueError, match="no state named 'z'; the states are x, y"):
            Box(z=(0, 1)).check(PLANE, ())

    def test_check_refuses_more_than_a_turn(self) -> None:
        Box(theta=(1.0, 1.0 + TWO_PI), omega=(0.0, 100.0)).check(PENDULUM, ())
        message = r"Box: 'theta' is an angle, .* 2 pi at most, .* a width of 6\.5 rad"
        with pytest.raises(ValueError, match=message):
            Box(theta=(0.0, 6.5)).check(PENDULUM, ())
        with pytest.raises(ValueError, match="a width of inf rad"):
            Box(theta=(0.0, math.inf)).check(PENDULUM, ())


class TestActionBox:
    def test_forbids_actions_and_no_states(self) -> None:
        box = ActionBox(fx=(0.5, 2.0), fy=(-math.inf, 0.0))
        values = np.array([[1.0, -1.0], [1.0, 0.0], [0.4, -1.0], [2.0, -1.0], [np.nan, -1.0]])
        expected = [True, False, False, False, False]
        np.testing.assert_array_equal(box.forbids(Actions(("fx", "fy"), values)), expected)
        swapped = Actions(("fy", "fx"), values[:, ::-1])
        np.testing.assert_array_equal(box.forbids(swapped), expected)
        assert not box.contains(np.zeros((3, 2)), PLANE).any()
        assert not box.crosses(np.zeros((3, 2)), np.ones((3, 2)), PLANE).any()
        assert not Box(x=(0, 1)).forbids(Actions(("fx",), np.zeros((3, 1)))).any()

    def test_a_trajectory_violates_it_by_any_action(self) -> None:
        states = np.zeros((2, 4, 2))
        values = np.array([[[0.0], [1.0], [0.0]], [[0.0], [0.0], [np.nan]]])
        for between in (True, False):
            hit = violates(ActionBox(f=(0.5, 2.0)), states, PLANE, between, Actions(("f",), values))
            np.testing.assert_array_equal(hit, [True, False])

    def test_works_under_jax(self) -> None:
        box, values = ActionBox(f=(0.5, 2.0)), jnp.array([[1.0], [0.0]])
        found = jax.jit(lambda values: box.forbids(Actions(("f",), values)))(values)
        np.testing.assert_array_equal(found, [True, False])

    def test_names(self) -> None:
        box = ActionBox(force=(0.5, 2.0))
        assert box.name == "action force [0.5, 2)"
        assert repr(box) == "ActionBox(force=(0.5, 2.0))"
        box.check(PLANE, ("force", "spin"))
        with pytest.raises(ValueError, match="no action component 'force'; there are spin, f"):
            box.check(PLANE, ("spin", "f"))
        with pytest.raises(ValueError, match="ActionBox: expected low < high for 'f'"):
            ActionBox(f=(1.0, 1.0))


def test_the_whole_circle_contains_every_angle() -> None:
    box = Box(theta=(0.0, TWO_PI))
    tiny = np.array([0.0, -0.0, -1e-300, -1e-17, -1e-16, 1e-17, TWO_PI, -TWO_PI])
    assert box.contains(np.stack([tiny, tiny], axis=-1), PENDULUM).all()
    tiny = jnp.array([0.0, -1e-8, -1e-7, -1e-9])
    assert box.contains(jnp.stack([tiny, tiny], axis=-1), PENDULUM).all()


def test_a_number_in_the_place_of_an_interval() -> None:
    with pytest.raises(ValueError, match=r"Box: expected x=\(low, high\), got 3"):
        Box(x=3)  # pyright: ignore[reportArgumentType]
