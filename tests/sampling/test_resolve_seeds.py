"""Each set is resolved by random numbers of its own, once, whatever hypotheses it is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.reference import enumerate_exactly
from support.small_mdps import Stroll

from swerve import Box, Demonstration, Evidence, Nominal, Problem, Task, infer, learn, resolve
from swerve import sample as sample_tasks
from swerve.sampling import resolve as resolving

TASK = Task([0.0], [3.0])
STAYS = Demonstration("stays", np.zeros((2, 1)), TASK)
RIGHT, NEARLY = Box(x=(0.7, 4.0)), Box(x=(0.7, 3.9))  # nobody gets as far as 3.5
HYPOTHESES = [RIGHT, NEARLY, Box(x=(0.7, 4.0)), Box(x=(3.6, 4.0))]


@pytest.fixture(scope="module")
def nominal() -> Nominal:
    return learn(Problem(Stroll(pull=2.0), HYPOTHESES), "grid?num_points=15")


@pytest.fixture(scope="module")
def evidence(nominal: Nominal) -> Evidence:
    return sample_tasks(nominal, TASK, 400)


def test_sets_that_differ_have_errors_of_their_own(nominal: Nominal, evidence: Evidence) -> None:
    """From the same random numbers, both would be off by the same; the posterior adds errors."""
    inference = infer(evidence, [STAYS])
    assert inference.is_open[0].tolist() == [True, True, True, False]
    found = resolve(nominal, inference)
    assert found.is_resolved[0].tolist() == [True, True, True, False]
    first, second = found.log_ratio[0, :2]
    error = found.standard_error[0, 0]
    assert 1e-4 < error < 0.09
    assert 1e-2 * error < abs(first - second) < 5.0 * error
    problem = nominal.problem
    within, without = (
        enumerate_exactly(each, np.array([0.0]), np.array([3.0])).log_partition
        for each in (dataclasses.replace(problem, known=[RIGHT]), problem)
    )
    np.testing.assert_allclose(found.log_ratio[0, :2], within - without, atol=4.0 * error)


def test_the_same_set_is_resolved_once(
    nominal: Nominal, evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[int] = []
    ratio = resolving._ratio

    def counting(*arguments: object) -> tuple[np.ndarray, np.ndarray]:
        tried.append(int(arguments[2]))  # pyright: ignore[reportArgumentType]
        return ratio(*arguments)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(resolving, "_ratio", counting)
    inference = infer(evidence, [STAYS] * 20)
    found = resolve(nominal, inference)
    assert sorted(tried) == [0, 1]
    for name in ("avoid_probability", "avoid_variance", "log_ratio", "log_ratio_error"):
        values = getattr(found.summary, name)
        assert values[0, 0] == values[0, 2] != values[0, 1], name
    by_itself = resolve(nominal, dataclasses.replace(inference, prior=np.eye(5)[3]))
    assert by_itself.log_ratio[0, 2] == found.log_ratio[0, 2]  # the same random numbers
    after = infer(found, [STAYS] * 20, prior=[0.0, 0.5, 0.0, 0.5, 0.0]).posterior
    np.testing.assert_allclose(after.hypotheses, [0.5, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(after.error, 0.0, atol=1e-9)
    assert math.isclose(after.none_error, 0.0, abs_tol=1e-9)
