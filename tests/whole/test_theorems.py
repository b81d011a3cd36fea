"""Theorems 1 and 2 of the paper hold, exactly and for samples."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
from support.cases import (
    CART,
    CASES,
    GRID,
    KNOWN,
    STANDARD_ERRORS,
    WORLD_TASK,
    enumerated,
    exact,
    is_open,
    sampled,
    spread_of,
    tabulated,
    weights_avoiding,
    world,
)
from support.reference import CART_TASK, PENDULUM_TASK, short_pendulum
from support.routes import MIDDLE, NUM_STEPS, TASK, WALL, LatticeRoutes, Routes, routes

from swerve import Gridworld, Problem, Task, sample
from swerve.constraints.base import violates
from swerve.evidence import estimators
from swerve.hypotheses.bits import unpack
from swerve.systems.gridworld import MOVES


@pytest.mark.parametrize(
    ("solve", "problem", "task"),
    [
        (tabulated, world(), WORLD_TASK),
        (tabulated, world(known=KNOWN, measure="counting", between_states=False), WORLD_TASK),
        (tabulated, routes(LatticeRoutes(toll=1.5)), TASK),
        (enumerated, short_pendulum(between_states=False), PENDULUM_TASK),
        (enumerated, CART.problem, CART_TASK),
        (enumerated, dataclasses.replace(CART.problem, measure="counting"), CART_TASK),
    ],
)
def test_the_ratio_of_partition_functions_is_the_probability_of_avoiding(
    solve, problem: Problem, task: Task
) -> None:
    """Theorem 1: Z_c / Z_0 by leaving out, by solving with c known, and as P(avoid c)."""
    evidence = sample(solve(problem), task)
    avoid = evidence.summary.avoid_probability[0]
    assert np.count_nonzero(is_open(avoid)) >= 4
    singles = solve(problem).log_partition(task, [[], *([c] for c in range(len(avoid)))])
    np.testing.assert_allclose(np.exp(singles[1:] - singles[0]), avoid, rtol=1e-9)
    for c in np.argsort(np.abs(avoid - 0.5))[:2]:
        known = [*problem.known, problem.hypotheses.constraint(c)]
        solved = solve(dataclasses.replace(problem, known=known)).log_partition(task, [[]])[0]
        assert solved == pytest.approx(singles[1 + c], abs=1e-9)


@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_what_is_avoided_together_is_avoided_one_after_another(measure: str) -> None:
    """Z_{a,c} / Z_a = P(avoid c | avoid a), both with a in force and with a known."""
    problem = world(measure=measure)
    nominal = tabulated(problem)
    for a in (0, 1, 8, 17):
        given = nominal.answer(WORLD_TASK, np.random.default_rng(0), avoiding=[a])
        hypotheses = range(len(problem.hypotheses))
        both = nominal.log_partition(WORLD_TASK, [[a, c] for c in hypotheses])
        np.testing.assert_allclose(
            given.avoid_probability, np.exp(both - given.log_partition), rtol=1e-9
        )
        known = dataclasses.replace(problem, known=[problem.hypotheses.constraint(a)])
        solved = sample(tabulated(known), WORLD_TASK)
        np.testing.assert_allclose(solved.summary.avoid_probability[0], given.avoid_probability)
        assert given.avoid_probability[a] == pytest.approx(1.0, abs=1e-12)


class Paths(NamedTuple):
    """All trajectories of a problem.

    Attributes:
      total_reward: [N] exact.
      length: [N].
      entered: [N, H].
    """

    total_reward: np.ndarray
    length: np.ndarray
    entered: np.ndarray


def paths_of_routes() -> tuple[Problem, Task, Paths]:
    problem = routes(Routes(toll=1.5))
    moves = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=NUM_STEPS)))
    y = MIDDLE + np.cumsum(np.pad(moves, ((0, 0), (1, 0))), axis=1)
    states = np.stack([np.broadcast_to(np.arange(NUM_STEPS + 1.0), y.shape), y], axis=-1)
    reward = -0.25 * (moves**2).sum(axis=1) - 0.125 * (y[:, -1] - MIDDLE) ** 2
    reward -= 1.5 * (y[:, 4] > MIDDLE)
    space = problem.mdp.space
    allowed = ~violates(WALL, states, space, problem.between_states)
    bits = problem.hypotheses.violations(states[allowed], space, problem.between_states)
    entered = unpack(bits, len(problem.hypotheses))
    length = np.full(allowed.sum(), NUM_STEPS)
    return problem, TASK, Paths(reward[allowed], length, entered)


def paths_of_world() -> tuple[Problem, Task, Paths]:
    """Cells and moves alone are hypothesised, and only cells that a walker stands on count."""
    mdp = Gridworld(3, 3, 5, step_reward=-0.375, walls=((1, 1),))
    problem = Problem(mdp, mdp.hypotheses(), between_states=False)
    found: list[tuple[int, set[int]]] = []

    def go(place: tuple[int, int], length: int, entered: set[int]) -> None:
        entered = entered | {3 * place[1] + place[0]}
        if place == (2, 2):
            found.append((length, entered))
        elif length < mdp.num_steps:
            for a, (dx, dy) in enumerate(MOVES.values()):
                ahead = (place[0] + dx, place[1] + dy)
                if ahead != (1, 1) and min(ahead) >= 0 and max(ahead) < 3:
                    go(ahead, length + 1, entered | {9 + a})

    go((0, 0), 0, set())
    entered = np.array([[h in path for h in range(17)] for _, path in found])
    length = np.array([length for length, _ in found])
    task = Task(np.array([0.0, 0.0]), np.array([2.0, 2.0]))
    return problem, task, Paths(-0.375 * length, length, entered)


@pytest.mark.parametrize("measure", ["uniform", "counting"])
@pytest.mark.parametrize(
    ("solve", "make"),
    [(enumerated, paths_of_routes), (enumerated, paths_of_world), (tabulated, paths_of_world)],
)
def test_another_temperature_is_an_expectation_at_this_one(solve, make, measure: str) -> None:
    """Theorem 2: Z_{d,c} / Z_{s,c} = E_{pi_{s,c}}[exp((beta_d - beta_s) R)]."""
    problem, task, paths = make()
    sets = [[], *([c] for c in range(len(problem.hypotheses))), [1, 3], [2, 5, 7]]
    demonstrated, sampled_at = (
        solve(dataclasses.replace(problem, beta=beta, measure=measure)).log_partition(task, sets)
        for beta in (1.75, 0.5)
    )
    log_weight = 0.5 * paths.total_reward
    if measure == "uniform":
        log_weight = log_weight - paths.length * math.log(problem.mdp.num_actions)
    ratios = []
    for k, avoiding in enumerate(sets):
        clean = ~paths.entered[:, avoiding].any(axis=1)
        if not clean.any():
            assert sampled_at[k] == demonstrated[k] == -math.inf
            continue
        assert sampled_at[k] == pytest.approx(np.logaddexp.reduce(log_weight[clean]), abs=1e-9)
        weight = estimators.normalise(log_weight[clean])
        expectation = weight @ np.exp(1.25 * paths.total_reward[clean])
        assert demonstrated[k] - sampled_at[k] == pytest.approx(math.log(expectation), abs=1e-9)
        ratios.append(demonstrated[k] - sampled_at[k])
    assert len(ratios) >= 12
    assert np.ptp(ratios) > 0.1


@pytest.mark.parametrize("name", CASES)
def test_samples_of_one_temperature_answer_for_another(name: str) -> None:
    problem, tasks, _ = CASES[name]
    evidence, beta = sampled(name, GRID), problem.beta
    hotter, colder = (
        (factor * beta, sample(enumerated(dataclasses.replace(problem, beta=factor * beta)), tasks))
        for factor in (0.2, 2.0)
    )
    tried = 0
    for other, truth in (hotter, colder):
        assert np.abs(truth.violation_probability - exact(name).violation_probability).max() > 0.05
        for k, c in itertools.product(range(evidence.num_tasks), range(len(problem.hypotheses))):
            clean = weights_avoiding(evidence, k, [c])
            if not np.isfinite(clean).any():
                continue
            tilted = clean + (other - beta) * evidence.samples.total_reward[k]
            if estimators.effective_sample_size(tilted) < 400.0:
                continue
            tried += 1
            found = estimators.log_partition(tilted) - estimators.log_partition(clean)
            here, there = (e.log_partition[k] + e.log_ratio[k, c] for e in (exact(name), truth))
            error = STANDARD_ERRORS * (spread_of(tilted) + spread_of(clean))
            assert found == pytest.approx(there - here, abs=error + 1e-3)
    assert tried >= evidence.num_tasks * len(problem.hypotheses)
