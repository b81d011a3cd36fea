"""Enumeration by blocks against the plain one of `reference`, and where the answer is a formula."""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from support.enumerations import CART_NOMINAL, FAST, answer, nominal_of
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    Cart,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)

from swerve import MDP, ActionBox, Box, Constraint, Pendulum, Problem, Task, Union, grid
from swerve.evidence.exact import ExactAnswer
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import unpack
from swerve.simulation.trajectory import take_step
from swerve.solvers.exact import enumeration
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal


def assert_agrees(problem: Problem, task: Task) -> ExactAnswer:
    """The two differ by the rounding of rewards in float32 alone."""
    exact = enumerate_exactly(problem, task.start, task.goal)
    found = answer(problem, task)
    assert found.log_partition == pytest.approx(exact.log_partition, abs=1e-5)
    probability = 1.0 - found.avoid_probability
    np.testing.assert_allclose(probability, exact.violation_probability, rtol=0.0, atol=1e-6)
    assert np.count_nonzero((probability > 0.1) & (probability < 0.9)) >= 3
    return found


@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_pendulum_agrees_with_the_reference(measure: str, between_states: bool) -> None:
    assert_agrees(short_pendulum(measure=measure, between_states=between_states), PENDULUM_TASK)


@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_early_termination_agrees_with_the_reference(measure: str, between_states: bool) -> None:
    problem = short_cart(measure=measure, between_states=between_states, beta=0.3)
    found = assert_agrees(problem, FAST)
    other = answer(dataclasses.replace(problem, measure="uniform"), FAST)
    assert (other.kept.length < 7).any()
    difference = np.abs(found.avoid_probability - other.avoid_probability).max()
    assert (difference > 0.05) == (measure == "counting")  # it would not matter without ends


@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize("wall", [Box(x=(-0.2, 0.3), v=(-0.9, 0.1)), ActionBox(force=(-0.5, 0.5))])
def test_known_constraints_agree_with_the_reference(wall: Constraint, between_states: bool) -> None:
    problem = short_cart(known=[wall], between_states=between_states)
    found = assert_agrees(problem, CART_TASK)
    free = answer(CART_NOMINAL.problem, CART_TASK)
    assert np.abs(found.avoid_probability - free.avoid_probability).max() > 0.1
    assert found.log_partition < free.log_partition - 0.1


@pytest.mark.parametrize("between_states", [True, False])
def test_hypotheses_about_actions_agree_with_the_reference(between_states: bool) -> None:
    ahead = Box(x=(1.2, 1.4))
    push = ActionBox(force=(0.5, 2.0))
    hypotheses = [push, ahead, Union("either", [push, ahead]), ActionBox(force=(-2.0, -0.5))]
    problem = Problem(Cart(num_steps=4), hypotheses, beta=0.3, between_states=between_states)
    found = assert_agrees(problem, FAST)
    assert found.avoid_probability[2] < 0.9 * found.avoid_probability[:2].min()


def test_one_step() -> None:
    mdp = Pendulum(max_torque=3.0, dt=0.4, num_steps=1)
    problem = Problem(mdp, grid(theta=(2.0, 3.0, 4), omega=(-2.0, 2.0, 12)), beta=0.02)
    found = assert_agrees(problem, PENDULUM_TASK)
    assert found.kept.states.shape == (NUM_KEPT, 2, 2)
    assert (found.kept.length == 1).all()
    started = problem.hypotheses.violations(found.kept.states[:, :1], mdp.space, True)
    assert (started & found.kept.violations == started).all()
    assert started.any()


class Coin(MDP):
    """Counts its heads; a head earns `heads`, a tail nothing."""

    heads: float = 10.0
    dt: float = 1.0
    num_steps: int = eqx.field(default=5, static=True)
    state_names = ("count",)
    action_names = ("side",)
    bounds = ((0.0, 10.0),)

    @property
    def actions(self):
        return jnp.array([[0.0], [1.0]])

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return self.heads * action[0]


