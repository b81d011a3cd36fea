"""Resolving within a time: what comes first, what is left, and what is said of it.

The clock is one of the tests, and an estimate takes as long as the test says.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import Run
from support.reference import CART_TASK, short_cart

from swerve import Box, Demonstration, Evidence, Nominal, Task, infer, learn, resolve, sample
from swerve import write_demonstrations as write
from swerve.inference.ranking import Ranking
from swerve.inference.unresolved import worth_resolving
from swerve.sampling import resolve as resolving
from swerve.work.settings import Settings
from swerve.work.work import Work

BACK = (-1.0, 0.0)  # m/s: everybody goes back to the goal
HYPOTHESES = [
    Box(v=(2.5, 3.0)),
    *(Box(x=interval, v=BACK) for interval in ((0.0, 0.5), (0.5, 1.0), (0.1, 0.55), (0.0, 0.58))),
]
cart = dataclasses.replace(short_cart(beta=2.0), hypotheses=HYPOTHESES)
SOLVER = "grid?num_points=21"
TAKES = 10.0  # s, by the clock of the tests, of each estimate


class Estimates:
    """Stands in for the estimates, and for the clock that they move."""

    def __init__(self) -> None:
        self.now = 50.0
        self.tried: list[int] = []
        self.in_vain: set[int] = set()

    def clock(self) -> float:
        return self.now

    def ratio(
        self, nominal: Nominal, evidence: Evidence, index: int, seed: int, deadline: float
    ) -> tuple[np.ndarray, np.ndarray]:
        self.now += TAKES
        self.tried.append(index)
        error = math.inf if index in self.in_vain else 0.05
        return np.full(evidence.num_tasks, -12.0 - index), np.full(evidence.num_tasks, error)


@pytest.fixture
def estimates(monkeypatch: pytest.MonkeyPatch) -> Estimates:
    found = Estimates()
    monkeypatch.setattr(resolving, "monotonic", found.clock)
    monkeypatch.setattr(resolving, "_ratio", found.ratio)
    return found


@pytest.fixture(scope="module")
def nominal() -> Nominal:
    return learn(cart, SOLVER)


@pytest.fixture(scope="module")
def evidence(nominal: Nominal) -> Evidence:
    return sample(nominal, CART_TASK, 500, seed=1)


def waiting() -> list[Demonstration]:
    """A demonstration that stays where it starts, and enters next to nothing."""
    return [Demonstration("waits", np.repeat(CART_TASK.start[None], 4, axis=0), CART_TASK)]


def test_the_best_come_first_and_the_time_ends_it(
    nominal: Nominal, evidence: Evidence, estimates: Estimates
) -> None:
    before = infer(evidence, waiting())
    order = worth_resolving(before).tolist()
    assert len(order) >= 3
    told: list[Evidence] = []
    found = resolve(nominal, before, seconds=1.5 * TAKES, keep=told.append)
    assert estimates.tried == order[:2]
    assert len(told) == 2
    after = infer(found, waiting())
    assert set(worth_resolving(after).tolist()) == set(order[2:])
    assert not any("did not settle" in text for text in after.warnings)
    again = resolve(nominal, after)
    assert estimates.tried[:2] == order[:2]
    assert set(estimates.tried[2:]) == set(order[2:])
    assert worth_resolving(infer(again, waiting())).size == 0


def test_with_time_enough_the_answer_is_that_without_a_limit(
    nominal: Nominal, evidence: Evidence, estimates: Estimates
) -> None:
    before = infer(evidence, waiting())
    limited = resolve(nominal, before, seconds=1e6)
    unlimited = resolve(nominal, before)
    in_two = resolve(nominal, infer(resolve(nominal, before, seconds=TAKES), waiting()))
    for other in (limited, in_two):
        for name, values in unlimited.summary._asdict().items():
            np.testing.assert_array_equal(getattr(other.summary, name), values, name)


def test_one_estimate_is_made_however_little_time_there_is(
    nominal: Nominal, evidence: Evidence, estimates: Estimates
) -> None:
    resolve(nominal, infer(evidence, waiting()), seconds=1e-9)
    assert len(estimates.tried) == 1


def test_one_estimate_is_made_where_choosing_it_takes_all_the_time(
    nominal: Nominal, evidence: Evidence, estimates: Estimates, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(ranking: Ranking) -> np.ndarray:
        estimates.now += TAKES
        return worth_resolving(ranking)

    monkeypatch.setattr(resolving, "worth_resolving", slowly)
    before = infer(evidence, waiting())
    found = resolve(nominal, before, seconds=0.5 * TAKES)
    assert estimates.tried == worth_resolving(before)[:1].tolist()
    assert found.is_resolved.any()


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan, "10", None])
def test_a_time_that_is_none_is_refused(nominal: Nominal, evidence: Evidence, seconds: Any) -> None:
    with pytest.raises(ValueError, match="seconds: expected a number of seconds > 0, got"):
        resolve(nominal, infer(evidence, waiting()), seconds=seconds)


def test_only_what_was_tried_did_not_settle(
    nominal: Nominal, evidence: Evidence, estimates: Estimates
) -> None:
    before = infer(evidence, waiting())
    first, *others = [k for k in worth_resolving(before).tolist() if before.is_lower_bound[k]]
    assert others
    estimates.in_vain = {first}
    found = infer(resolve(nominal, before, seconds=TAKES), waiting())
    assert estimates.tried == [first]
    [warning] = [text for text in found.warnings if "only a lower bound" in text]
    assert f"Sampling with hypothesis {first} in force did not settle it" in warning
    named = "were not tried" if len(others) > 1 else "was not tried"
    assert f"hypothesis {others[0]}" in warning.split("did not settle it")[1]
    remedy = "swerve.resolve does this, and so does swerve infer without --no-resolve, as far as"
    assert f"{named} with the hypothesis in force: {remedy} the time goes" in warning


def test_a_task_that_was_not_tried_is_left_open(
    nominal: Nominal, evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time runs out after the first of two tasks, which another round might have settled."""
    estimates = Estimates()

    def settled(nominal: Nominal, task: Task, seed: int) -> None:
        estimates.now += TAKES

    monkeypatch.setattr(resolving, "monotonic", estimates.clock)
    monkeypatch.setattr(resolving, "_settled", settled)
    other = sample(nominal, Task(CART_TASK.start, CART_TASK.goal + 0.1), 500, seed=1)
    both = evidence.joined(other)
    _, error = resolving._ratio(nominal, both, 1, 0, estimates.now + 0.5 * TAKES)
    assert np.isnan(error).tolist() == [True, True]
    _, error = resolving._ratio(nominal, both, 1, 0, math.inf)
    assert np.isposinf(error).tolist() == [True, True]


