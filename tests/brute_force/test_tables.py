"""The discrete solver and soft shortest paths agree with brute force on their tables."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from brute_force.chunks import every, over
from brute_force.comparing import Differences, compare_evidence, compare_greedy, compare_inference
from brute_force.reference.answers import answer
from brute_force.reference.cases import random_case
from brute_force.reference.cells import CellWorld, longest_share, walk_weights
from brute_force.reference.layouts import Maker
from brute_force.reference.worlds import TableWorld, random_table_world
from brute_force.translation import constraint_of, inferred, problem_of, tasks_of

from swerve import Discrete, Problem, SoftPaths, Task, learn, sample, tabular

CLOSE = 3e-5  # nats: rewards are float32
SIZES = ((2, 4), (2, 5), (3, 3), (3, 4), (4, 3))  # A, T


def cells_compared(seed: int) -> list[str]:
    case, note = random_case(seed, "cells", SIZES), Differences(seed, CLOSE)
    world = case.world
    assert isinstance(world, CellWorld)
    truth = answer(case)
    solver = Discrete(
        tuple(world.num_cells.tolist()),
        hold=world.hold,
        low=tuple(world.low.tolist()),
        high=tuple(world.high.tolist()),
    )
    nominal = learn(problem_of(case), solver)
    evidence = sample(nominal, tasks_of(case))
    compare_evidence(note, evidence, truth)
    inference = inferred(case, evidence)
    compare_inference(note, inference, truth)
    if case.recordings:
        compare_greedy(note, inference, truth, nominal)
    return note.found


@pytest.mark.parametrize("seeds", every(10), ids=str)
def test_discrete_dynamics(seeds: range) -> None:
    over(seeds, cells_compared)


def paths_compared(seed: int) -> list[str]:
    generator, note = np.random.default_rng([seed, 7]), Differences(seed, 1e-6)
    world, beta = _walkable(generator), float(generator.uniform(0.5, 3.0))
    measure = ("uniform", "counting")[seed % 2]
    num = len(world.absorbing)
    log_partition = walk_weights(world, beta, measure)
    starts = [s for s in range(num - 1) if longest_share(world, beta, measure, s) < 1e-4]
    maker = Maker(generator, world, lambda: generator.integers(num, size=1).astype(float))
    kinds = ("box", "ball", "half_space", "action", "state_action", "union")
    regions = [maker.of_kind(str(generator.choice(kinds))) for _ in range(6)]
    mdp = tabular(
        world.successors,
        world.rewards,
        num_steps=world.num_steps,
        terminal_rewards=world.terminal,
        absorbing=[num - 1],
    )
    problem = Problem(mdp, [constraint_of(region) for region in regions], beta, measure)
    tasks = [Task(np.array([float(s)]), np.zeros(0)) for s in starts]
    evidence = sample(learn(problem, SoftPaths()), tasks)
    note.numbers("log_partition", evidence.log_partition, log_partition[starts])
    left = [walk_weights(world, beta, measure, region)[starts] for region in regions]
    expected = np.stack(left, axis=1) - log_partition[starts][:, None]
    note.numbers("log_ratio", evidence.log_ratio, expected)
    return note.found


def _walkable(generator: np.random.Generator) -> TableWorld:
    """Return a table on which every walk soon ends, whatever beta and the measure."""
    world = random_table_world(generator, 300, 3)
    num = len(world.absorbing)
    successors = world.successors.copy()
    successors[:-1, 0] = np.arange(1, num)  # one action leads on to the end
    absorbing = np.arange(num) == num - 1
    rewards = generator.uniform(-6.0, -3.0, successors.shape)
    terminal = np.where(absorbing, world.terminal, -np.inf)
    return dataclasses.replace(
        world, successors=successors, rewards=rewards, absorbing=absorbing, terminal=terminal
    )


@pytest.mark.parametrize("seeds", every(10), ids=str)
def test_walks_of_any_length(seeds: range) -> None:
    over(seeds, paths_compared)
