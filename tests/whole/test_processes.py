"""Several processes and threads: what is sent arrives whole, and a fork is refused at once."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import joblib
import numpy as np
import pytest
from support import workers
from support.every_solver import GRID, TASK, TINY, push

import swerve
from swerve.base.store import StoreError
from swerve.problem.loading import load_problem

EVIDENCE = workers.made(0)
NOMINAL: Any = swerve.learn(push(), GRID)


def in_disc(states):
    return jnp.sum(states**2, axis=-1) < 1.0


TESTS = Path(__file__).parents[1]
CONSTRAINTS = [
    swerve.Box(x=(0.0, 1.0)),
    swerve.ActionBox(force=(0.0, 1.0)),
    swerve.HalfSpace(0.5, x=1.0),
    swerve.Polygon([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], ("x", "v")),
    swerve.Occupancy("map", [[True, False]], (0.0, 0.0), 0.5, ("x", "v")),
]


DISC = swerve.Predicate("disc", in_disc)


@pytest.fixture(scope="module")
def foresight() -> swerve.Foresight:
    return swerve.foresee(NOMINAL, EVIDENCE, num_trajectories=256, num_updates=1)


@pytest.fixture(scope="module")
def values(foresight: swerve.Foresight) -> dict[str, Any]:
    """One value of every public class that a user may send to a worker."""
    problem = push()
    demonstrations = swerve.demonstrate(problem, swerve.Box(x=(-1.9, -1.5)), [TASK] * 3)
    inference = swerve.infer(EVIDENCE, demonstrations)
    monitor = swerve.Monitor(EVIDENCE, TASK, foresight)
    belief = monitor.observe(TASK.start)
    corner, world = swerve.Task([0, 0], [2, 2]), swerve.Gridworld(3, 3, 12)
    cells = swerve.Problem(world, world.hypotheses(), beta=3.0, measure="counting")
    tabular, paths = swerve.learn(cells, "tabular"), swerve.learn(cells, "soft-paths")
    exact = [swerve.sample(nominal, corner) for nominal in (tabular, paths)]  # and what is kept
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        trained: Any = swerve.learn(problem, f"soft-value?{TINY}")
    swerve.sample(trained, TASK, 40)
    return {
        "Problem": problem,
        "MDP": problem.mdp,
        "MDP of arrays": swerve.tabular([[0, 1], [1, 0]], [0.0, 1.0], num_steps=2),
        "Task": TASK,
        "Evidence": EVIDENCE,
        "Evidence of some tasks": EVIDENCE.select([0]),
        "Evidence of other beta": EVIDENCE.at_beta(1.2),
        "Evidence joined": EVIDENCE.joined(EVIDENCE),
        "Evidence exact": exact[0],
        "Inference": inference,
        "Picks": swerve.greedy(inference, most=1),
        "Pair": swerve.best_pair(swerve.infer(EVIDENCE, demonstrations, tolerance=0.01)),
        "Demonstrations": demonstrations,
        "Foresight": foresight,
        "Rollouts": swerve.Rollouts(NOMINAL, 20),
        "Monitor": monitor,
        "Monitor by rollouts": swerve.Monitor(EVIDENCE, TASK, swerve.Rollouts(NOMINAL, 20)),
        "Belief": belief,
        "Course": swerve.follow(swerve.Monitor(EVIDENCE, TASK, foresight), demonstrations[0]),
        "Nominal of a grid": NOMINAL,
        "Nominal trained": trained,
        "Nominal tabular": tabular,
        "Nominal of paths": paths,
        "Nominal discrete": swerve.learn(problem, "discrete?num_cells=9"),
        "Nominal enumerated": swerve.learn(problem, "enumeration"),
        "Solver": swerve.PPO(),
        "Constraints": [*CONSTRAINTS, *(problem.hypotheses.constraint(k) for k in range(3))],
        "Sets": [swerve.grid(x=(0.0, 1.0, 2)), swerve.windows(x=(0.0, 1.0, 0.2))],
        "Space": problem.mdp.space,
    }


def sent(value: Any) -> Any:
    """Return a value as another process would get it."""
    return pickle.loads(pickle.dumps(value))  # noqa: S301  # our own


def test_every_public_value_is_pickled_and_copied(values: dict[str, Any]) -> None:
    """Texts are compared: of arrays and of what a value says of itself, without addresses."""
    for name, value in values.items():
        for again in (sent(value), copy.deepcopy(value)):
            assert type(again) is type(value), name
            if " at 0x" not in repr(value):
                assert repr(again) == repr(value), name


def test_the_error_of_a_damaged_file_is_pickled(tmp_path: Path) -> None:
    """Else a pool of processes ends, or waits for ever, in place of telling it."""
    (tmp_path / "damaged.evidence").write_bytes(b"x" * 50)
    with pytest.raises(StoreError) as caught:
        swerve.Evidence.load(tmp_path / "damaged.evidence")
    again = sent(caught.value)
    assert type(again) is StoreError
    assert str(again) == str(caught.value)


def test_what_was_pickled_gives_the_same_answers(values: dict[str, Any]) -> None:
    again = sent(values)
    for name in (name for name in values if name.startswith("Evidence")):
        before, after = values[name], again[name]
        assert after.digest == before.digest
        assert swerve.infer(after).to_json() == swerve.infer(before).to_json()
        for one, other in zip(after.samples, before.samples, strict=True):
            np.testing.assert_array_equal(one, other)
    assert again["Inference"].to_json() == values["Inference"].to_json()
    assert again["Inference"].warnings == values["Inference"].warnings
    corner = swerve.Task([0, 0], [2, 2])
    for name in (name for name in values if name.startswith("Nominal")):
        task = corner if name in ("Nominal tabular", "Nominal of paths") else TASK
        one, other = (swerve.sample(found[name], task, 100) for found in (values, again))
        np.testing.assert_array_equal(one.log_ratio, other.log_ratio, err_msg=name)
    for name in ("Monitor", "Monitor by rollouts"):
        state = np.array([-0.4, 0.1])
        one, other = (found[name].observe(state) for found in (values, again))
        np.testing.assert_array_equal(one.hypotheses, other.hypotheses)


def test_evidence_of_a_file_is_pickled_with_its_trajectories(tmp_path: Path) -> None:
    EVIDENCE.save(tmp_path / "evidence")
    loaded = swerve.Evidence.load(tmp_path / "evidence")
    text = pickle.dumps(loaded)
    (tmp_path / "evidence").unlink()
    again = pickle.loads(text)  # noqa: S301  # our own
    for one, other in zip(again.samples, EVIDENCE.samples, strict=True):
        np.testing.assert_array_equal(one, other)


def test_threads_give_the_same_as_one_after_another() -> None:
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(workers.sampled, [3, 4]))
    assert together == [workers.sampled(3), workers.sampled(4)]


@pytest.fixture(scope="module")
def alone() -> list[tuple[float, str]]:
    return [workers.sampled(3), workers.sampled(4)]


@pytest.mark.parametrize("way", ["spawn", "forkserver", "joblib"])
def test_processes_of_their_own_give_the_same(
    way: str, alone: list[tuple[float, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(TESTS))
    if way == "joblib":
        run: Any = joblib.Parallel(n_jobs=1 + len(alone) // 2)
        found = run(joblib.delayed(workers.made)(seed) for seed in (3, 4))
        told = run(joblib.delayed(workers.headline)(evidence) for evidence in found)
    else:
        context = multiprocessing.get_context(way)
        with ProcessPoolExecutor(2, mp_context=context) as pool:
            found = list(pool.map(workers.made, [3, 4]))
            told = list(pool.map(workers.headline, found))
    assert [float(evidence.log_partition[0]) for evidence in found] == [one for one, _ in alone]
    assert told == [one for _, one in alone]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning", "ignore:.*fork:DeprecationWarning")
class TestFork:
    def test_what_runs_jax_is_refused_at_once(self, tmp_path: Path) -> None:
        demonstrations = swerve.demonstrate(push(), swerve.Box(x=(-1.9, -1.5)), TASK)
        problem, inference = NOMINAL.problem, swerve.infer(EVIDENCE)
        calls = [
            partial(push),
            partial(load_problem, "pendulum"),
            partial(swerve.learn, problem, GRID),
            partial(swerve.sample, NOMINAL, TASK, 200),
            partial(swerve.sample, swerve.learn(problem, "enumeration"), TASK),
            partial(swerve.resolve, NOMINAL, inference),
            partial(swerve.fit_beta, problem, EVIDENCE, demonstrations),
            partial(swerve.divergence, problem, demonstrations, np.zeros(1)),
            partial(swerve.demonstrate, problem, swerve.Box(x=(-1.9, -1.5)), TASK),
            partial(swerve.foresee, NOMINAL, EVIDENCE),
            partial(swerve.Rollouts, NOMINAL),
            partial(swerve.draw_tasks, problem, 1),
            partial(DISC.contains, np.zeros((1, 2)), problem.mdp.space),
            partial(swerve.load_nominal, tmp_path / "nominal", problem),
        ]
        swerve.save_nominal(tmp_path / "nominal", NOMINAL)
        assert DISC.contains(np.zeros((1, 2)), problem.mdp.space).all()
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as pool:
            found = [pool.submit(workers.outcome, call).result(timeout=60) for call in calls]
        for call, text in zip(calls, found, strict=True):
            assert text.startswith("RuntimeError: this process was forked"), call
            assert "get_context('spawn') or 'forkserver', or with joblib" in text

    def test_inference_works(self) -> None:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as pool:
            found = pool.submit(workers.outcome, workers.headline, EVIDENCE).result(timeout=60)
        assert found == swerve.infer(EVIDENCE).headline

    def test_a_fork_before_jax_has_run_is_free(self) -> None:
        code = (
            "import os, sys, swerve, swerve.base.forked\n"
            "if child := os.fork():\n"
            "    sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
            "from support.workers import sampled\n"
            "print(*sampled(0))\n"
        )
        run = subprocess.run(
            [sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True, check=False
        )
        assert (run.returncode, run.stderr) == (0, "")
        log_partition, headline = workers.sampled(0)
        assert run.stdout == f"{log_partition} {headline}\n"