COIN_CELLS = grid(count=(0.5, 5.5, 5))  # cell k is avoided by at most k heads
COIN_TASK = Task(np.zeros(1), np.zeros(1))


@pytest.mark.parametrize("product", [12, 1 << 17])
def test_what_is_hardly_ever_avoided_has_its_probability_to_the_last_digits(
    product: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(enumeration, "PRODUCT", product)
    tail = -math.log1p(math.exp(10.0))
    heads = 10.0 + tail
    exact = [math.exp(5 * tail)]
    for k in range(1, 5):
        exact.append(exact[-1] + math.comb(5, k) * math.exp(k * heads + (5 - k) * tail))
    assert exact[0] < 1e-21
    found = answer(Problem(Coin(), COIN_CELLS), COIN_TASK)
    np.testing.assert_allclose(found.avoid_probability, exact, rtol=1e-12)


def test_log_partition_reaches_where_probabilities_do_not() -> None:
    problem = Problem(Coin(heads=400.0), COIN_CELLS)
    assert answer(problem, COIN_TASK).avoid_probability[0] == 0.0
    both = [400.0 * k + math.log(math.comb(5, k)) - 5.0 * math.log(2.0) for k in range(6)]
    exact = [np.logaddexp.reduce(both[: k + 1]) for k in range(6)]
    found = nominal_of(problem).log_partition(COIN_TASK, [[k] for k in range(5)] + [[]])
    np.testing.assert_allclose(found, exact, rtol=1e-12)


@pytest.mark.parametrize(("measure", "log_count"), [("uniform", 0.0), ("counting", math.log(32))])
def test_without_rewards_trajectories_are_counted(measure: str, log_count: float) -> None:
    found = answer(Problem(Coin(), COIN_CELLS, beta=1e-15, measure=measure), COIN_TASK)
    assert found.log_partition == pytest.approx(log_count, abs=1e-12)
    shares = np.cumsum([math.comb(5, k) for k in range(5)]) / 32
    np.testing.assert_allclose(found.avoid_probability, shares, rtol=1e-12)


def test_what_is_never_entered_is_avoided_exactly() -> None:
    problem = Problem(Coin(), grid(count=(5.5, 9.5, 4)), beta=0.3)
    assert (answer(problem, COIN_TASK).avoid_probability == 1.0).all()


@pytest.mark.parametrize(
    ("name", "value"), [("BLOCK", 1), ("BLOCK", 30), ("BLOCK_BYTES", 30_000), ("PRODUCT", 1000)]
)
def test_the_size_of_blocks_does_not_matter(
    name: str, value: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = short_cart(beta=0.3)
    sets = [[3], [3, 10], [10, 12, 15], []]
    shares: list[list[float]] = []
    answers, log_partitions = [], []
    for size in (getattr(enumeration, name), value):
        monkeypatch.setattr(enumeration, name, size)
        shares.append([])
        nominal = nominal_of(problem)
        answers.append(nominal.answer(FAST, np.random.default_rng(0), shares[-1].append))
        log_partitions.append(nominal.log_partition(FAST, sets))
    assert answers[1].log_partition == pytest.approx(answers[0].log_partition, abs=1e-6)
    np.testing.assert_allclose(
        answers[1].avoid_probability, answers[0].avoid_probability, rtol=1e-6
    )
    np.testing.assert_allclose(log_partitions[1], log_partitions[0], atol=1e-6)
    if name != "PRODUCT":
        assert len(shares[1]) > 3 * len(shares[0])
    for share in shares:
        assert min(share) >= 0.0
        assert sum(share) == pytest.approx(1.0, abs=1e-9)


def test_depth_comes_before_breadth_so_that_few_paths_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enumeration, "BLOCK", 2)  # one node at a time
    shares: list[float] = []
    nominal = nominal_of(Problem(Coin(), COIN_CELLS))
    nominal.answer(COIN_TASK, np.random.default_rng(0), shares.append)
    assert len(shares) == 31  # nodes of the tree
    assert shares[:6] == [0.0, 0.0, 0.0, 0.0, 1 / 16, 1 / 16]


def test_little_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    traced = []

    def counted(*arguments):
        traced.append(arguments)
        return take_step(*arguments)

    monkeypatch.setattr(enumeration, "take_step", counted)
    monkeypatch.setattr(enumeration, "BLOCK", 3000)
    answer(Problem(Cart(num_steps=9), grid(x=(-1.0, 1.0, 4))), CART_TASK)
    assert len(traced) == 2  # batches of 512 and of 4096, for 769, 916 and 1000 nodes


def test_single_hypotheses_have_the_same_log_partition_as_the_answer() -> None:
    problem = short_cart(measure="counting")
    nominal, found = nominal_of(problem), answer(problem, CART_TASK)
    single = nominal.log_partition(CART_TASK, [[k] for k in range(len(problem.hypotheses))])
    np.testing.assert_allclose(
        np.exp(single - found.log_partition), found.avoid_probability, rtol=1e-10
    )
    none, twice = nominal.log_partition(CART_TASK, [[], [10, 10]])
    assert none == pytest.approx(found.log_partition, abs=1e-10)
    assert twice == single[10]


@pytest.mark.parametrize("between_states", [True, False])
def test_a_set_is_the_same_as_a_known_constraint_and_one_more(between_states: bool) -> None:
    problem = short_cart(between_states=between_states)
    of_a, of_b, of_both = nominal_of(problem).log_partition(CART_TASK, [[5], [4], [5, 4]])
    known = [problem.hypotheses.constraint(5)]
    walled = nominal_of(dataclasses.replace(problem, known=known))
    np.testing.assert_allclose(
        walled.log_partition(CART_TASK, [[], [4], [5]]), [of_a, of_both, of_a], atol=1e-6
    )
    free = nominal_of(problem).log_partition(CART_TASK, [[]])[0]
    assert abs(of_a + of_b - free - of_both) > 0.01  # it does not follow from the two alone


@hypothesis_settings(max_examples=20)
@given(st.lists(st.integers(0, 23), max_size=6), st.integers(0, 23))
def test_one_more_constraint_never_raises_the_partition_function(some: list[int], one: int) -> None:
    fewer, more = CART_NOMINAL.log_partition(CART_TASK, [some, [*some, one]])
    assert more <= fewer


def test_nothing_avoids_a_set() -> None:
    problem = Problem(Cart(), [ActionBox(force=(-2.0, 0.5)), ActionBox(force=(-0.5, 2.0))])
    found = nominal_of(problem).log_partition(CART_TASK, [[0], [0, 1]])
    assert math.isfinite(found[0])
    assert found[1] == -math.inf


def test_answers_among_those_that_avoid_a_set() -> None:
    """As with one of them known and the other asked for; draws avoid them too."""
    problem = short_cart()
    nominal = Enumeration().learn(problem)
    chosen = [int(h) for h in np.argsort(np.abs(_violated(nominal) - 0.4))[:2]]
    found = nominal.answer(CART_TASK, np.random.default_rng(0), avoiding=chosen)
    masses = nominal.log_partition(
        CART_TASK, [chosen, *([*chosen, h] for h in range(len(problem.hypotheses)))]
    )
    assert found.log_partition == pytest.approx(masses[0], abs=1e-9)
    np.testing.assert_allclose(found.avoid_probability, np.exp(masses[1:] - masses[0]), rtol=1e-9)
    bits = unpack(found.kept.violations, len(problem.hypotheses))
    assert not bits[:, chosen].any()
    assert bits.any()


def _violated(nominal: EnumerationNominal) -> np.ndarray:
    return 1.0 - nominal.answer(CART_TASK, np.random.default_rng(0)).avoid_probability
