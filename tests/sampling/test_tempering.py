"""Tempering: against enumeration at the other beta, from policies that are right and rough."""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from support.guesses import Fixed, Guessed
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)
from support.short_problems import OF_ISLANDS, WALL, assert_within_errors

from swerve import Box, Problem, infer, learn, sample
from swerve.evidence.estimators import LOW_ESS
from swerve.evidence.samples import NUM_ISLANDS
from swerve.sampling.tempering import _next_step

PROBLEMS = {
    "pendulum": (short_pendulum(beta=0.05), PENDULUM_TASK),
    "ends-early": (short_cart(beta=0.5), CART_TASK),
    "counting": (short_cart(beta=0.5, measure="counting"), CART_TASK),
    "known": (short_cart(beta=0.5, known=[WALL]), CART_TASK),
}


def at_beta(problem: Problem, beta: float) -> Problem:
    return dataclasses.replace(problem, beta=beta)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("factor", [0.2, 3.0])
def test_agrees_with_enumeration_at_the_other_beta(name: str, factor: float) -> None:
    problem, task = PROBLEMS[name]
    beta = factor * problem.beta
    evidence = sample(Guessed(problem, -0.05), task, 10_000, beta=beta)
    assert evidence.method == "tempered"
    assert evidence.problem.fingerprint == at_beta(problem, beta).record.fingerprint
    assert_within_errors(evidence, enumerate_exactly(at_beta(problem, beta), *task))


def test_temperatures_come_between_where_weights_would_collapse() -> None:
    """Where Theorem 2 alone leaves a few of 4,000 samples, and is off, tempering is right."""
    problem, task = PROBLEMS["ends-early"]
    truth = enumerate_exactly(at_beta(problem, 20.0), *task)
    nominal = learn(problem, "grid?num_points=61")
    weighed = sample(nominal, task, 4_000).at_beta(20.0)
    tempered = sample(nominal, task, 4_000, beta=20.0)
    assert weighed.effective_sample_size[0] < LOW_ESS
    assert tempered.effective_sample_size[0] > LOW_ESS
    error = [
        np.abs(evidence.violation_probability[0] - truth.violation_probability).max()
        for evidence in (weighed, tempered)
    ]
    assert error[1] < 0.05
    spread = tempered.island_log_partition[0].std() / math.sqrt(NUM_ISLANDS)
    assert spread < 0.3
    assert tempered.log_partition[0] == pytest.approx(truth.log_partition, abs=OF_ISLANDS * spread)


def test_a_beta_next_door_is_as_good_as_weighing() -> None:
    problem, task = PROBLEMS["pendulum"]
    nominal = learn(problem, "grid?num_points=61")
    weighed = sample(nominal, task, 10_000).at_beta(0.06)
    tempered = sample(nominal, task, 10_000, beta=0.06)
    np.testing.assert_allclose(
        tempered.violation_probability, weighed.violation_probability, atol=0.03
    )


def test_verdict_says_what_is_left() -> None:
    problem, task = PROBLEMS["ends-early"]
    evidence = sample(learn(problem, "grid?num_points=61"), task, 200, beta=500.0)
    result = infer(evidence)
    assert "effective sample size" in result.verdict(0)
    [said] = [text for text in result.warnings if "effective sample size" in text]
    assert said.endswith("sample more, or learn at a beta nearer to 500")


def test_what_cannot_be_done_is_said() -> None:
    problem, task = PROBLEMS["pendulum"]
    with pytest.raises(ValueError, match="beta: expected a finite number > 0, got -1"):
        sample(Guessed(problem), task, 100, beta=-1.0)
    with pytest.raises(
        ValueError, match="is the only one for a beta that was not learned, so leave 'plain' out"
    ):
        sample(Guessed(problem), task, 100, beta=1.0, method="plain")
    with pytest.raises(ValueError, match="expected one of smc, importance, plain, got 'tempered'"):
        sample(Guessed(problem), task, 100, method="tempered")
    with pytest.raises(ValueError, match="the enumeration solver gives exact answers for the"):
        sample(learn(problem, "enumeration"), task, 100, beta=1.0)


class Blind(eqx.Module):
    """Every action alike, also into known constraints."""

    problem: Problem = eqx.field(static=True)

    def __call__(self, state: Array, step: Array, goal: Array) -> Array:
        num_actions = self.problem.mdp.num_actions
        return jnp.full(num_actions, -math.log(num_actions))


def test_dead_islands_do_not_slow_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """They would weigh as if their reward were 0, which no other trajectory comes near."""
    seen = []

    def next_step(reward: np.ndarray, rest: float) -> float:
        seen.append(reward)
        return _next_step(reward, rest)

    monkeypatch.setattr("swerve.sampling.tempering._next_step", next_step)
    problem = short_cart(beta=0.5, known=[Box(x=(0.2, 0.5), v=(-2.0, -0.2))])
    evidence = sample(Fixed(Blind(problem)), CART_TASK, 20, beta=5.0)
    num_alive = np.isfinite(evidence.island_log_partition).sum()
    assert 0 < num_alive < NUM_ISLANDS
    assert all(len(reward) == num_alive and (reward < 0.0).all() for reward in seen)
