"""Predicates: what they contain and cross, and which functions are refused."""

from __future__ import annotations

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.base import violates
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate

PLANE = StateSpace(("x", "y"), (), np.array([[-4.0, 4.0], [-4.0, 4.0]]))
PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))


def in_disc(states: Any) -> Any:
    return (states**2).sum(axis=-1) < 1.0


class TestPredicate:
    def test_contains_what_the_function_says(self) -> None:
        disc = Predicate("disc", in_disc)
        states = np.array([[[0.0, 0.0], [2.0, 0.0]], [[0.6, 0.6], [1.0, 0.0]]])
        np.testing.assert_array_equal(disc.contains(states, PLANE), [[True, False], [True, False]])
        assert disc.name == "disc"

    def test_repr_says_what_was_given_without_addresses(self) -> None:
        assert repr(Predicate("disc", in_disc)) == "Predicate('disc', in_disc, num_points=8)"
        bound = functools.partial(in_disc)
        assert repr(Predicate("a b", bound, 3)) == "Predicate('a b', partial, num_points=3)"

    def test_crosses_tries_evenly_spaced_points(self) -> None:
        start, end = np.array([-4.0, 0.0]), np.array([4.0, 0.0])
        assert Predicate("disc", in_disc).crosses(start, end, PLANE)  # one point in 8 is the middle
        assert not Predicate("disc", in_disc, num_points=1).crosses(start, end, PLANE)
        assert not Predicate("disc", in_disc, num_points=3).crosses(start, end, PLANE)
        assert Predicate("disc", in_disc, num_points=1).crosses(end, np.zeros(2), PLANE)
        assert Predicate("disc", in_disc, num_points=1).crosses(np.zeros(2), end, PLANE)

    def test_points_follow_the_shorter_arc(self) -> None:
        low = Predicate("zero", lambda states: np.cos(states[..., 0]) > 0.99)
        start, end = np.array([0.5, 0.0]), np.array([TWO_PI - 0.5, 0.0])
        assert low.crosses(start, end, PENDULUM)
        assert not low.crosses(start, np.array([math.pi, 0.0]), PENDULUM)

    def test_agrees_with_the_box_it_describes(self) -> None:
        generator = np.random.default_rng(0)
        states = generator.uniform(-2.0, 2.0, (200, 9, 2))
        box = Box(x=(0.0, 1.0))
        strip = Predicate("strip", lambda s: (s[..., 0] >= 0.0) & (s[..., 0] < 1.0), 50)
        np.testing.assert_array_equal(
            violates(strip, states, PLANE, False), violates(box, states, PLANE, False)
        )
        fine, exact = (violates(c, states[:, :2], PLANE, True) for c in (strip, box))
        assert not (fine & ~exact).any()
        assert (fine == exact).mean() > 0.95

    @pytest.mark.parametrize(
        ("function", "got"),
        [
            (lambda states: states > 0, r"bool of shape \(5, 2\)"),
            (lambda states: states[..., 0], r"float32 of shape \(5,\)"),
            (lambda states: True, "bool of shape None"),
        ],
    )
    def test_a_function_that_gives_no_boolean_a_state(self, function: Any, got: str) -> None:
        message = rf"Predicate 'both': expected one boolean a state, shape \(5,\), got {got}"
        with pytest.raises(ValueError, match=message):
            Predicate("both", function).contains(np.zeros((5, 2)), PLANE)

    def test_a_function_that_cannot_be_traced_is_told_by_its_line(self) -> None:
        for function, advice in (
            (lambda states: states[..., 0] > 0.0 or states[..., 1] > 0.0, "jnp.where, not if"),
            (lambda states: np.sin(states[..., 0]) > 0.0, "jax.numpy, not NumPy"),
        ):
            disc, line = Predicate("disc", function), function.__code__.co_firstlineno
            message = (
                f"^Predicate 'disc': .* JAX can trace.*predicate.py, line {line}: use {advice}"
            )
            with pytest.raises(ValueError, match=message):
                jax.eval_shape(lambda states, disc=disc: disc.contains(states, PLANE), jnp.ones(2))
        with pytest.raises(ValueError, match=r"^Predicate 'or': .* use jnp.where, not if"):
            Predicate("or", lambda s: s[..., 0] > 0.0 or False).contains(np.zeros((5, 2)), PLANE)

    def test_no_points_are_refused(self) -> None:
        with pytest.raises(ValueError, match=r"Predicate 'disc': num_points: .* >= 1, got 0"):
            Predicate("disc", in_disc, 0)
