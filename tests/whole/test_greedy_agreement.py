"""Greedy selection agrees with sums over sets of hypotheses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.cases import CASES, GRID, KNOWN, enumerated, sampled, tabulated, world
from support.greedy_steps import assert_greedy_agrees, choose, sampled_demonstrations

from swerve import Task, greedy, infer, sample
from swerve.systems.gridworld import cell_box, move_box


def test_greedy_of_tables_is_what_sums_over_sets_say() -> None:
    problem = world(known=KNOWN)
    tasks = Task(np.array([[0.0, 0.0], [0.0, 2.0]]), np.array([[3.0, 2.0], [3.0, 1.0]]))
    obeyed = [*KNOWN, cell_box((2, 2)), move_box("down-right")]
    made = sampled_demonstrations(tabulated(dataclasses.replace(problem, known=obeyed)), tasks, 20)
    start = infer(sample(tabulated(problem), tasks), made)
    picks = greedy(start, tabulated(problem), threshold=0.01)
    assert len(picks) >= 3
    for k, pick in enumerate(picks):
        choice = choose(tabulated(problem), start, [p.hypothesis for p in picks[:k]])
        assert choice.gain[pick.hypothesis] == pytest.approx(choice.gain.max(), abs=1e-12)
        assert pick.gain == pytest.approx(choice.gain.max(), abs=1e-12)
        if choice.margin > 1e-9:
            np.testing.assert_allclose(pick.log_partition, choice.log_partition, atol=1e-12)
    last = choose(tabulated(problem), start, [p.hypothesis for p in picks])
    assert last.gain.max() < 0.01


@pytest.mark.parametrize(
    ("name", "hidden", "least"), [("pendulum", [4, 6], 2), ("cart", [5, 9], 2)], ids=list(CASES)
)
def test_greedy_of_samples_agrees_with_enumeration(
    name: str, hidden: list[int], least: int
) -> None:
    problem, tasks, _ = CASES[name]
    obeyed = [*problem.known, *(problem.hypotheses.constraint(k) for k in hidden)]
    made = sampled_demonstrations(enumerated(dataclasses.replace(problem, known=obeyed)), tasks, 10)
    assert_greedy_agrees(sampled(name, GRID), enumerated(problem), made, least)
