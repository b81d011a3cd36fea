"""Code that does not give the same answer twice is refused when a problem is made."""

from __future__ import annotations

import dataclasses
import itertools
import random
import time
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer
from support.small_mdps import Bare, Height

import swerve
from swerve import Box, Predicate, Problem, Union, grid
from swerve.problem import repeatable
from swerve.problem.repeatable import check_repeatable

CELLS = grid(speed=(-1.0, 3.0, 4))
counter = itertools.count(1)
generator = np.random.default_rng(0)


class Counting(Bare):
    """Its dynamics depend on how often they were called."""

    def dynamics(self, state, action):
        return state + 0.001 * next(counter)


class Drawing(Bare):
    """Its dynamics depend on a random number, which vanishes at the centre of the bounds."""

    def dynamics(self, state, action):
        return state + 0.01 * generator.normal() * (state - jnp.array([jnp.pi, 1.0]))


class Paying(Bare):
    """Its reward is random."""

    def reward(self, state, action, next_state, goal):
        return -random.random() * jnp.sum(action)


class Ending(Bare):
    """Its episodes end at random."""

    def terminated(self, state, goal):
        return jnp.sum(state) > random.choice([-1e9, 1e9])


class Clock(Bare):
    """Its terminal reward depends on the time of day."""

    def terminal_reward(self, state, goal):
        return jnp.sum(state) - float(time.perf_counter_ns() % 1_000_000_007)


class Featuring(Bare):
    """The inputs of its networks depend on how often they were asked for."""

    def features(self, state, step, goal):
        return super().features(state, step, goal) + 0.001 * next(counter)


class Tracing(Bare):
    """Its dynamics are others while JAX traces them: each time others."""

    def dynamics(self, state, action):
        try:
            float(state[0])
        except Exception:
            return state + next(counter)
        return state + action


class Jitted(Bare):
    """Its dynamics draw a little noise inside a function that JAX compiles."""

    def dynamics(self, state, action):
        return jax.jit(lambda x: x + 1e-6 * generator.normal(size=2))(state + action)


class Two(Bare):
    """Its dynamics are others, always the same, while JAX traces them."""

    def dynamics(self, state, action):
        try:
            float(state[0])
        except Exception:
            return state + 2.0 * action
        return state + action


@pytest.mark.parametrize(
    ("mdp", "text"),
    [
        (Counting(), "Counting.dynamics: called twice with the same arguments, it returned"),
        (Drawing(), "Drawing.dynamics: called twice with the same arguments, it returned"),
        (Paying(), "Paying.reward: called twice with the same arguments, it returned"),
        (Ending(), "Ending.terminated: "),
        (Clock(), "Clock.terminal_reward: called twice with the same arguments, it returned"),
        (Featuring(), "Featuring.features: called twice with the same arguments, it returned"),
        (Tracing(), "Tracing.dynamics: traced twice by JAX, it gave two different programs"),
        (Jitted(), "Jitted.dynamics: called twice with the same arguments, it returned"),
        (Two(), r"Two.dynamics: it returned \[.*\], and traced by JAX \["),
    ],
)
def test_methods_that_depend_on_more_than_their_arguments(mdp: Bare, text: str) -> None:
    random.seed(3)
    remedy = ".*expected a function of its arguments alone. Take counters, random numbers"
    with pytest.raises(ValueError, match=text + remedy):
        Problem(mdp, CELLS)


class Table(Bare):
    """Its dynamics keep a table that they made at the first call, and start anew from a seed."""

    def dynamics(self, state, action):
        if not hasattr(Table, "known"):
            Table.known = np.random.default_rng(0).normal(size=2)  # pyright: ignore
        noise = np.random.default_rng(1).normal(size=2)
        return state + action + Table.known + jnp.asarray(noise, jnp.float32)  # pyright: ignore


