"""Maximum-entropy PPO: its parts against plain arithmetic, the whole against enumeration."""

from __future__ import annotations

import math
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)
from support.training import assert_resumes

from swerve import PPO, Box, Problem, Task, learn, load_nominal, sample, save_nominal
from swerve.evidence.estimators import kl_divergence
from swerve.solvers.trained import losses
from swerve.solvers.trained.lanes import fresh_lanes
from swerve.solvers.trained.ppo import PPOTrainer
from swerve.solvers.trained.training import TrainedNominal

SMALL = PPO(
    num_steps=1_000_000,
    num_lanes=128,
    segment=16,
    num_minibatches=4,
    width=32,
    learning_rate=1e-2,
)
TINY = PPO(num_steps=40_960, num_lanes=16, segment=8, num_minibatches=2, width=8)
STANDARD_ERRORS = 4.5


def test_advantages_are_discounted_sums_of_residuals() -> None:
    generator = np.random.default_rng(0)
    reward, value, last = (generator.normal(size=shape) for shape in ((6, 3), (6, 3), (3,)))
    ended = np.zeros((6, 3), bool)
    ended[2, 1] = ended[5, 0] = True
    later = np.where(ended, 0.0, np.vstack([value[1:], last]))
    expected = np.zeros((6, 3))
    for lane in range(3):
        for step in range(6):
            weight = 1.0
            for t in range(step, 6):
                expected[step, lane] += weight * (reward[t, lane] + later[t, lane] - value[t, lane])
                if ended[t, lane]:
                    break
                weight *= 0.7
    residual = jnp.asarray(reward + later - value)
    result = losses.discounted(residual, jnp.asarray(ended), 0.7)
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-5)


def test_without_clip_the_best_policy_is_the_soft_improvement() -> None:
    """The expected surrogate has no slope at pi_old exp(advantage), normalised."""
    old = jnp.log(jnp.array([0.2, 0.5, 0.3]))
    advantage = jnp.array([0.4, -0.2, 0.1])

    def expected_loss(logits: jax.Array) -> jax.Array:
        new = jax.nn.log_softmax(logits)
        each = [
            losses.policy_loss(new, old, jnp.int32(a), advantage[a], clip=1e9) for a in range(3)
        ]
        return jnp.exp(old) @ jnp.stack(each)

    best = old + advantage
    np.testing.assert_allclose(jax.grad(expected_loss)(best), 0.0, atol=1e-6)
    assert np.abs(jax.grad(expected_loss)(old)).max() > 0.01


def test_disasters_are_cut_and_nothing_else() -> None:
    advantage, scale = jnp.array([-100.0, -4.0, 50.0, -100.0]), jnp.array([1.0, 1.0, 1.0, 31.0])
    np.testing.assert_array_equal(losses.bounded(advantage, scale), [-5.0, -4.0, 50.0, -100.0])


def test_clip_stops_the_surrogate_from_rewarding_large_steps() -> None:
    old = jnp.log(jnp.array([0.5, 0.5]))

    def slope(probability: float) -> float:
        def loss(p: jax.Array) -> jax.Array:
            new = jnp.log(jnp.stack([p, 1 - p]))
            clipped = losses.policy_loss(new, old, jnp.int32(0), jnp.float32(1.0), clip=0.2)
            return clipped - jnp.sum(jnp.exp(new) * (new - old))

        return float(jax.grad(loss)(jnp.float32(probability)))

    assert slope(0.55) == pytest.approx(-2.0)
    assert slope(0.65) == pytest.approx(0.0, abs=1e-6)


def test_new_episodes_begin_where_they_can() -> None:
    """Outside known constraints and where the episode is not over, the shares kept."""
    wall = Box(x=(-0.2, 0.9))
    problem = short_cart(known=[wall])
    lanes = fresh_lanes(problem, jax.random.key(3), 400, explore=0.25)
    states = np.asarray(lanes.state).T
    assert not wall.contains(states, problem.mdp.space).any()
    assert not jax.vmap(problem.mdp.terminated)(lanes.state.T, lanes.goal.T).any()
    assert 0.15 < (np.asarray(lanes.step) > 0).mean() < 0.3
    assert len(np.unique(states, axis=0)) > 150
    drawn = fresh_lanes(problem, jax.random.key(3), 400, explore=1.0)
    assert len(np.unique(np.asarray(drawn.step))) > 1


@pytest.mark.parametrize("output", [-3.0, -0.5, 0.2, 2.5])
def test_slope_of_the_value_is_the_divisor_of_its_loss(output: float) -> None:
    def value(x):
        return losses.value_of_output(x, 10.0)

    slope = float(jax.grad(value)(output))
    assert slope == pytest.approx(10.0 * float(losses.loss_scale(value(output), 10.0)), rel=1e-4)


