"""Tasks are matched as by comparing all with all, without comparing all with all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.synthetic import make_record

from swerve.base.space import TWO_PI, Task
from swerve.evidence import matching

GOALS = {"states": ("theta", "x"), "number": ("height",), "nothing": ()}
THETA = [0.0, TWO_PI, np.pi, 3.0, -1.0, 50.0]
THETA_OFF = [0.0, 1e-3, -2e-3, 0.99e-3 * TWO_PI, 1.01e-3 * TWO_PI, -3.0 * TWO_PI]
X_OFF = [0.0, -0.0, 0.0099, 0.0101, -0.0099]


def crowded(generator: np.random.Generator, num: int, goal: str) -> Task:
    """Tasks of which many are the same, or just not the same."""
    theta, x = generator.choice(THETA, num), generator.choice([0.0, 1.0], num)
    states = [theta + generator.choice(THETA_OFF, num), x + generator.choice(X_OFF, num)]
    start = np.stack(states, axis=1)
    if goal == "number":
        return Task(start, generator.choice([0.0, 9e-4, 1e3, 1000.9, 1001.1], (num, 1)))
    return Task(start, start[::-1] if goal == "states" else np.zeros((num, 0)))


@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("at_once", [1, 30, 100_000])
def test_the_nearest_and_first_is_found(
    goal: str, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matching, "AT_ONCE", at_once)
    record = make_record(goal_names=GOALS[goal])
    num_found = 0
    for seed in range(20):
        generator = np.random.default_rng(seed)
        known, tasks = crowded(generator, 60, goal), crowded(generator, 80, goal)
        number, distance = matching.nearest(record, known, tasks)
        is_same = distance <= matching.MATCH_TOLERANCE
        found = matching.find_each(record, known, tasks)
        np.testing.assert_array_equal(found, np.where(is_same, number, -1))
        num_found += int(is_same.sum())
    assert 100 < num_found < 20 * 80
    generator = np.random.default_rng(20)
    known, nothing = crowded(generator, 60, goal), crowded(generator, 0, goal)
    assert matching.find_each(record, known, nothing).shape == (0,)


def test_equal_are_tasks_of_the_very_same_numbers() -> None:
    near, goal = np.nextafter(1.0, 2.0), np.zeros((4, 1))
    known = Task(np.array([[0.0], [1.0], [2.0], [3.0]]), goal)
    tasks = Task(np.array([[2.0], [near], [1.0], [3.0]]), np.array([[0.0], [0.0], [0.0], [1e-9]]))
    assert matching.find_equal(known, tasks).tolist() == [2, -1, 1, -1]
    assert matching.find_equal(known, Task(np.zeros((0, 1)), goal[:0])).shape == (0,)


@pytest.mark.parametrize("goal", GOALS)
def test_each_joins_the_nearest_of_those_that_came_first(goal: str) -> None:
    record, num_joined = make_record(goal_names=GOALS[goal]), 0
    for seed in range(20):
        tasks, known, numbers = crowded(np.random.default_rng(seed), 80, goal), [0], []
        for row in range(80):
            of_known, each = (Task(*(part[at] for part in tasks)) for at in (known, row))
            number, distance = matching.nearest(record, of_known, each)
            is_same = distance <= matching.MATCH_TOLERANCE
            numbers.append(known[int(number)] if is_same else row)
            known += [] if is_same else [row]
            num_joined += int(is_same and not np.array_equal(of_known.start[number], each.start))
        np.testing.assert_array_equal(matching.group_each(record, tasks), numbers)
    assert num_joined > 100


@pytest.mark.parametrize("varied", ["theta", "x", "goal"])
def test_tasks_that_differ_are_not_all_compared(
    varied: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 3,000 tasks that differ in one number alone, in any order."""
    num, compared = 3000, []
    part, column = ("goal", 1) if varied == "goal" else ("start", ("theta", "x").index(varied))
    known = Task(np.ones((num, 2)), np.ones((num, 2)))
    width = 100.0 if column else TWO_PI
    values = np.random.default_rng(0).permutation(np.linspace(0.0, width, num, endpoint=False))
    getattr(known, part)[:, column] = values
    distance = matching._distance

    def counting(problem: Any, one: Task, other: Task) -> np.ndarray:
        compared.append(max(len(one.start), len(other.start)))
        return distance(problem, one, other)

    monkeypatch.setattr(matching, "_distance", counting)
    order = np.random.default_rng(1).permutation(num)
    tasks = Task(*(values[order] for values in known))
    names = [f"demo_{k}" for k in range(num)]
    found = matching.match_each(make_record(), known, tasks, names)
    np.testing.assert_array_equal(found, order)
    assert sum(compared) < 60 * num
    compared.clear()
    grouped = matching.group_each(make_record(), tasks)
    assert len(np.unique(grouped)) > 500
    assert sum(compared) < 120 * num