def test_code_that_is_the_same_each_time_is_taken() -> None:
    for mdp in (Bare(), Height(), Table()):
        Problem(mdp, grid(**{mdp.state_names[1]: (-0.5, 0.5, 2)}))


@pytest.mark.parametrize(
    "system", [swerve.Pendulum, swerve.Car, swerve.DoublePendulum, swerve.Gridworld, swerve.Walker]
)
def test_systems_of_swerve_are_the_same_each_time(system: type, monkeypatch) -> None:
    """Problems are not held up by this check of them, which is made here alone."""
    monkeypatch.setattr(repeatable, "OWN", "nothing")
    monkeypatch.setattr(repeatable, "_CHECKED", WeakKeyDictionary())
    mdp = system()
    check_repeatable(mdp, "")
    assert list(repeatable._CHECKED) == [system]


KEY = jax.random.key(1)


class Keyed(Bare):
    """Its dynamics use a key of JAX from outside, and one of its own."""

    own: jax.Array = dataclasses.field(default_factory=lambda: KEY)

    def dynamics(self, state, action):
        noise = jax.random.normal(KEY, (2,)) + jax.random.normal(self.own, (2,))
        return state + action + 0.01 * jax.jit(lambda x: x + jax.random.normal(KEY))(noise)


class Rekeyed(Bare):
    """Its dynamics use a new key each time."""

    def dynamics(self, state, action):
        return state + action + 0.01 * jax.random.normal(jax.random.key(next(counter)), (2,))


class Chosen(Bare):
    """Its dynamics use a new key each time, which was made outside."""

    keys = tuple(jax.random.key(seed) for seed in range(20))

    def dynamics(self, state, action):
        return state + 1e-6 * jax.random.normal(self.keys[next(counter) % 20], (2,))


def test_keys_of_jax_are_constants_like_any_other() -> None:
    keys = [KEY, jax.random.key(1), jax.random.key(2)]
    keys += [jax.random.key(2, impl=algorithm) for algorithm in ("rbg", "unsafe_rbg")]
    digests = [Problem(Keyed(own=key), CELLS).record.mdp_digest for key in keys]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 4
    for mdp in (Rekeyed(), Chosen()):
        with pytest.raises(ValueError, match="dynamics: called twice with the same arguments"):
            Problem(mdp, CELLS)


def test_an_mdp_is_checked_once() -> None:
    calls = []

    class Called(Bare):
        def dynamics(self, state, action):
            calls.append("traced" if isinstance(state, Tracer) else "called")
            return state + action

    check_repeatable(Called(), "a")
    assert calls.count("called") == 1  # a loop is compiled anew with each call
    num = len(calls)
    check_repeatable(Called(), "a")
    assert len(calls) == num > 0
    check_repeatable(Called(push=2.0), "b")
    assert len(calls) > num


def of_chance(states):
    return states[..., 0] > random.random() * 6.0


def of_kind(states):
    return states[..., 0] > (1.0 if isinstance(states, np.ndarray) else 5.0)


def of_numpy(states):
    return np.asarray(states)[..., 0] > 1.0


@pytest.mark.parametrize("wrap", [lambda p: p, lambda p: Union("both", [p, Box(speed=(0, 1))])])
def test_predicates_that_judge_in_two_ways(wrap) -> None:
    chance, kind = wrap(Predicate("chance", of_chance)), wrap(Predicate("kind", of_kind))
    with pytest.raises(
        ValueError, match=r"hypotheses: 'chance', asked twice, judged .* of 256 states"
    ):
        Problem(Bare(), [Box(speed=(0.0, 1.0)), chance])
    with pytest.raises(ValueError, match="known: 'chance', asked twice, judged"):
        Problem(Bare(), CELLS, known=[chance])
    with pytest.raises(ValueError, match=r"'kind' judged .* as a NumPy array and as a JAX array"):
        Problem(Bare(), [kind])
    for function in (of_numpy, lambda states: states[..., 1] > 0.1):
        Problem(Bare(), [wrap(Predicate("fine", function))])
