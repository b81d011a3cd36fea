"""A start that by the grid nobody gets out of: this is said, and its stand-in is never a number.

With an even number of nodes along v none lies between the known walls at +-0.05, so that all nodes
are closed. Who does not push stays at v = 0 all the same.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.command import Run
from support.reference import short_cart

from swerve import Box, Demonstration, Evidence, Nominal, Task, infer, learn, sample
from swerve.simulation.continuation import continued
from swerve.simulation.policies import LOWEST

walled = dataclasses.replace(short_cart(beta=2.0), known=[Box(v=(0.05, 9.0)), Box(v=(-9.0, -0.05))])
TASK = Task(np.array([0.6, 0.0]), np.array([-0.5, 0.0]))
SOLVER = "grid?num_points=20"
SAID = "by the solver's soft value, known constraints close the start in"


@pytest.fixture(scope="module")
def nominal() -> Nominal:
    return learn(walled, SOLVER)


@pytest.mark.parametrize("method", ["smc", "importance"])
def test_it_is_said_and_no_number_is_shown(nominal: Nominal, method: str, tmp_path: Path) -> None:
    evidence = sample(nominal, TASK, 20_000, method=method)
    assert np.isneginf(evidence.soft_value).all()
    assert np.isfinite(evidence.log_partition).all()
    evidence.save(tmp_path / "evidence")
    assert np.isneginf(Evidence.load(tmp_path / "evidence").soft_value).all()
    waits = Demonstration("waits", np.repeat(TASK.start[None], 8, axis=0), TASK)
    result = infer(evidence, [waits])
    assert sum(SAID in warning for warning in result.warnings) == 1
    assert result.verdict(0) == f"errors may be larger than stated: {SAID}"
    result.report(tmp_path / "report.html")
    shown = [*result.warnings, json.dumps(result.to_json()), (tmp_path / "report.html").read_text()]
    assert not any("100000000" in text.replace(",", "") for text in shown)


def test_the_command_says_it(run: Run, tmp_path: Path) -> None:
    (tmp_path / "tasks.csv").write_text("demo,start_x,start_v,goal_x,goal_v\n0,0.6,0,-0.5,0\n")
    words = ("--tasks", tmp_path / "tasks.csv", "--samples", 20_000, "--work", tmp_path / "work")
    status, out, said = run("sample", f"{__file__}:walled", "--solver", SOLVER, *words)
    assert status == 0, said
    assert f"warning: errors may be larger than stated: {SAID} for 1 of 1 tasks" in said
    assert "give it more num_points" in said
    assert "00000.00" not in out + said


def test_a_finer_grid_has_a_value(tmp_path: Path) -> None:
    evidence = sample(learn(walled, "grid?num_points=61"), TASK, 2_000)
    assert math.isfinite(evidence.soft_value[0])
    assert not any(SAID in warning for warning in infer(evidence).warnings)


def test_weights_of_continuations_keep_their_digits(nominal: Nominal) -> None:
    """In float32, 1e8 nats more would leave no digit of the rest."""
    (policy,) = nominal.policies(TASK.goal[None])  # pyright: ignore[reportAttributeAccessIssue]
    starts = jnp.asarray(np.repeat(TASK.start[:, None], 500, axis=1), jnp.float32)
    goal = jnp.asarray(TASK.goal, jnp.float32)
    found = continued(walled, policy, starts, jnp.int32(0), goal, jax.random.key(0))
    weight = np.asarray(found.log_weight[0], float)
    assert np.isfinite(weight).any()
    assert weight.max() < -LOWEST + 100.0
