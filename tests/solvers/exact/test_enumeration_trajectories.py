"""Trajectories that enumeration samples, and its evidence, stored and restored."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.enumerations import CART_NOMINAL, FAST, STANDARD_ERRORS, answer, nominal_of
from support.reference import CART_TASK, Cart, short_cart

from swerve import ActionBox, Problem, learn, load_nominal, sample, save_nominal
from swerve.base.space import Actions
from swerve.evidence.exact import ExactNominal
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import unpack
from swerve.simulation.trajectory import take_step
from swerve.solvers.base import Solver
from swerve.solvers.exact import enumeration
from swerve.solvers.exact.enumeration import Enumeration


def test_trajectories_are_drawn_from_the_nominal_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(enumeration, "BLOCK", 150)
    problem = short_cart(beta=0.3)
    nominal = nominal_of(problem)
    answers = [
        nominal.answer(FAST, np.random.default_rng(seed), lambda share: None) for seed in range(25)
    ]
    bits = np.concatenate([found.kept.violations for found in answers])
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
    drawn = answer(problem, FAST).kept
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
    first, again, other = (answer(CART_NOMINAL.problem, FAST, seed).kept for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.states, again.states)
    assert not np.array_equal(first.states, other.states)


def test_what_was_stored_is_restored() -> None:
    assert CART_NOMINAL.arrays() == {}
    restored = Enumeration(max_sequences=3000).restore(CART_NOMINAL.problem, {})
    assert restored.log_partition(FAST, [[]]) == CART_NOMINAL.log_partition(FAST, [[]])


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
