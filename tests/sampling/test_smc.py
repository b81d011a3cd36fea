"""Sequential Monte Carlo: against enumeration, with values that are exact, wrong or absent."""

from __future__ import annotations

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.guesses import Guess, Guessed
from support.reference import Exact, enumerate_exactly, short_cart
from support.routes import TASK, LatticeRoutes, Planted, Routes, routes, share_above
from support.short_problems import PROBLEMS, STANDARD_ERRORS, assert_within_errors

from swerve import Task, learn, sample
from swerve.evidence.samples import log_weights
from swerve.sampling.smc import _systematic, smc_rollout
from swerve.simulation.policies import LookAhead
from swerve.simulation.trajectory import take_step

OFTEN = "ends-often"  # most leave the track
OF_MANY_LENGTHS = PROBLEMS | {
    OFTEN: (short_cart(beta=1.0), Task(np.array([1.0, 0.8]), np.array([1.4, 0.0])))
}


@cache
def exact(name: str) -> Exact:
    problem, task = OF_MANY_LENGTHS[name]
    return enumerate_exactly(problem, *task)


def roll(policy: LookAhead, task: Task, num_islands: int, num_particles: int, seed: int = 0):
    start, goal = (jnp.asarray(x, jnp.float32) for x in task)
    return smc_rollout(policy, start, goal, jax.random.key(seed), num_islands, num_particles)


@pytest.mark.parametrize("name", OF_MANY_LENGTHS)
@pytest.mark.parametrize("weight", [0.0, -0.2, 0.1])
def test_every_island_estimates_z_without_bias(name: str, weight: float) -> None:
    problem, task = OF_MANY_LENGTHS[name]
    found = roll(Guess(problem, weight), task, 800, 16)
    share_ended = (np.asarray(found.trajectory.length) < problem.mdp.num_steps).mean()
    assert (share_ended > 0.5) == (name == OFTEN)
    assert len(np.unique(np.asarray(found.root)[:16])) < 16
    islands = np.asarray(found.log_weight).reshape(800, 16)
    ratio = np.exp(islands.astype(float) - exact(name).log_partition).mean(axis=1)
    error = ratio.std() / math.sqrt(len(ratio))
    assert 0.001 < error < 0.1
    assert ratio.mean() == pytest.approx(1.0, abs=STANDARD_ERRORS * error)


@pytest.mark.parametrize("name", PROBLEMS)
def test_paths_are_followed_back(name: str) -> None:
    """What is kept of each survivor is what its actions do: states, reward, probability, length."""
    problem, task = PROBLEMS[name]
    policy = Guess(problem, -5.0)
    found = roll(policy, task, 2, 60)
    path, mdp = found.trajectory, problem.mdp
    goal = jnp.asarray(task.goal, jnp.float32)
    assert len(np.unique(np.asarray(found.root)[:60])) < 50
    for k in range(0, 120, 9):
        state, reward, log_probability = jnp.asarray(task.start, jnp.float32), 0.0, 0.0
        for step in range(int(path.length[k])):
            np.testing.assert_allclose(path.states[step, :, k], state, atol=1e-5)
            action = path.actions[step, k]
            log_probability += policy(state, jnp.int32(step), goal)[action]
            taken = take_step(problem, state, action, step, goal)
            state, reward = taken.state, reward + taken.reward
        last = int(path.length[k])
        assert last == mdp.num_steps or mdp.terminated(state, goal)
        for rest in range(last, mdp.num_steps + 1):
            np.testing.assert_allclose(path.states[rest, :, k], state, atol=1e-5)
        assert path.total_reward[k] == pytest.approx(float(reward), abs=1e-4)
        assert path.log_probability[k] == pytest.approx(float(log_probability), abs=1e-4)


def test_without_resampling_weights_are_those_of_importance_sampling() -> None:
    problem, task = PROBLEMS["ends-early"]
    [policy] = learn(problem, "grid?num_points=121").policies(np.array(task.goal)[None])  # pyright: ignore
    found = roll(policy, task, 4, 100)
    np.testing.assert_array_equal(found.root, np.tile(np.arange(100), 4))
    expected = log_weights(problem.record, found.trajectory)
    np.testing.assert_allclose(found.log_weight, expected, atol=1e-4)


