"""Sampled estimates agree with enumeration."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest
from support.cases import (
    CASES,
    GRID,
    NUM,
    SMALL_PPO,
    STANDARD_ERRORS,
    enumerated,
    exact,
    is_open,
    sampled,
    spread_of,
    weights_avoiding,
)

from swerve import Evidence, Task
from swerve.evidence import estimators
from swerve.solvers.base import Solver


@cache
def pairs(name: str) -> list[dict[tuple[int, ...], float]]:
    """Return log Z_C of each task for all pairs C of hypotheses that are neither rare nor sure."""
    problem, tasks, _ = CASES[name]
    found = []
    for probability, *task in zip(exact(name).violation_probability, *tasks, strict=True):
        sets = list(itertools.combinations(np.flatnonzero(is_open(probability)).tolist(), 2))
        values = enumerated(problem).log_partition(Task(*task), sets)
        found.append(dict(zip(sets, values.tolist(), strict=True)))
    return found


def assert_within_errors(evidence: Evidence, truth: Evidence, least_ess: float) -> None:
    """Estimates of each task, importance-weighted, are as near as they claim to be."""
    for k, ess in enumerate(evidence.effective_sample_size):
        assert ess >= least_ess * NUM
        error = np.sqrt(evidence.summary.avoid_variance[k]) + 1.0 / ess
        difference = evidence.violation_probability[k] - truth.violation_probability[k]
        assert np.abs(difference / error).max() < STANDARD_ERRORS
        assert np.count_nonzero(is_open(truth.violation_probability[k])) >= 5
        spread = math.sqrt(1.0 / ess - 1.0 / NUM)
        assert evidence.log_partition[k] == pytest.approx(
            truth.log_partition[k], abs=STANDARD_ERRORS * spread + 1e-3
        )


@pytest.mark.parametrize("solver", [GRID, SMALL_PPO], ids=lambda solver: solver.name)
@pytest.mark.parametrize("name", CASES)
def test_sampling_agrees_with_enumeration(name: str, solver: Solver) -> None:
    """Several tasks at once, and hypotheses about actions, about both, and about the end."""
    assert_within_errors(sampled(name, solver), exact(name), CASES[name].least_ess[solver.name])


@pytest.mark.parametrize("name", CASES)
def test_equal_weights_of_a_good_policy_agree_with_enumeration(name: str) -> None:
    """Within Hoeffding's bound, and what the policy's divergence from pi_0 adds (Pinsker)."""
    evidence = sampled(name, GRID).weighted("plain")
    difference = np.abs(evidence.violation_probability - exact(name).violation_probability)
    bias = np.sqrt(0.5 * np.maximum(evidence.kl, 0.0))
    assert bias[0] < 0.1
    assert (difference.max(axis=1) < evidence.hoeffding_error(0.9999) + bias).all()


@pytest.mark.parametrize("solver", [GRID, SMALL_PPO], ids=lambda solver: solver.name)
@pytest.mark.parametrize("name", CASES)
def test_sets_of_hypotheses_agree_with_enumeration(name: str, solver: Solver) -> None:
    """Which hypotheses one and the same trajectory enters: they do not go by chance together."""
    evidence, truth = sampled(name, solver), exact(name)
    by_chance = []
    for k, expected in enumerate(pairs(name)):
        for pair, value in expected.items():
            clean = weights_avoiding(evidence, k, pair)
            if value - truth.log_partition[k] < math.log(0.02):
                continue
            error = STANDARD_ERRORS * spread_of(clean)
            assert estimators.log_partition(clean) == pytest.approx(value, abs=error + 1e-3)
            alone = truth.log_partition[k] + truth.log_ratio[k, list(pair)].sum()
            by_chance.append(abs(value - alone) < error + 1e-3)
    assert len(by_chance) >= 20
    assert np.mean(by_chance) < 0.5
