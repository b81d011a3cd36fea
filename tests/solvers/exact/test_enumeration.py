"""Enumeration by blocks against the plain one of `reference`, and where the answer is a formula."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    Cart,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)

from swerve import (
    MDP,
    ActionBox,
    Box,
    Constraint,
    Pendulum,
    Problem,
    Task,
    Union,
    grid,
    learn,
    load_nominal,
    sample,
    save_nominal,
)
from swerve.base.space import Actions
from swerve.evidence.exact import ExactAnswer, ExactNominal
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import unpack
from swerve.simulation.trajectory import take_step
from swerve.solvers.exact import enumeration
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal
from swerve.solvers.learn import Solver

STANDARD_ERRORS = 4.5
FAST = Task(np.array([0.9, 0.6]), np.array([-0.5, 0.0]))  # a third of the time off the track


def nominal_of(problem: Problem) -> EnumerationNominal:
    nominal = learn(problem, Enumeration())
    assert isinstance(nominal, EnumerationNominal)
    return nominal


def answer(problem: Problem, task: Task, seed: int = 0) -> ExactAnswer:
    return nominal_of(problem).answer(task, np.random.default_rng(seed), lambda share: None)


CART_NOMINAL = nominal_of(short_cart())  # for all tests, so that its steps are compiled once


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
    assert (other.drawn.length < 7).any()
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
    assert found.drawn.states.shape == (NUM_KEPT, 2, 2)
    assert (found.drawn.length == 1).all()
    started = problem.hypotheses.violations(found.drawn.states[:, :1], mdp.space, True)
    assert (started & found.drawn.violations == started).all()
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


def test_trajectories_are_drawn_from_the_nominal_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(enumeration, "BLOCK", 150)
    problem = short_cart(beta=0.3)
    nominal = nominal_of(problem)
    answers = [
        nominal.answer(FAST, np.random.default_rng(seed), lambda share: None) for seed in range(25)
    ]
    bits = np.concatenate([found.drawn.violations for found in answers])
    entered = unpack(bits, len(problem.hypotheses))
    assert len(entered) == 25 * NUM_KEPT
    exact = 1.0 - answers[0].avoid_probability
    error = np.sqrt(exact * (1.0 - exact) / len(entered))
    tried = (exact > 0.02) & (exact < 0.98)
    assert np.count_nonzero(tried) >= 10
    difference = entered.mean(axis=0) - exact
    assert np.abs(difference[tried] / error[tried]).max() < STANDARD_ERRORS


@pytest.mark.parametrize("between_states", [True, False])
def test_what_is_said_of_a_drawn_trajectory_is_so(between_states: bool) -> None:
    push = ActionBox(force=(0.5, 2.0))
    cells = [short_cart().hypotheses.constraint(k) for k in range(24)]
    problem = Problem(Cart(), [*cells, push], beta=0.3, between_states=between_states)
    drawn = answer(problem, FAST).drawn
    mdp, goal = problem.mdp, jnp.asarray(FAST.goal)
    force = np.round(np.diff(drawn.states[..., 1], axis=1) / mdp.dt).astype(int)
    after_end = np.arange(mdp.num_steps) >= drawn.length[:, None]
    assert (force[after_end] == 0).all()
    assert (np.diff(drawn.states[..., 0], axis=1)[after_end] == 0.0).all()
    values = np.where(after_end, np.nan, force)[..., None]
    actions = Actions(mdp.action_names, values)
    bits = problem.hypotheses.violations(drawn.states, mdp.space, between_states, actions)
    np.testing.assert_array_equal(bits, drawn.violations)
    for k in range(0, NUM_KEPT, 20):
        total, state = 0.0, jnp.asarray(drawn.states[k, 0])
        for step in range(drawn.length[k]):
            taken = take_step(problem, state, force[k, step] + 1, step, goal)
            total, state = total + float(taken.reward), taken.state
            np.testing.assert_allclose(drawn.states[k, step + 1], state, atol=1e-5)
            assert bool(taken.ended) == (step == drawn.length[k] - 1)
        assert drawn.total_reward[k] == pytest.approx(total, abs=1e-5)


def test_evidence_is_exact() -> None:
    problem = short_cart(measure="counting", beta=0.3)
    nominal = nominal_of(problem)
    assert isinstance(nominal, ExactNominal)
    assert isinstance(nominal.solver, Solver)
    evidence = sample(nominal, FAST, seed=3)
    found = answer(problem, FAST)
    assert evidence.is_exact
    assert evidence.log_partition[0] == found.log_partition
    np.testing.assert_array_equal(evidence.summary.avoid_probability[0], found.avoid_probability)
    np.testing.assert_allclose(evidence.importance_log_weight, found.log_partition, rtol=1e-12)
    assert evidence.solver == "Enumeration(max_sequences=50000000)"


def test_the_same_seed_draws_the_same_trajectories() -> None:
    first, again, other = (answer(CART_NOMINAL.problem, FAST, seed).drawn for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.states, again.states)
    assert not np.array_equal(first.states, other.states)


def test_what_was_stored_is_restored() -> None:
    assert CART_NOMINAL.arrays() == {}
    restored = Enumeration(max_sequences=3000).restore(CART_NOMINAL.problem, {})
    assert restored.log_partition(FAST, [[]]) == CART_NOMINAL.log_partition(FAST, [[]])


def test_a_reward_of_minus_infinity_is_a_step_not_allowed() -> None:
    wall = Box(x=(-0.2, 0.3))

    class Fenced(Cart):
        def reward(self, state, action, next_state, goal):
            inside = wall.contains(next_state, self.space)
            return jnp.where(inside, -jnp.inf, Cart.reward(self, state, action, next_state, goal))

    settings = {"beta": 0.3, "between_states": False}
    cells = short_cart().hypotheses
    fenced = answer(Problem(Fenced(), cells, **settings), CART_TASK)
    walled = answer(Problem(Cart(), cells, known=[wall], **settings), CART_TASK)
    assert fenced.log_partition == pytest.approx(walled.log_partition, abs=1e-6)
    np.testing.assert_allclose(fenced.avoid_probability, walled.avoid_probability, atol=1e-7)


def test_nothing_is_allowed() -> None:
    problem = short_cart(known=[ActionBox(force=(-2.0, 2.0))])
    found = answer(problem, CART_TASK)
    assert found.log_partition == -math.inf
    assert np.isnan(found.avoid_probability).all()
    assert found.drawn.states.shape == (0, 8, 2)
    assert found.drawn.violations.shape == (0, 3)
    assert nominal_of(problem).log_partition(CART_TASK, [[]])[0] == -math.inf
    with pytest.raises(ValueError, match=r"no trajectory is allowed, log Z_0 = -inf"):
        sample(nominal_of(problem), CART_TASK)


def test_too_many_sequences_are_refused_with_their_number() -> None:
    problem = short_pendulum()
    assert Enumeration(max_sequences=5**6).check(problem) is None
    with pytest.raises(
        ValueError,
        match=r"would go through 5\^6 = 15,625 action sequences, at most 15,624 are allowed "
        r"\(max_sequences\): shorten num_steps, or use solver 'grid'",
    ):
        learn(problem, Enumeration(max_sequences=5**6 - 1))
    cells = problem.hypotheses
    with pytest.raises(ValueError, match=r"5\^300 = 10\^210 action .* at most 50,000,000 are"):
        learn(Problem(Pendulum(), cells), Enumeration())
    with pytest.raises(ValueError, match=r"5\^30 = 10\^21 .* at most 9,223,372,036,854,775,807"):
        learn(Problem(Pendulum(num_steps=30), cells), Enumeration(max_sequences=2**63 - 1))
    with pytest.raises(ValueError, match=r"5\^1000000000 = 10\^698970004 action sequences"):
        learn(Problem(Pendulum(num_steps=10**9), cells), Enumeration())


def test_another_solver_is_named_that_takes_the_dimensions() -> None:
    class Wide(Cart):
        state_names = ("x", "v", "y", "z")
        bounds = ((-1.0, 1.0),) * 4

        def dynamics(self, state, action):
            return state

    with pytest.raises(ValueError, match=r"3\^7 = 2,187 .* or use solver 'soft-value'"):
        learn(Problem(Wide(), grid(x=(-1.0, 1.0, 2))), Enumeration(max_sequences=100))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0, r"Enumeration: max_sequences: expected a whole number >= 1, got 0"),
        (1e6, r"Enumeration: max_sequences: expected a whole number >= 1, got 1000000\.0"),
        (2**63, r"max_sequences: expected at most 9,223,372,036,854,775,807, got 9,223.*808"),
    ],
)
def test_max_sequences_is_checked(value: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Enumeration(max_sequences=value)


@pytest.mark.parametrize(
    ("avoiding", "message"),
    [
        ([[0], [24]], r"avoiding\[1\]: expected indices from 0 to 23, got 24"),
        ([[-1]], r"avoiding\[0\]: expected a whole number >= 0, got -1"),
        ([[0.0]], r"avoiding\[0\]: expected a whole number >= 0, got 0\.0"),
        ([3, 4], r"avoiding\[0\]: expected a list of hypotheses, .* got 3"),
    ],
)
def test_sets_of_hypotheses_are_checked(avoiding: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CART_NOMINAL.log_partition(CART_TASK, avoiding)


def test_the_task_of_log_partition_is_checked() -> None:
    with pytest.raises(ValueError, match="task: expected a single one, got 2"):
        CART_NOMINAL.log_partition(Task.stack([CART_TASK, FAST]), [[0]])
    with pytest.raises(ValueError, match=r"expected a start of 2 numbers \(x, v\), got 1"):
        CART_NOMINAL.log_partition(Task(np.zeros(1), np.zeros(1)), [[0]])


class Broken(Cart):
    """The cart with one method that goes wrong where x > 1.1."""

    method: str = eqx.field(default="reward", static=True)
    value: float = math.nan

    def _spoilt(self, method, x, right):
        return jnp.where((x > 1.1) & (self.method == method), self.value, right)

    def dynamics(self, state, action):
        state = Cart.dynamics(self, state, action)
        return self._spoilt("dynamics", state[0], state)

    def reward(self, state, action, next_state, goal):
        right = Cart.reward(self, state, action, next_state, goal)
        return self._spoilt("reward", next_state[0], right)

    def terminal_reward(self, state, goal):
        return self._spoilt("terminal_reward", state[0], Cart.terminal_reward(self, state, goal))


@pytest.mark.parametrize(
    ("method", "value", "found"),
    [
        ("dynamics", math.nan, "[nan, nan]"),
        ("dynamics", math.inf, "[inf, inf]"),
        ("reward", math.nan, "nan"),
        ("reward", math.inf, "inf"),
        ("terminal_reward", math.nan, "nan"),
        ("terminal_reward", math.inf, "inf"),
    ],
)
def test_what_is_no_number_is_named(method: str, value: float, found: str) -> None:
    forward = ActionBox(force=(-2.0, -0.5))
    problem = Problem(Broken(method=method, value=value), grid(x=(-1.0, 1.0, 2)), known=[forward])
    state = r"\[1\.0, 0\.8\d*\]" if method == "terminal_reward" else r"\[0\.75\d*, 0\.3\d*\]"
    message = rf"Broken\.{method} returned {re.escape(found)} at step 1 from state {state} by "
    message += r"action \[1\.0\]"
    message += {
        "dynamics": r": expected finite numbers",
        "reward": r": expected a finite number, or -inf for what is not allowed",
        "terminal_reward": r" to state \[1\.6\d*, 1\.\d*\]: expected a finite number, or -inf",
    }[method]
    with pytest.raises(ValueError, match=message):
        answer(problem, CART_TASK)


def test_what_is_no_number_does_not_matter_where_it_is_forbidden() -> None:
    wall = Box(x=(1.1, 9.0))
    cells = short_cart().hypotheses
    broken, right = (
        answer(Problem(mdp, cells, known=[wall]), CART_TASK) for mdp in (Broken(), Cart())
    )
    assert broken.log_partition == pytest.approx(right.log_partition, abs=1e-6)


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
    bits = unpack(found.drawn.violations, len(problem.hypotheses))
    assert not bits[:, chosen].any()
    assert bits.any()


def _violated(nominal: EnumerationNominal) -> np.ndarray:
    return 1.0 - nominal.answer(CART_TASK, np.random.default_rng(0)).avoid_probability


def test_it_is_stored_as_its_settings(tmp_path: Path) -> None:
    problem = short_cart()
    nominal = learn(problem, "enumeration?max_sequences=3000")
    save_nominal(tmp_path / "a.nominal", nominal)
    back = load_nominal(tmp_path / "a.nominal", problem)
    assert back.solver == Enumeration(max_sequences=3000)
    first, second = (sample(item, CART_TASK) for item in (nominal, back))
    np.testing.assert_array_equal(first.violation_probability, second.violation_probability)
    with pytest.raises(ValueError, match=r"3\^7 = 2,187 action sequences, at most 2,000"):
        learn(problem, "enumeration?max_sequences=2000")