@pytest.mark.parametrize("error", [-5.0, -1.0, 0.0, 1.5, 4.0])
def test_huber(error: float) -> None:
    size = abs(error)
    expected = 0.5 * size**2 if size <= 2.0 else 2.0 * (size - 1.0)
    assert float(losses.huber(jnp.float32(error))) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("problem", "task", "largest_kl", "least_ess"),
    [
        (short_pendulum(), PENDULUM_TASK, 0.15, 0.7),
        (short_pendulum(measure="counting", between_states=False), PENDULUM_TASK, 0.15, 0.7),
        (short_cart(), CART_TASK, 0.1, 0.8),
        (short_cart(measure="counting"), CART_TASK, 0.1, 0.8),
        (short_cart(known=[Box(x=(-0.2, 0.3), v=(-0.9, 0.1))]), CART_TASK, 1.0, 0.05),
    ],
    ids=["uniform", "counting", "ends-early", "ends-early-counting", "known"],
)
def test_agrees_with_enumeration(
    problem: Problem, task: Task, largest_kl: float, least_ess: float
) -> None:
    """One policy trained for random tasks is near pi_0, and its weights make up for the rest."""
    exact = enumerate_exactly(problem, task.start, task.goal)
    evidence = sample(learn(problem, SMALL), task, 20_000, seed=1)
    ess = evidence.effective_sample_size[0]
    assert ess > least_ess * 20_000
    divergence = kl_divergence(evidence.importance_log_weight[0], exact.log_partition)
    assert -0.02 < divergence < largest_kl
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / ess
    difference = evidence.violation_probability[0] - exact.violation_probability
    assert np.abs(difference / error).max() < STANDARD_ERRORS
    assert evidence.log_partition[0] == pytest.approx(
        exact.log_partition, abs=STANDARD_ERRORS / math.sqrt(ess) + 1e-3
    )


def test_entropy_is_part_of_the_objective() -> None:
    """At next to no beta only the entropy speaks: the policy stays uniform, and is pi_0."""
    evidence = sample(learn(short_pendulum(beta=1e-6), SMALL), PENDULUM_TASK, 2_000)
    assert evidence.kl[0] < 0.01
    assert evidence.effective_sample_size[0] > 0.98 * 2_000


@cache
def tiny() -> TrainedNominal:
    """For all tests to which it does not matter how well it is trained."""
    nominal = learn(short_pendulum(), TINY, seed=3)
    assert isinstance(nominal, TrainedNominal)
    return nominal


def test_resumed_training_gives_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nominal = tiny()
    train = partial(learn, nominal.problem, nominal.solver)
    assert_resumes(train, tmp_path / "ppo.checkpoint", monkeypatch)


def test_saved_nominal_samples_the_same(tmp_path: Path) -> None:
    nominal = tiny()
    save_nominal(tmp_path / "ppo.nominal", nominal)
    restored = load_nominal(tmp_path / "ppo.nominal", nominal.problem)
    assert restored.solver == TINY
    a, b = (sample(n, PENDULUM_TASK, 200).samples for n in (nominal, restored))
    np.testing.assert_array_equal(a.log_probability, b.log_probability)
    np.testing.assert_array_equal(a.violations, b.violations)


def test_nominal_of_another_problem_is_refused(tmp_path: Path) -> None:
    save_nominal(tmp_path / "ppo.nominal", tiny())
    with pytest.raises(ValueError, match="nominal distribution of another problem"):
        load_nominal(tmp_path / "ppo.nominal", short_pendulum(beta=0.9))


def test_training_is_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    traces = []
    iterate = PPOTrainer.iterate

    def counted(self, state, x):
        traces.append(1)
        return iterate(self, state, x)

    monkeypatch.setattr(PPOTrainer, "iterate", counted)
    learn(short_pendulum(), TINY, seed=3)
    assert TINY.num_chunks > 10
    assert len(traces) == 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"num_steps": 0}, "num_steps: expected a whole number >= 1, got 0"),
        (
            {"num_lanes": 10, "num_minibatches": 4},
            "num_minibatches: expected a divisor of num_lanes",
        ),
        ({"explore": 1.5}, "explore: expected a number from 0 to 1, got 1.5"),
        ({"gae_lambda": -0.1}, "gae_lambda: expected a number from 0 to 1, got -0.1"),
        ({"clip": 0.0}, "clip: expected a finite number > 0, got 0"),
        ({"learning_rate": math.nan}, "learning_rate: expected a finite number > 0, got nan"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PPO(**settings)