def commanded(tmp_path: Path) -> tuple[object, ...]:
    """Return the arguments of an inference from the demonstration."""
    files = write(tmp_path / "made", waiting(), cart.mdp.space)
    ask = ("infer", f"{__file__}:cart", *files, "--tasks", tmp_path / "made/tasks.csv")
    return (*ask, "--solver", SOLVER, "--samples", 500, "--seed", 1)


def test_the_command_says_what_is_left_and_goes_on(
    tmp_path: Path, run: Run, estimates: Estimates
) -> None:
    ask = (*commanded(tmp_path), "--work", tmp_path / "work", "--json")
    status, _, said = run(*ask, "--resolve-seconds", 1.5 * TAKES)
    assert status == 0, said
    assert (
        "resolving how unlikely that is, best first, within 15 s (--resolve-seconds); --no" in said
    )
    num = len(estimates.tried)
    assert num == 2
    [left] = [line for line in said.splitlines() if line.startswith("left for want of time: ")]
    assert left.endswith("Give more --resolve-seconds, and the same --work to go on")
    status, out, said = run(*ask, "--resolve-seconds", "inf")
    assert status == 0
    assert "resolving how unlikely that is, best first; --no-resolve keeps" in said
    assert "left for want of time" not in said
    assert left.startswith(f"left for want of time: {len(estimates.tried) - num} of ")
    assert not set(estimates.tried[:num]) & set(estimates.tried[num:])
    assert not any(row["is_lower_bound"] for row in json.loads(out)["ranking"])


def test_work_without_a_folder_says_no_more_than_it_can(
    tmp_path: Path, estimates: Estimates
) -> None:
    said: list[str] = []
    settings = Settings(SOLVER, 1, num_trajectories=500)
    work = Work(f"{__file__}:cart", None, settings, say=said.append)
    result = infer(work.evidence(Task.stack([CART_TASK])), waiting())
    said.clear()
    work.resolved(result, 0.5 * TAKES)
    assert len(said) == 2 + any("learning" in line for line in said)
    assert said[-1].endswith("stay as the samples tell. Give more --resolve-seconds")
    names = [f"{k} ({result.hypothesis_name(k)})" for k in worth_resolving(result)[:1].tolist()]
    assert f"hardly any trajectory avoids {names[0]}" in said[0]


def test_a_bad_time_is_refused_before_the_work(tmp_path: Path, run: Run) -> None:
    for value in (0, -1):
        status, _, said = run(*commanded(tmp_path / str(value)), "--resolve-seconds", value)
        assert status == 1
        assert said.startswith("swerve: error: --resolve-seconds: expected a number > 0, got ")
