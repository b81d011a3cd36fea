"""What was compiled for a problem is used again while the problem lives, and goes with it."""

from __future__ import annotations

import gc
import pickle
import threading
import weakref
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from support.every_solver import GRID, TASK, TINY, push

import swerve
from swerve.simulation import compiled
from swerve.simulation.compiled import of_problem, padded


def traced() -> tuple[Any, list[Any]]:
    """Return a compiled function, and a list that grows with each trace of the function."""
    traces: list[Any] = []

    @of_problem
    def total(problem: swerve.Problem, values: Any, *, power: Any = 1) -> Any:
        traces.append(power)
        return problem.beta * jnp.sum(values["x"] ** power)

    return total, traces


class TestOfProblem:
    def test_is_compiled_once_for_each_form_of_the_arguments(self) -> None:
        total, traces = traced()
        problem, other = push(), push()
        values = np.array([1.0, 2.0], np.float32)
        for one in (problem, problem, other, other):
            assert total(one, {"x": values}) == 3.0
        assert len(traces) == 2  # once for each problem
        assert total(problem, {"x": values}, power=2) == 5.0
        assert total(problem, {"x": jnp.array(values) + 1.0}, power=2) == 13.0
        assert len(traces) == 3

    def test_tells_equal_numbers_of_different_kinds_apart(self) -> None:
        total, traces = traced()
        problem = push()
        for power in (1, 1.0, True, 1):
            total(problem, {"x": np.ones(2, np.float32)}, power=power)
        assert [type(power) for power in traces] == [int, float, bool]

    def test_keeps_a_limited_number(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(compiled, "MOST", 2)
        total, traces = traced()
        problem = push()
        for power in (1, 2, 3, 3, 2, 1):
            total(problem, {"x": np.ones(2, np.float32)}, power=power)
        assert traces == [1, 2, 3, 1]
        assert len(problem.compiled) == 2

    def test_makes_no_function_that_there_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        made, jit = [], compiled.jax.jit
        monkeypatch.setattr(compiled.jax, "jit", lambda function: made.append(1) or jit(function))
        total, _ = traced()
        problem = push()
        for _ in range(3):
            total(problem, {"x": np.ones(2, np.float32)})
        assert len(made) == 1

    def test_threads_add_one_after_another(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """While one looks for the oldest function, another one drops none."""
        monkeypatch.setattr(compiled, "MOST", 2)
        total, traces = traced()
        problem, values = push(), {"x": np.ones(2, np.float32)}
        has_added, jit = threading.Event(), compiled.jax.jit
        thread = threading.Thread(target=total, args=(problem, values), kwargs={"power": 9})

        def slow_jit(function: Any) -> Any:
            if threading.current_thread() is thread:
                has_added.wait(2.0)
            return jit(function)

        class Kept(dict):
            def __iter__(self) -> Any:
                found = super().__iter__()
                if thread.ident is None:
                    thread.start()
                    thread.join(0.3)
                return found

        monkeypatch.setattr(compiled.jax, "jit", slow_jit)
        problem.__dict__["compiled"] = Kept()
        for power in (1, 2, 3):
            total(problem, values, power=power)
        has_added.set()
        thread.join()
        assert sorted(traces) == [1, 2, 3, 9]
        assert len(problem.compiled) == 2

    def test_is_not_pickled(self) -> None:
        total, _ = traced()
        problem = push()
        total(problem, {"x": np.ones(2, np.float32)})
        again = pickle.loads(pickle.dumps(problem))  # noqa: S301  # our own
        assert (len(problem.compiled), len(again.compiled)) == (1, 0)


def test_padded_rows_come_in_few_numbers() -> None:
    rows = np.arange(10.0).reshape(5, 2)
    np.testing.assert_array_equal(padded(rows, 2)[:5], rows)
    assert {len(padded(np.zeros((num, 3)), 2)) for num in range(1, 129)} == {2, 16, 128}


def used(way: str) -> list[weakref.ref[Any]]:
    """Make a problem, use it in one way, and return weak references to the problem and its MDP."""
    problem = push()
    solvers = {"training": f"soft-value?{TINY}", "tempering": GRID, "foreseeing": GRID}
    nominal: Any = swerve.learn(problem, solvers.get(way, way))
    evidence = swerve.sample(nominal, TASK, 40, beta=1.2 if way == "tempering" else None)
    if way == "foreseeing":
        swerve.foresee(nominal, evidence, num_trajectories=256, num_updates=1)
    swerve.infer(evidence)
    return [weakref.ref(problem), weakref.ref(problem.mdp)]


@pytest.mark.filterwarnings("ignore:training came no nearer:RuntimeWarning")
@pytest.mark.parametrize(
    "way", [GRID, "enumeration", "discrete?num_cells=9", "tempering", "training", "foreseeing"]
)
def test_nothing_keeps_a_problem_that_is_no_longer_used(way: str) -> None:
    left = used(way)
    gc.collect()
    assert [reference() for reference in left] == [None, None]
