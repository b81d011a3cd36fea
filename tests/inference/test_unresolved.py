"""Which open scores can change an answer, and in which order."""

from __future__ import annotations

import numpy as np
from support.rankings import evidence_with_chances
from support.synthetic import make_demonstration

from swerve.answer import infer
from swerve.inference.unresolved import worth_resolving

OPEN = (3, 4, 7)  # cells that every trajectory enters; the tasks start in 1, 5 and 9
CHANCES = [1.0 if cell in OPEN else 0.05 for cell in range(10)]


def entering(cell: int, number: int) -> list:
    """Demonstrations of the first task that enter a cell."""
    return [make_demonstration(0, f"to_{cell}_{k}", x=cell + 0.5) for k in range(number)]


def test_the_first_by_the_samples_comes_first() -> None:
    demonstrations = [*entering(3, 2), *entering(7, 1), make_demonstration()]
    ranking = infer(evidence_with_chances(CHANCES), demonstrations, tolerance=0.1)
    assert set(np.flatnonzero(ranking.is_open.any(axis=0)).tolist()) == set(OPEN)
    assert worth_resolving(ranking).tolist() == [4, 7, 3]


def test_equal_scores_come_in_order_of_index() -> None:
    ranking = infer(evidence_with_chances(CHANCES), [make_demonstration()])
    assert worth_resolving(ranking).tolist() == list(OPEN)


def test_what_demonstrations_enter_is_not_worked_out_without_a_tolerance() -> None:
    ranking = infer(evidence_with_chances(CHANCES), [*entering(3, 1), make_demonstration()])
    assert worth_resolving(ranking).tolist() == [4, 7]


def test_what_nearly_all_demonstrations_enter_can_change_nothing() -> None:
    """40 demonstrations cost 2.3 nats each, and the one that avoids tells 50 nats at most."""
    demonstrations = [*entering(3, 40), make_demonstration()]
    ranking = infer(evidence_with_chances(CHANCES), demonstrations, tolerance=0.1)
    assert ranking.is_open[0, 3]
    assert worth_resolving(ranking).tolist() == [4, 7]
    few = infer(evidence_with_chances(CHANCES), demonstrations[-15:], tolerance=0.1)
    assert 3 not in worth_resolving(few)  # 4 and 7 have as much from each of 14 more
    alone = evidence_with_chances([1.0 if cell == 3 else 0.05 for cell in range(10)])
    assert worth_resolving(infer(alone, demonstrations[-15:], tolerance=0.1)).tolist() == [3]


def test_a_share_of_the_posterior_counts_where_the_first_is_out_of_reach() -> None:
    """Each demonstration has 4.5 nats for cell 7, so that 3 ends at least 2 nats behind."""
    chances = [1.0 if cell == 3 else 0.99 if cell == 7 else 0.05 for cell in range(10)]
    evidence = evidence_with_chances(chances)
    demonstrations = [*entering(3, 7), make_demonstration()]
    ranking = infer(evidence, demonstrations, tolerance=0.1)
    assert worth_resolving(ranking).tolist() == [3]
    prior = np.where(np.arange(11) == 4, 0.0, 0.1)  # of cell 3: none
    assert worth_resolving(infer(evidence, demonstrations, tolerance=0.1, prior=prior)).size == 0
    more = [*entering(3, 8), make_demonstration()]
    assert worth_resolving(infer(evidence, more, tolerance=0.1)).size == 0


def test_nothing_is_open_where_samples_tell_all() -> None:
    ranking = infer(evidence_with_chances([0.3] * 10), [make_demonstration()])
    assert worth_resolving(ranking).tolist() == []
