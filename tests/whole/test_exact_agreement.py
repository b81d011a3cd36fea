"""Exact solvers agree with one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.cases import KNOWN, WORLD_TASK, enumerated, is_open, tabulated, world
from support.reference import enumerate_exactly
from support.routes import TASK, LatticeRoutes, Routes, routes

from swerve import sample
from swerve.systems.gridworld import MOVES

settings = pytest.mark.parametrize(
    ("measure", "between_states"),
    [("uniform", True), ("uniform", False), ("counting", True), ("counting", False)],
)


@settings
@pytest.mark.parametrize("known", [(), KNOWN], ids=["free", "known"])
def test_tables_agree_with_enumeration(known: Sequence, measure: str, between_states: bool) -> None:
    problem = world(known=known, measure=measure, between_states=between_states)
    by_table, by_sequence = (sample(f(problem), WORLD_TASK) for f in (tabulated, enumerated))
    assert by_table.log_partition[0] == pytest.approx(by_sequence.log_partition[0], abs=1e-12)
    np.testing.assert_allclose(
        by_table.summary.avoid_probability, by_sequence.summary.avoid_probability, rtol=1e-12
    )
    probability = by_table.violation_probability[0]
    moves = is_open(probability[-len(MOVES) :])
    assert np.count_nonzero(is_open(probability)) >= 8
    assert np.count_nonzero(moves) >= 2
    sets = [[0, 1], [1, 8], [5, 15], [3, 4, 17], [0, 16, 20]]
    np.testing.assert_allclose(
        tabulated(problem).log_partition(WORLD_TASK, sets),
        enumerated(problem).log_partition(WORLD_TASK, sets),
        rtol=1e-12,
    )


@pytest.mark.parametrize("between_states", [True, False])
def test_tables_agree_with_the_reference(between_states: bool) -> None:
    """With nothing of the library between the MDP and the sum but the judging of whole paths."""
    problem = world(known=KNOWN, between_states=between_states)
    exact = enumerate_exactly(problem, *WORLD_TASK)
    found = sample(tabulated(problem), WORLD_TASK)
    assert found.log_partition[0] == pytest.approx(exact.log_partition, abs=1e-10)
    np.testing.assert_allclose(
        found.violation_probability[0], exact.violation_probability, atol=1e-10
    )


@settings
@pytest.mark.parametrize("toll", [0.0, 1.5])
def test_tables_agree_with_enumeration_of_the_same_routes(
    toll: float, measure: str, between_states: bool
) -> None:
    """The dynamics of one are a formula, of the other a table, and no episode ends early."""
    changes = {"beta": 0.8, "measure": measure, "between_states": between_states}
    by_sequence = sample(enumerated(routes(Routes(toll=toll), **changes)), TASK)
    by_table = sample(tabulated(routes(LatticeRoutes(toll=toll), **changes)), TASK)
    assert by_table.log_partition[0] == pytest.approx(by_sequence.log_partition[0], abs=1e-12)
    np.testing.assert_allclose(
        by_table.summary.avoid_probability, by_sequence.summary.avoid_probability, rtol=1e-12
    )
    assert np.count_nonzero(is_open(by_table.violation_probability)) >= 10
