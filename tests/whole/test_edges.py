"""Regions whose edges lie where states and actions lie: every part of the library sees one side."""

from __future__ import annotations

import itertools
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import swerve
from swerve import ActionBox, Box, Demonstration, Problem, Task
from swerve.hypotheses.stepwise import stepwise


class Tenths(swerve.MDP):
    """A walk on tenths; float32 sums of tenths miss them by rounding."""

    state_names = ("x",)
    action_names = ("dx",)
    actions = jnp.array([[-0.1], [0.1]])
    bounds = ((-2.0, 2.0),)
    dt = 1.0
    num_steps = 6

    def dynamics(self, state, action):
        return state + action

    def reward(self, state, action, next_state, goal):
        return 0.0 * state[0]


START = Task([0.8], [0.8])
ELSEWHERE = Box(x=(-2.0, -1.9))


def avoided(low: int, high: int) -> float:
    """P(avoid [low, high) tenths) of the walk from 8 tenths, by counting whole numbers."""
    walks = [8 + np.cumsum(moves) for moves in itertools.product((-1, 1), repeat=6)]
    return float(np.mean([not ((x >= low) & (x < high)).any() for x in walks]))


@pytest.mark.parametrize(("low", "high"), [(4, 7), (3, 4), (9, 11), (10, 12), (7, 8)])
@pytest.mark.parametrize("between_states", [True, False])
def test_a_walk_on_tenths(low: int, high: int, between_states: bool) -> None:
    """Hypothesised and known, enumerated and sampled, the region is avoided equally often."""
    region = Box(x=(low / 10, high / 10))
    problem = Problem(Tenths(), [region], between_states=between_states)
    known = Problem(Tenths(), [ELSEWHERE], known=[region], between_states=between_states)
    free, within = (swerve.learn(p, "enumeration") for p in (problem, known))
    evidence = swerve.sample(free, START)
    expected = avoided(low, high)
    assert np.exp(evidence.log_ratio[0, 0]) == pytest.approx(expected, rel=1e-5)
    log_share = swerve.sample(within, START).log_partition - evidence.log_partition
    assert np.exp(log_share[0]) == pytest.approx(expected, rel=1e-5)


def test_what_demonstrators_avoid_they_are_seen_to_avoid() -> None:
    region = Box(x=(0.4, 0.7))
    problem = Problem(Tenths(), [region])
    made = swerve.demonstrate(problem, region, [START] * 20, solver="grid?num_points=41")
    touches = sum((np.abs(one.states - 0.7) < 1e-5).any() for one in made)
    assert touches > 5
    evidence = swerve.sample(swerve.learn(problem, "enumeration"), START)
    assert not swerve.infer(evidence, made).entered.any()
    known = Problem(Tenths(), [ELSEWHERE], known=[region])
    swerve.infer(swerve.sample(swerve.learn(known, "enumeration"), START), made)
    for one in made:
        steps = stepwise(problem.hypotheses, problem.hypotheses, evidence.problem.space, True)
        assert not any(steps.enter(state) for state in one.states.tolist())


class Pushes(Tenths):
    actions = jnp.array([[-0.7], [0.0], [0.7], [0.9]])
    action_names = ("force",)
    bounds = ((-5.0, 5.0),)
    num_steps = 3


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        (ActionBox(force=(0.7, 1.0)), (2 / 4) ** 3),
        (ActionBox(force=(-0.1, 0.7)), (3 / 4) ** 3),
        (ActionBox(force=(-0.7, 0.0)), (3 / 4) ** 3),
        (ActionBox(force=(0.0, 0.9)), (2 / 4) ** 3),
    ],
)
def test_actions_on_the_edge(region: ActionBox, expected: float) -> None:
    task = Task([0.0], [0.0])
    evidence = swerve.sample(swerve.learn(Problem(Pushes(), [region]), "enumeration"), task)
    assert np.exp(evidence.log_ratio[0, 0]) == pytest.approx(expected, rel=1e-5)
    known = Problem(Pushes(), [Box(x=(4.0, 5.0))], known=[region])
    within = swerve.sample(swerve.learn(known, "enumeration"), task)
    share = np.exp(within.log_partition[0] - evidence.log_partition[0])
    assert share == pytest.approx(expected, rel=1e-5)
    for index, force in enumerate((-0.7, 0.0, 0.7, 0.9)):
        states, actions = np.array([[0.0], [force]]), np.array([[force]])
        one = Demonstration("one", states, task, actions=actions)
        forbidden = region.among(Pushes())[index]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert swerve.infer(evidence, [one]).entered[0, 0] == forbidden


class Cart(Tenths):
    state_names = ("x", "v")
    action_names = ("force",)
    actions = jnp.linspace(-2.0, 2.0, 3)[:, None]
    bounds = ((-3.0, 3.0), (-4.0, 4.0))
    dt = 0.4
    num_steps = 5

    def dynamics(self, state, action):
        return jnp.stack([state[0] + self.dt * state[1], state[1] + self.dt * action[0]])


@pytest.mark.parametrize("start", [-1.2, -0.6, 0.3, 0.9])
def test_a_start_on_a_line_of_the_grid(start: float) -> None:
    """Nominal trajectories and a demonstration begin in the same cell, the one above the line."""
    cells = swerve.grid(x=(-3.0, 3.0, 20), v=(-4.0, 4.0, 8))
    task = Task([start, 0.9], [start, 0.9])
    evidence = swerve.sample(swerve.learn(Problem(Cart(), cells), "enumeration"), task)
    first = int(cells.cells(np.array([start, 0.9]), evidence.problem.space))
    assert cells.constraint(first).intervals["x"][0] == pytest.approx(start)
    certain = np.flatnonzero(evidence.violation_probability[0] == 1.0)
    np.testing.assert_array_equal(certain, [first])
    states = np.array([[start + 0.36 * k, 0.9] for k in range(3)])
    result = swerve.infer(evidence, [Demonstration("straight", states, task)])
    assert result.entered[0, first]
