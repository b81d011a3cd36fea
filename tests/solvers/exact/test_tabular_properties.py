"""Random tabular MDPs against a sum over all of their paths, and what holds for all of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from support.tabular_models import Model, log_mass, models, paths_of

from swerve import sample
from swerve.hypotheses.bits import unpack
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal
from swerve.solvers.exact.tabular import TableNominal, Tabular
from swerve.systems.tabular import NOWHERE

UNREACHABLE = r"task 0, from \[[0-9]\.0\] to \[\]: .*log Z_0 = -inf"


SINGLE = Model(np.array([[0, 0]]), np.array([[-1e3, -0.5]]), np.zeros(1), num_steps=3)
ONE_STEP = Model(
    np.array([[1, 2, 0], [-1, -1, -1], [0, 0, 0]]),
    np.array([[-1.0, 0.0, -2.0]] * 3),
    np.array([0.0, -1.0, -math.inf]),
    num_steps=1,
)
ABSORBED = Model(
    np.array([[0, 1, 2], [0, 0, 0], [3, 3, 0], [0, 1, 2]]),
    np.array([[-0.5, -1e3, 0.0], [0.0, 0.0, 0.0], [-1.0, -0.25, -math.inf], [-1e3, -1e3, -1.0]]),
    np.array([-math.inf, -0.5, 0.0, -1e3]),
    num_steps=4,
    absorbing=(1, 3),
    between_states=True,
)
LOST = replace(ONE_STEP, terminal=np.array([-math.inf, -1.0, -math.inf]), known=(1,))


@settings(max_examples=40, derandomize=True)
@given(models(), st.data())
def test_every_number_is_the_sum_over_paths(model: Model, data: st.DataObject) -> None:
    members = st.sets(st.integers(0, model.num_hypotheses - 1), max_size=3)
    assert_sums(model, model.nominal, data.draw(st.lists(members, max_size=4)))


@pytest.mark.parametrize("solver", [Tabular(), Enumeration()], ids=lambda solver: solver.name)
@pytest.mark.parametrize("beta", [1e-9, 1.0, 30.0])
@pytest.mark.parametrize("model", [SINGLE, ONE_STEP, ABSORBED, LOST])
def test_special_models_are_sums_over_paths(
    model: Model, beta: float, solver: Tabular | Enumeration
) -> None:
    model = replace(model, beta=beta)
    pairs = itertools.combinations(range(model.num_hypotheses), 2)
    assert_sums(model, solver.learn(model.problem), [set(pair) for pair in pairs])


def assert_sums(
    model: Model, nominal: TableNominal | EnumerationNominal, sets: Sequence[set[int]]
) -> None:
    paths = paths_of(model)
    exact = log_mass(model, paths)
    found = nominal.log_partition(model.task, [[], *(sorted(some) for some in sets)])
    expected = [exact, *(log_mass(model, paths, sorted(some)) for some in sets)]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    if exact == -math.inf:
        with pytest.raises(ValueError, match=UNREACHABLE):
            sample(nominal, model.task)
        return
    evidence = sample(nominal, model.task)
    assert evidence.log_partition[0] == pytest.approx(exact, abs=1e-12, rel=1e-12)
    singles = [log_mass(model, paths, [c]) for c in range(model.num_hypotheses)]
    np.testing.assert_allclose(
        evidence.summary.avoid_probability[0],
        np.exp(np.array(singles) - exact),
        rtol=1e-9,
        atol=1e-300,
    )


@settings(max_examples=25, derandomize=True)
@given(models())
@example(ABSORBED)
def test_constraints_take_mass_off_ever_less(model: Model) -> None:
    """1 - Z_C / Z_0 is a coverage: monotone, and with less gain from c the larger the set is."""
    assume(model.answer.log_partition > -math.inf)
    chosen = np.argsort(np.abs(model.answer.avoid_probability - 0.5))[:5].tolist()
    bits = range(len(chosen))
    sets = range(2 ** len(chosen))
    log_partition = model.log_partition(
        *([chosen[k] for k in bits if some >> k & 1] for some in sets)
    )
    covered = 1.0 - np.exp(log_partition - log_partition[0])
    for some, more in itertools.product(sets, repeat=2):
        if some & more == some:
            assert log_partition[more] <= log_partition[some]
            for c in (1 << k for k in bits):
                gains = [covered[group | c] - covered[group] for group in (some, more)]
                assert gains[1] <= gains[0] + 1e-12


@settings(max_examples=15, derandomize=True)
@given(models(), st.data())
def test_the_order_of_hypotheses_does_not_matter(model: Model, data: st.DataObject) -> None:
    order = data.draw(st.permutations(range(model.num_hypotheses)))
    other = replace(model, order=tuple(order))
    assume(model.answer.log_partition > -math.inf)
    values = model.log_partition([], order[:2])
    np.testing.assert_array_equal(other.log_partition([], [1, 0]), values)
    probability = model.answer.avoid_probability
    np.testing.assert_allclose(other.answer.avoid_probability, probability[order], atol=1e-14)


@settings(max_examples=15, derandomize=True)
@given(models(), st.data())
@example(replace(ABSORBED, between_states=False), None)
def test_the_numbers_of_states_and_actions_do_not_matter(
    model: Model, data: st.DataObject | None
) -> None:
    """Where states alone count: what lies between two states is a matter of their numbers."""
    assume(model.answer.log_partition > -math.inf)
    model = replace(model, between_states=False)
    num_states = len(model.successors)
    state_of, action_of = (
        data.draw(st.permutations(range(num))) if data else list(reversed(range(num)))
        for num in model.successors.shape
    )
    where = np.argsort(state_of)  # a state's new number
    moves = [num_states + a for a in np.argsort(action_of)]
    new_number = [*where.tolist(), *moves]
    moved = np.where(model.successors == NOWHERE, NOWHERE, where[model.successors])
    other = replace(
        model,
        successors=moved[state_of][:, action_of],
        rewards=model.rewards[state_of][:, action_of],
        terminal=model.terminal[state_of],
        absorbing=tuple(new_number[s] for s in model.absorbing),
        known=tuple(new_number[k] for k in model.known),
        start=new_number[model.start],
    )
    value, found = model.answer.log_partition, other.answer.log_partition
    assert found == pytest.approx(value, rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(
        other.answer.avoid_probability[new_number],
        model.answer.avoid_probability[:-1],
        rtol=1e-9,
        atol=1e-300,
    )


@settings(max_examples=15, derandomize=True)
@given(models(ends_early=False), st.floats(-1e3, 100.0))
@example(SINGLE, 700.0)
def test_a_constant_added_to_all_rewards_moves_only_log_partition(
    model: Model, constant: float
) -> None:
    assume(model.answer.log_partition > -math.inf)
    other = replace(model, rewards=model.rewards + constant)
    sets = [[], *([c] for c in range(model.num_hypotheses))]
    values, found = model.log_partition(*sets), other.log_partition(*sets)
    shift = model.beta * model.num_steps * constant
    np.testing.assert_allclose(found, values + shift, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(
        other.answer.avoid_probability,
        model.answer.avoid_probability,
        rtol=1e-9,
        atol=1e-300,
    )


@settings(max_examples=15, derandomize=True)
@given(models())
@example(ABSORBED)
@example(replace(ABSORBED, known=(2,), between_states=False))
def test_drawn_trajectories_are_possible(model: Model) -> None:
    """Each is one of the paths, with what it earns and enters, and stays where it ended."""
    paths = paths_of(model)
    assume(paths)
    drawn = model.answer.kept
    entered = unpack(drawn.violations, model.num_hypotheses)
    for k, length in enumerate(drawn.length):
        states = drawn.states[k, :, 0].astype(int).tolist()
        assert set(states[length:]) == {states[length]}
        assert any(
            path.states == tuple(states[: length + 1])
            and path.entered == set(np.flatnonzero(entered[k]))
            and math.isclose(path.total_reward, drawn.total_reward[k], abs_tol=1e-9)
            for path in paths
        )


@pytest.mark.parametrize("beta", [1.0, 20.0])
@pytest.mark.parametrize("num_steps", [1, 40])
def test_extreme_rewards_keep_their_digits(beta: float, num_steps: int) -> None:
    """A second action that costs 1,000 a step, and so is taken with probability exp(-1000 beta)."""
    model = Model(
        np.array([[0, 1], [0, 1]]),
        np.array([[-1e3, -2e3], [-1e3, -2e3]]),
        np.zeros(2),
        num_steps=num_steps,
        beta=beta,
    )
    evidence = sample(model.nominal, model.task)
    np.testing.assert_array_equal(evidence.violation_probability[0], [1.0, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(
        model.log_partition([], [1], [2], [0]),
        [-1e3 * num_steps * beta, -1e3 * num_steps * beta, -2e3 * num_steps * beta, -math.inf],
        rtol=1e-14,
    )
    assert (evidence.samples.total_reward == -1e3 * num_steps).all()