def test_systematic_resampling_keeps_shares_to_one_particle() -> None:
    generator = np.random.default_rng(0)
    for offset in (0.0, 0.3, 0.999):
        weight = generator.exponential(size=64) ** 3
        chosen = np.asarray(_systematic(jnp.asarray(weight, jnp.float32), jnp.float32(offset)))
        counts = np.bincount(chosen, minlength=64)
        assert np.abs(counts - 64 * weight / weight.sum()).max() < 1.0 + 1e-4
        assert (np.diff(chosen) >= 0).all()


@pytest.mark.parametrize("name", PROBLEMS)
def test_evidence_agrees_with_enumeration(name: str) -> None:
    problem, task = PROBLEMS[name]
    weight = -0.4 if name == "pendulum" else 0.1  # such that there is something to resample
    evidence = sample(Guessed(problem, weight), task, 20_000, method="smc")
    assert evidence.distinct_share[0] < 0.9
    assert_within_errors(evidence, exact(name))


def test_islands_larger_than_a_chunk_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swerve.sampling.one_task.MAX_CHUNK", 300)
    problem, task = PROBLEMS["ends-early"]
    evidence = sample(Guessed(problem, 0.1), task, 19_990, method="smc")
    assert evidence.num_trajectories == 20 * 4 * 250
    root = evidence.samples.ancestor[0]
    assert (root // 250 == np.arange(20_000) // 250).all()
    assert evidence.distinct_share[0] < 0.9
    assert_within_errors(evidence, exact("ends-early"))


@pytest.mark.parametrize(("name", "weight"), [("ends-early", 0.1), ("pendulum", -0.4)])
def test_errors_of_resampled_trajectories_are_as_large_as_stated(name: str, weight: float) -> None:
    """The spread of 40 answers is what each says; for independent ones it would be 2.5 times less.

    At the pendulum, that is: the cart's are resampled less.
    """
    problem, task = PROBLEMS[name]
    policy = Guessed(problem, weight)
    runs = [sample(policy, task, 600, method="smc", seed=seed) for seed in range(40)]
    found = np.array([run.violation_probability[0] for run in runs])
    is_open = np.abs(found.mean(axis=0) - 0.5) < 0.4
    stated = np.sqrt(np.mean([run.summary.avoid_variance[0] for run in runs], axis=0))
    assert np.count_nonzero(is_open) >= 3
    np.testing.assert_allclose(found.std(axis=0)[is_open], stated[is_open], rtol=0.4)


def test_a_value_is_weighed_like_a_policy_where_it_is_exact() -> None:
    problem, task = PROBLEMS["pendulum"]
    nominal = learn(problem, "grid?num_points=121")
    smc, importance = (sample(nominal, task, 4_000, method=m) for m in ("smc", "importance"))
    assert smc.distinct_share[0] == importance.distinct_share[0] == 1.0
    assert smc.log_partition[0] == pytest.approx(importance.log_partition[0], abs=2e-3)
    assert np.ptp(smc.island_log_partition) < 0.05


def test_both_routes_are_found_without_a_value() -> None:
    problem = routes(Routes(toll=1.0))
    evidence = sample(Guessed(problem), TASK, 20_000, method="smc")
    above = evidence.violation_probability[0, 0]
    error = math.sqrt(evidence.summary.avoid_variance[0, 0])
    assert error < 0.02
    assert above == pytest.approx(share_above(problem), abs=STANDARD_ERRORS * error)


def test_numbers_are_rounded_up_to_whole_islands() -> None:
    problem, task = PROBLEMS["pendulum"]
    assert sample(Guessed(problem), task, 101, method="smc").num_trajectories == 120


def test_what_cannot_be_done_is_said() -> None:
    problem, task = PROBLEMS["pendulum"]
    evidence = sample(Guessed(problem), task, 100, method="smc")
    with pytest.raises(ValueError, match="sampled by 'smc' cannot be weighed by 'plain'"):
        evidence.weighted("plain")
    lattice = routes(LatticeRoutes(toll=1.0))
    with pytest.raises(ValueError, match=r"'smc' needs a solver with a soft value .*got 'tabular'"):
        sample(Planted(lattice, lattice), TASK, 100, method="smc")
