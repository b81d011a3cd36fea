"""The soft value solver against enumeration; how it resumes, stops and fails."""

from __future__ import annotations

import dataclasses
import math
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)
from support.routes import TASK, Routes, routes, share_above
from support.training import assert_resumes

from swerve import Box, SoftValue, Task, learn, load_nominal, sample, save_nominal
from swerve.solvers.trained.probe import Progress
from swerve.solvers.trained.soft_value import PATIENCE
from swerve.solvers.trained.training import TrainedNominal

STANDARD_ERRORS = {"importance": 4.5, "smc": 6.1}  # 20 islands: as unlikely by Student's t
NUM = 20_000
SMALL = SoftValue(num_steps=600_000, num_lanes=256, segment=8, num_minibatches=2, width=32)
TINY = SoftValue(num_steps=8_000, num_lanes=16, segment=8, width=8)
WALL = Box(x=(0.2, 0.5), v=(-2.0, -0.6))
PROBLEMS = {
    "pendulum": (short_pendulum(), PENDULUM_TASK),
    "ends-early": (short_cart(), CART_TASK),
    "counting": (short_cart(measure="counting"), CART_TASK),
    "known": (short_cart(known=[WALL]), CART_TASK),
}


@cache
def learned(name: str) -> TrainedNominal:
    nominal = learn(PROBLEMS[name][0], SMALL)
    assert isinstance(nominal, TrainedNominal)
    return nominal


@cache
def tiny() -> TrainedNominal:
    nominal = learn(short_pendulum(), TINY, seed=3)
    assert isinstance(nominal, TrainedNominal)
    return nominal


@pytest.mark.parametrize("method", ["smc", "importance"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_agrees_with_enumeration(name: str, method: str) -> None:
    problem, task = PROBLEMS[name]
    truth = enumerate_exactly(problem, *task)
    evidence = sample(learned(name), task, NUM, method=method)
    ess = evidence.effective_sample_size[0]
    assert ess > {"smc": 0.2, "importance": 0.5}[method] * NUM
    assert evidence.kl[0] < 0.2
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / ess
    difference = evidence.violation_probability[0] - truth.violation_probability
    is_open = (truth.violation_probability > 0.1) & (truth.violation_probability < 0.9)
    assert np.count_nonzero(is_open) >= 3
    assert np.abs(difference / error).max() < STANDARD_ERRORS[method]
    assert evidence.log_partition[0] == pytest.approx(truth.log_partition, abs=0.03)


def test_one_network_is_for_every_start_and_goal() -> None:
    problem, _ = PROBLEMS["ends-early"]
    tasks = [Task([0.3, 0.3], [-0.2, 0.2]), Task([-1.0, 0.5], [1.0, 0.0]), Task([1.2, 0.0], [0, 0])]
    evidence = sample(learned("ends-early"), tasks, 4_000, method="importance")
    for k, task in enumerate(tasks):
        truth = enumerate_exactly(problem, *(np.asarray(x, float) for x in task))
        exact_kl = truth.log_partition - evidence.importance_log_weight[k].mean()
        assert exact_kl < 0.2


@cache
def spanning() -> TrainedNominal:
    """One network for beta from a half to twice the problem's."""
    solver = dataclasses.replace(SMALL, num_steps=1_000_000, beta_span=2.0)
    nominal = learn(short_cart(beta=1.0), solver)
    assert isinstance(nominal, TrainedNominal)
    return nominal


@pytest.mark.parametrize("beta", [0.5, 1.0, 1.6, 2.0])
def test_one_network_is_for_a_span_of_beta(beta: float) -> None:
    truth = enumerate_exactly(short_cart(beta=beta), *CART_TASK)
    evidence = sample(spanning(), CART_TASK, 10_000, beta=beta)
    assert evidence.method == "smc"
    assert evidence.problem.fingerprint == short_cart(beta=beta).record.fingerprint
    weighed = sample(spanning().at_beta(beta), CART_TASK, 10_000, method="importance")
    assert truth.log_partition - weighed.importance_log_weight.mean() < 0.2
    assert weighed.soft_value[0] == pytest.approx(truth.log_partition, abs=0.3)
    assert evidence.log_partition[0] == pytest.approx(truth.log_partition, abs=0.03)
    np.testing.assert_allclose(
        evidence.violation_probability[0], truth.violation_probability, atol=0.03
    )


def test_another_beta_is_stored_and_read(tmp_path: Path) -> None:
    nominal = spanning().at_beta(1.6)
    save_nominal(tmp_path / "nominal", nominal)
    again = load_nominal(tmp_path / "nominal", short_cart(beta=1.6))
    first, second = (sample(each, CART_TASK, 500) for each in (nominal, again))
    np.testing.assert_allclose(first.log_weight, second.log_weight, atol=1e-4)


def test_beyond_the_span_samples_are_tempered() -> None:
    with pytest.raises(ValueError, match=r"expected one from 0.5 to 2, which the soft value was"):
        spanning().at_beta(3.0)
    assert sample(spanning(), CART_TASK, 500, beta=3.0).method == "tempered"
    with pytest.raises(ValueError, match="beta: expected a finite number > 0, got 0"):
        spanning().at_beta(0.0)
    with pytest.raises(ValueError, match=r"beta_span: expected a number >= 1, got 0.5"):
        SoftValue(beta_span=0.5)


def test_both_routes_are_found() -> None:
    problem = routes(Routes(toll=1.0))
    evidence = sample(learn(problem, SMALL), TASK, NUM)
    error = math.sqrt(evidence.summary.avoid_variance[0, 0]) + 1e-3
    assert error < 0.02
    above = evidence.violation_probability[0, 0]
    assert above == pytest.approx(share_above(problem), abs=STANDARD_ERRORS["smc"] * error)


def test_resumed_training_gives_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nominal = tiny()
    train = partial(learn, nominal.problem, nominal.solver)
    assert_resumes(train, tmp_path / "soft.checkpoint", monkeypatch)


def test_saved_nominal_samples_the_same(tmp_path: Path) -> None:
    nominal, path = tiny(), tmp_path / "soft.nominal"
    save_nominal(path, nominal)
    restored = load_nominal(path, nominal.problem)
    assert isinstance(restored, TrainedNominal)
    np.testing.assert_array_equal(restored.history, nominal.history)
    a, b = (sample(n, PENDULUM_TASK, 200).samples for n in (nominal, restored))
    np.testing.assert_array_equal(a.log_probability, b.log_probability)
    with pytest.raises(ValueError, match="nominal distribution of another problem"):
        load_nominal(path, short_pendulum(beta=0.9))


def test_training_has_settled_when_the_divergence_stops_improving() -> None:
    falling = [Progress(0.0, 0.0, 1.0 / (1 + k), 1.0, 1.0, 0.1) for k in range(PATIENCE + 5)]
    flat = [*falling, *[falling[-1]] * PATIENCE]
    assert not TINY.has_settled(falling)
    assert not TINY.has_settled(flat[:-1])
    assert TINY.has_settled(flat)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"num_lanes": 0}, "num_lanes: expected a whole number >= 1, got 0"),
        ({"trace": 1.5}, "trace: expected a number from 0 to 1, got 1.5"),
        ({"fade": 0.0}, "fade: expected a finite number > 0, got 0"),
        ({"floor": 1.0}, "floor: expected a number from -10000 to below 0, got 1.0"),
        ({"floor": -1e5}, "floor: expected a number from -10000"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SoftValue(**settings)
