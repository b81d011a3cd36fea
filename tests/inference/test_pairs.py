"""The best pair: what going through all pairs says, and never worse than greedy selection."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.plain_greedy import NUM_HYPOTHESES, Plain, made_up
from support.synthetic import evidence_of_columns, make_demonstration
from support.walks import ROUND, TASK

from swerve import (
    Box,
    Demonstration,
    Inference,
    Pair,
    Problem,
    Task,
    best_pair,
    greedy,
    grid,
    infer,
    learn,
    sample,
    tabular,
)
from swerve.inference import pairs
from swerve.solvers.exact.tabular import TableNominal


def log_likelihood(inference: Inference, pair: tuple[int, int]) -> float:
    """Return log L of a pair by weighing every trajectory, nats."""
    plain, evidence, total = Plain(inference), inference.evidence, 0.0
    for d, k in enumerate(inference.task_of):
        counted = [c for c in pair if inference.is_counted[k, c]]
        weight = np.exp(evidence.log_weight[k] - evidence.log_weight[k].max())
        weight /= weight.sum()
        share = max(weight @ ~plain.bits[k][:, counted].any(axis=1), weight @ weight)
        total += plain.term(d, list(pair), math.log(share))
    return total


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    tolerance=st.sampled_from([0.0, 0.01, 0.3]),
    counted=st.sampled_from([1.0, 0.7]),
    num_trajectories=st.sampled_from([25, 300]),
    block=st.sampled_from([3, 256]),
)
def test_no_pair_is_better(
    seed: int, tolerance: float, counted: float, num_trajectories: int, block: int
) -> None:
    inference = made_up(seed, tolerance, counted, num_trajectories, num_demonstrations=5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "BLOCK", block)
        found = best_pair(inference)
    left = np.flatnonzero(~inference.struck_out).tolist()
    values = {pair: log_likelihood(inference, pair) for pair in itertools.combinations(left, 2)}
    assert found.log_likelihood == pytest.approx(max(values.values()), abs=1e-9)
    assert values[found.hypotheses] == pytest.approx(found.log_likelihood, abs=1e-9)
    picks = greedy(inference, threshold=0.0, most=2)
    if len(picks) == 2:
        first, second = sorted(pick.hypothesis for pick in picks)
        assert found.log_likelihood >= values[first, second] - 1e-9


def halves() -> Inference:
    """Cell 5 is entered by 240 of 400; cells 6 and 7 by 200 each, all of them together."""
    columns = np.zeros((1, 400, 10), bool)
    columns[0, 80:320, 5] = columns[0, :200, 6] = columns[0, 200:396, 7] = True
    return infer(evidence_of_columns(columns, grid(x=(0.0, 10.0, 10))), [make_demonstration()])


def test_two_may_explain_together_what_greedy_selection_misses() -> None:
    inference = halves()
    assert greedy(inference, most=2)[0].hypothesis == 5
    found = best_pair(inference)
    assert found.hypotheses == (6, 7)
    assert found.log_likelihood == pytest.approx(math.log(100.0))
    assert found.standard_error == pytest.approx(math.sqrt(0.99 * 0.01 / 400) / 0.01)
    share = found.log_partition - inference.evidence.log_partition
    assert share[0] == pytest.approx(math.log(0.01))
    assert found.log_likelihood > sum(p.gain for p in greedy(inference, most=2)) + 0.5


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
def test_of_an_exact_solver_by_its_sums_over_sets(nominal: TableNominal, tolerance: float) -> None:
    inference = infer(sample(nominal, TASK), [ROUND], tolerance=tolerance)
    found = best_pair(inference, nominal)
    left = np.flatnonzero(~inference.struck_out).tolist()
    every = list(itertools.combinations(left, 2))
    values = nominal.log_partition(TASK, [(), *every])
    enters = inference.entered[0][np.array(every)].any(axis=1)
    with np.errstate(over="ignore"):
        ratio = (1.0 - tolerance) * np.where(enters, 0.0, np.exp(values[0] - values[1:]))
    with np.errstate(divide="ignore"):
        expected = np.log(tolerance + ratio)
    expected = np.where(np.isfinite(values[1:]) & np.isfinite(expected), expected, -np.inf)
    assert found.log_likelihood == pytest.approx(expected.max(), abs=1e-9)
    place = every.index(found.hypotheses)
    assert expected[place] == pytest.approx(expected.max(), abs=1e-9)
    assert found.log_partition[0] == pytest.approx(values[1 + place], abs=1e-9)
    assert found.standard_error == 0.0


def test_of_an_exact_solver_where_nobody_avoids_two() -> None:
    world = tabular(np.array([[1, 2, 3], *3 * [[0, 0, 0]]]), np.zeros(4), num_steps=1)
    problem = Problem(world, [Box(state=(0.5, 2.5)), Box(state=(2.5, 3.5))])
    task = Task(np.zeros(1), np.zeros(0))
    every: Any = learn(problem, "tabular")
    demonstration = Demonstration("one", np.array([[0.0], [1.0]]), task)
    inference = infer(sample(every, task), [demonstration], tolerance=0.1)
    with pytest.raises(ValueError, match="no pair of hypotheses that a trajectory of every task"):
        best_pair(inference, every)


def test_bad_arguments(nominal: TableNominal) -> None:
    inference = halves()
    with pytest.raises(ValueError, match=r"inference: expected a swerve.Inference, got 3"):
        best_pair(3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="nominal: this evidence was sampled"):
        best_pair(inference, nominal)
    with pytest.raises(ValueError, match="this evidence is exact and holds no samples"):
        best_pair(infer(sample(nominal, TASK), [ROUND]))
    entered = np.ones((1, 10), bool)
    entered[0, 3] = False
    one = dataclasses.replace(inference, entered=entered)
    with pytest.raises(ValueError, match="two hypotheses that demonstrations leave, got 1"):
        best_pair(one)
    assert isinstance(best_pair(inference), Pair)
    assert len(inference.struck_out) != NUM_HYPOTHESES
