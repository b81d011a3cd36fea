"""Odds of greedy selection: what going through all trajectories and all hypotheses says."""

from __future__ import annotations

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from support.synthetic import evidence_of_columns, make_demonstration

from swerve import (
    MDP,
    Box,
    Demonstration,
    Inference,
    Problem,
    Task,
    best_pair,
    greedy,
    grid,
    infer,
    learn,
    sample,
)
from swerve.inference.greedy import Pick
from swerve.solvers.exact.enumeration import EnumerationNominal

MOVES, NUM_STEPS, BETA = (-1.0, 0.0, 1.0), 4, 0.8


class Steps(MDP):
    """Steps of one to the left or right, with the time as a second state."""

    state_names = ("x", "time")
    action_names = ("dx",)
    actions = jnp.array([[move] for move in MOVES])
    bounds = ((-9.0, 9.0), (0.0, 9.0))
    dt = 1.0
    num_steps = NUM_STEPS

    def dynamics(self, state, action):
        return state + jnp.array([action[0], 1.0])

    def reward(self, state, action, next_state, goal):
        return -0.3 * action[0] ** 2

    def terminal_reward(self, state, goal):
        return -0.5 * (state[0] - goal[0]) ** 2


# name, x from, x to, time from, time to; a box holds its lower edges and not its upper edges
BOXES = {
    "right": (0.5, 9.0, 0.0, 9.0),
    "the same as right": (0.5, 9.0, 0.0, 9.0),
    "a part of right": (1.5, 9.0, 0.0, 9.0),
    "not right, late": (-9.0, 0.5, 2.5, 3.5),  # nobody avoids this and right
    "the start": (-0.5, 0.5, 0.0, 0.5),  # nobody avoids this
    "far": (7.0, 9.0, 0.0, 9.0),  # nobody enters this
    "left": (-9.0, -0.5, 0.0, 9.0),
    "a part of left": (-9.0, -1.5, 1.5, 9.0),
    "early": (-9.0, 9.0, 0.5, 1.5),  # nobody avoids this
}
TASKS = [Task([0.0, 0.0], [1.0, 4.0]), Task([0.0, 0.0], [-1.0, 4.0])]
PATHS = {  # of the first two, none enters right or left; the third crosses to the right
    "waits": [0, 0, 0, 0, 0],
    "dithers": [0, 0, -1, 0, 0],
    "crosses": [0, 0, 0, 1, 1],
    "leaves": [0, -1, -2, -2, -1],
}


@pytest.fixture(scope="module")
def nominal() -> EnumerationNominal:
    boxes = [Box(x=box[:2], time=box[2:]) for box in BOXES.values()]
    problem = Problem(Steps(), boxes, beta=BETA, between_states=False)
    found = learn(problem, "enumeration")
    assert isinstance(found, EnumerationNominal)
    return found


def enters(path: tuple[float, ...], box: tuple[float, float, float, float]) -> bool:
    return any(box[0] <= x < box[1] and box[2] <= time < box[3] for time, x in enumerate(path))


class World:
    """All trajectories of one task: their weights, and what each enters."""

    def __init__(self, task: Task) -> None:
        self.weight, rows = [], []
        for moves in itertools.product(MOVES, repeat=NUM_STEPS):
            path = tuple(float(x) for x in np.cumsum([task.start[0], *moves]))
            reward = -0.3 * sum(move**2 for move in moves) - 0.5 * (path[-1] - task.goal[0]) ** 2
            self.weight.append(math.exp(BETA * reward))
            rows.append([enters(path, box) for box in BOXES.values()])
        self.entered = np.array(rows)

    def mass(self, hypotheses: list[int]) -> float:
        """Return Z_C up to a factor."""
        return float(np.array(self.weight) @ ~self.entered[:, hypotheses].any(axis=1))


def likelihood(
    worlds: list[World], shown: list[tuple[int, list[bool]]], hypotheses: list[int], eps: float
) -> float:
    """Return L(C); 0 where a task that is shown cannot be done."""
    value = 1.0
    for task, entered in shown:
        left = worlds[task].mass(hypotheses)
        if left == 0.0:
            return 0.0
        obeys = not any(entered[h] for h in hypotheses)
        value *= eps + (1.0 - eps) * obeys * worlds[task].mass([]) / left
    return value


def assert_odds(
    picks: list[Pick],
    worlds: list[World],
    shown: list[tuple[int, list[bool]]],
    prior: np.ndarray,
    eps: float,
) -> None:
    chosen: list[int] = []
    for pick in picks:
        before = likelihood(worlds, shown, chosen, eps)
        left = [h for h in range(len(BOXES)) if h not in chosen]
        after = {h: likelihood(worlds, shown, [*chosen, h], eps) / before for h in left}
        share = sum(prior[1 + h] for h in left)
        odds = sum(prior[1 + h] * after[h] for h in left) / share * (1.0 - prior[0]) / prior[0]
        assert pick.log_odds == pytest.approx(math.log(odds), abs=1e-6)
        assert math.exp(pick.total_gain) == pytest.approx(max(after.values()), rel=1e-6)
        chosen.append(pick.hypothesis)


