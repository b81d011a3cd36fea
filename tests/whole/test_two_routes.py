"""Two routes of known mass: which solvers and samplers find both."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from support.cases import GRID, NUM, SMALL_PPO, STANDARD_ERRORS, enumerated, tabulated
from support.greedy_steps import assert_greedy_agrees, sampled_demonstrations
from support.routes import (
    ABOVE,
    BELOW,
    HEIGHT,
    TASK,
    WALL,
    LatticeRoutes,
    Planted,
    Routes,
    routes,
    share_above,
)

from swerve import Box, Evidence, Problem, Task, demonstrate, infer, learn, sample
from swerve.evidence.samples import METHODS, NUM_KEPT
from swerve.hypotheses.bits import unpack

BOTH = routes(Routes(toll=1.0))


LATTICE = routes(LatticeRoutes(toll=1.0))


@cache
def truth_of_routes() -> Evidence:
    """Return what is so of both, the formula and the table."""
    return sample(tabulated(LATTICE), TASK)


@pytest.mark.parametrize("beta", [1e-9, 1.0, 2.5])
@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_the_odds_of_two_routes_are_those_of_the_toll(measure: str, beta: float) -> None:
    for solve, mdp in ((enumerated, Routes(toll=1.0)), (tabulated, LatticeRoutes(toll=1.0))):
        problem = routes(mdp, measure=measure, beta=beta)
        above, below = sample(solve(problem), TASK).violation_probability[0, :2]
        assert above == pytest.approx(share_above(problem), abs=1e-12)
        assert above + below == pytest.approx(1.0, abs=1e-12)


def test_a_policy_of_pi_0_itself_is_weighed_as_such() -> None:
    evidence = sample(Planted(LATTICE, LATTICE), TASK, NUM, method="importance")
    truth = truth_of_routes()
    assert np.ptp(evidence.importance_log_weight) < 1e-4
    assert evidence.log_partition[0] == pytest.approx(truth.log_partition[0], abs=1e-5)
    difference = evidence.violation_probability - truth.violation_probability
    assert np.abs(difference).max() < evidence.weighted("plain").hoeffding_error(0.9999)


@pytest.mark.parametrize(("kept", "closed"), [(0, ABOVE), (1, BELOW)], ids=["below", "above"])
def test_a_route_never_taken_is_seen_by_explorers_alone(kept: int, closed: Box) -> None:
    """pi_0 of half of the modes has equal weights too: wrong by far, and sure of itself."""
    half = dataclasses.replace(LATTICE, known=[WALL, closed])
    evidence = sample(Planted(LATTICE, half), TASK, NUM)
    truth = truth_of_routes()
    missed = truth.violation_probability[0, kept]
    assert 0.2 < missed < 0.8
    assert evidence.effective_sample_size[0] > 0.999 * NUM
    assert abs(evidence.kl[0]) < 1e-5
    assert evidence.missed_share[0] == pytest.approx(missed, abs=0.15)
    assert infer(evidence, []).warnings[0].startswith("not to be trusted: about ")
    assert evidence.violation_probability[0, kept] == 0.0
    assert evidence.standard_error[0, kept] < 1e-3
    expected = truth.log_partition[0] + math.log(1.0 - missed)
    assert evidence.log_partition[0] == pytest.approx(expected, abs=1e-5)


def assert_both_routes(evidence: Evidence) -> None:
    """The mass of the route above is right, and so are the cells on either side."""
    truth = truth_of_routes()
    ess = evidence.effective_sample_size[0]
    assert ess > 0.2 * NUM
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / ess
    difference = evidence.violation_probability[0] - truth.violation_probability[0]
    assert np.abs(difference / error).max() < STANDARD_ERRORS
    assert error[0] < 0.02
    assert 0.2 < share_above(BOTH) < 0.3


@pytest.mark.parametrize("method", METHODS)
def test_the_grid_solver_takes_both_routes(method: str) -> None:
    evidence = sample(learn(BOTH, GRID), TASK, NUM, method=method)
    assert evidence.kl[0] < 1e-4
    assert_both_routes(evidence)


def test_ppo_takes_both_routes() -> None:
    assert_both_routes(sample(learn(BOTH, SMALL_PPO), TASK, NUM))


@pytest.mark.parametrize(("solve", "problem"), [(enumerated, BOTH), (tabulated, LATTICE)])
def test_exact_draws_take_both_routes(solve, problem: Problem) -> None:
    answers = [sample(solve(problem), TASK, seed=seed) for seed in range(20)]
    bits = np.concatenate([answer.samples.violations[0] for answer in answers])
    assert len(bits) == 20 * NUM_KEPT
    assert_shares(unpack(bits, len(problem.hypotheses)), answers[0].violation_probability[0])


def assert_shares(entered: np.ndarray, probability: np.ndarray) -> None:
    """Equal draws [N, H] enter hypotheses as often as they should."""
    variance = np.maximum(probability * (1.0 - probability), 0.0)
    error = np.sqrt(variance / len(entered)) + 1.0 / len(entered)
    assert np.abs((entered.mean(axis=0) - probability) / error).max() < STANDARD_ERRORS


def test_demonstrations_take_both_routes() -> None:
    """The wall is what demonstrators know and the model does not."""
    unaware = dataclasses.replace(BOTH, known=[])
    tasks = Task(*(np.repeat(x[None], 400, axis=0) for x in TASK))
    made = demonstrate(unaware, WALL, tasks, solver=GRID)
    bits = BOTH.hypotheses.violations(
        np.array([one.states for one in made]), BOTH.mdp.space, BOTH.between_states
    )
    truth = truth_of_routes().violation_probability[0]
    assert_shares(unpack(bits, len(BOTH.hypotheses)), truth)


def test_greedy_of_an_exact_policy_agrees_with_tables() -> None:
    unaware = routes(LatticeRoutes(toll=1.0), known=[])
    hypotheses = [Box(x=(3.5, 4.5), y=(y - 0.5, y + 0.5)) for y in range(4, HEIGHT - 4)]
    unaware = dataclasses.replace(unaware, hypotheses=hypotheses, between_states=False)
    obeyed = dataclasses.replace(unaware, known=[Box(x=(3.5, 4.5), y=(6.5, 8.5)), BELOW])
    made = sampled_demonstrations(tabulated(obeyed), Task(*(x[None] for x in TASK)), 40)
    assert_greedy_agrees(sample(Planted(unaware, unaware), TASK, NUM), tabulated(unaware), made, 3)