def made(nominal: EnumerationNominal, names: list[str], eps: float, prior: np.ndarray) -> Inference:
    """Return the inference from the paths of these names, each of either task in turn."""
    demonstrations = [
        Demonstration(
            f"{name} {k}",
            np.stack([np.array(PATHS[name], float), np.arange(5.0)], axis=1),
            TASKS[k % 2],
        )
        for k, name in enumerate(names)
    ]
    return infer(sample(nominal, TASKS), demonstrations, tolerance=eps, prior=prior)


CASES = {
    "of one": ["waits"],
    "of some": ["waits", "dithers", "waits"],
    "of many": ["dithers", "waits", "dithers", "waits", "waits", "leaves"],
    "across": ["crosses", "waits", "dithers", "waits", "waits", "waits", "waits"],
}


@pytest.mark.parametrize("eps", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("seed", [None, 0, 1])
@pytest.mark.parametrize("case", CASES)
def test_odds_are_those_of_all_hypotheses_left(
    nominal: EnumerationNominal, case: str, seed: int | None, eps: float
) -> None:
    worlds = [World(task) for task in TASKS]
    names, num = CASES[case], len(BOXES)
    prior = np.array([0.5, *[0.5 / num] * num])
    if seed is not None:
        prior = np.random.default_rng(seed).dirichlet(np.ones(num + 1))
    inference = made(nominal, names, eps, prior)
    shown = [
        (k % 2, [enters(tuple(map(float, PATHS[name])), box) for box in BOXES.values()])
        for k, name in enumerate(names)
    ]
    np.testing.assert_array_equal(inference.entered, [entered for _, entered in shown])
    picks = greedy(inference, nominal, threshold=1e-6)
    assert_odds(picks, worlds, shown, prior, eps)
    none = inference.posterior.none
    if picks:
        assert picks[0].log_odds == pytest.approx(math.log((1.0 - none) / none), abs=1e-9)
    assert bool(greedy(inference, nominal)) == (none <= 0.5)


@pytest.mark.parametrize("eps", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("case", CASES)
def test_a_pair_that_nobody_avoids_is_not_the_best(
    nominal: EnumerationNominal, case: str, eps: float
) -> None:
    """Where all demonstrations enter both, such a pair would count eps a demonstration."""
    worlds, names, num = [World(task) for task in TASKS], CASES[case], len(BOXES)
    inference = made(nominal, names, eps, np.array([0.5, *[0.5 / num] * num]))
    shown = [(k % 2, entered.tolist()) for k, entered in enumerate(inference.entered)]
    every = {
        pair: likelihood(worlds, shown, list(pair), eps)
        for pair in itertools.combinations(range(num), 2)
    }
    found = best_pair(inference, nominal)
    assert math.exp(found.log_likelihood) == pytest.approx(max(every.values()), rel=1e-6)
    assert every[found.hypotheses] == pytest.approx(max(every.values()), rel=1e-6)
    values = [likelihood(worlds, shown, [h], eps) for h in range(num)]
    np.testing.assert_allclose(np.exp(inference.log_likelihood), values, rtol=1e-6)


class TestWhatIsEnough:
    """By default, a constraint is picked if and only if P(none) is at most 1/2."""

    @staticmethod
    def shown(num: int, share: float, none: float = 0.5) -> Inference:
        """Of 1,000 trajectories a share enters 5; there are `num` demonstrations."""
        columns = np.zeros((1, 1000, 10), bool)
        columns[0, : round(1000 * share), 5] = True
        evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)))
        return infer(evidence, [make_demonstration()] * num, prior=none)

    def test_many_demonstrations_may_each_tell_little(self) -> None:
        inference = self.shown(200, 0.06)
        assert inference.posterior.none < 1e-3
        [pick] = greedy(inference)
        assert pick.hypothesis == 5
        assert pick.gain < 0.1
        assert pick.log_odds == pytest.approx(
            math.log((1.0 - inference.posterior.none) / inference.posterior.none)
        )
        none = greedy(inference, threshold=0.1)
        assert (none, none.ended, none.threshold) == ([], "threshold", 0.1)
        assert none.following == pick
        assert greedy(inference, threshold=0.9 * pick.gain) == [pick]

    @pytest.mark.parametrize("none", [0.1, 0.5, 0.9, 0.99])
    @pytest.mark.parametrize("num", [1, 10, 40, 100])
    def test_it_agrees_with_the_posterior(self, num: int, none: float) -> None:
        inference = self.shown(num, 0.06, none)
        picks = greedy(inference)
        assert bool(picks) == (inference.posterior.none <= 0.5)
        if not picks:
            assert picks.following is not None
            assert (picks.ended, picks.following.hypothesis) == ("odds", 5)

    def test_without_a_chance_of_none_whatever_gains_is_picked(self) -> None:
        picks = greedy(self.shown(1, 0.01, 0.0))
        assert [pick.hypothesis for pick in picks] == [5]
        assert picks[0].log_odds == math.inf
        assert picks.ended == "exhausted"
