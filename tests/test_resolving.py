"""Near-certain violations: ratios down to one in millions against enumeration."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from reference import CART_TASK, enumerate_exactly, short_cart

from swerve import (
    Box,
    Demonstration,
    Evidence,
    Grid,
    Inference,
    Problem,
    SoftValue,
    Task,
    Union,
    infer,
    learn,
    resolve,
    sample,
)
from swerve.constraints import violates
from swerve.settings import Settings
from swerve.work import Work

RARE = 17  # 5e-6 of the nominal trajectories avoid this cell
TRAINED = SoftValue(num_steps=2_000_000, num_lanes=256, segment=8, width=64, num_minibatches=2)


rare_cart = short_cart(beta=2.0)


def exact_log_ratio(problem: Problem, index: int) -> float:
    """log Z_c / Z_0 by two enumerations, with c in force and without."""
    constraint = problem.hypotheses.constraint(index)
    narrower = dataclasses.replace(problem, known=[*problem.known, constraint])
    return float(
        enumerate_exactly(narrower, *CART_TASK).log_partition
        - enumerate_exactly(problem, *CART_TASK).log_partition
    )


def round_about(problem: Problem, index: int) -> Demonstration:
    """A demonstration that avoids a hypothesis: the most rewarding of random ones that do."""
    generator = np.random.default_rng(0)
    mdp, constraint = problem.mdp, problem.hypotheses.constraint(index)
    for _ in range(2_000):
        states = [np.asarray(CART_TASK.start, np.float32)]
        for action in generator.choice(np.asarray(mdp.actions), size=mdp.num_steps):
            following = mdp.dynamics(jnp.asarray(states[-1]), action)
            states.append(np.asarray(following))
            if bool(mdp.terminated(following, CART_TASK.goal)):
                break
        path = np.array(states, float)
        if not violates(constraint, path, mdp.space, problem.between_states):
            return Demonstration("round", path, CART_TASK)
    raise AssertionError("nothing avoids it")


@pytest.mark.parametrize("solver", [Grid(num_points=121), TRAINED], ids=["grid", "soft-value"])
def test_one_in_hundred_thousands_is_told_within_a_fifth(solver: Grid | SoftValue) -> None:
    problem = rare_cart
    truth = exact_log_ratio(problem, RARE)
    assert 1e-6 < math.exp(truth) < 1e-5
    demonstration = round_about(problem, RARE)
    nominal = learn(problem, solver)
    evidence = sample(nominal, CART_TASK, 2_000, method="smc")
    before = infer(evidence, [demonstration])
    assert before.is_open[0, RARE]
    assert before.is_lower_bound[RARE]
    after = infer(resolve(nominal, evidence, [demonstration]), [demonstration])
    assert not after.is_lower_bound[RARE]
    assert after.evidence.log_ratio[0, RARE] == pytest.approx(truth, abs=math.log(1.2))
    assert after.evidence.standard_error[0, RARE] < 0.15
    assert after.log_likelihood[RARE] == -after.evidence.log_ratio[0, RARE]
    others = np.flatnonzero(~before.is_open[0])
    np.testing.assert_array_equal(
        after.evidence.log_ratio[0, others], evidence.log_ratio[0, others]
    )


def test_a_task_where_nothing_is_left_does_not_spoil_another() -> None:
    """From x = 0.6 everybody enters at once, from x = -0.9 some go round."""
    hypotheses = [Union("around", [Box(x=(0.0, 0.59)), Box(x=(0.61, 2.0))]), Box(v=(0.9, 1.4))]
    problem = dataclasses.replace(rare_cart, hypotheses=hypotheses)
    nominal = learn(problem, "grid?num_points=61")
    away = Task(np.array([-0.9, 1.5]), np.array([0.9, 0.5]))
    evidence = sample(nominal, [CART_TASK, away], 1_000)
    is_open = infer(evidence).is_open[:, 0]
    assert is_open[0]
    assert is_open[1]
    resolved = resolve(nominal, evidence, [])
    assert resolved.is_resolved[:, 0].tolist() == [False, True]
    narrower = dataclasses.replace(problem, known=[problem.hypotheses.constraint(0)])
    truth = enumerate_exactly(narrower, *away).log_partition
    truth -= enumerate_exactly(problem, *away).log_partition
    assert resolved.log_ratio[1, 0] == pytest.approx(truth, abs=math.log(1.2))


def test_what_was_resolved_is_kept(tmp_path: Path) -> None:
    problem = rare_cart
    demonstration = round_about(problem, RARE)
    nominal = learn(problem, "grid?num_points=61")
    evidence = resolve(nominal, sample(nominal, CART_TASK, 500), [demonstration])
    assert evidence.is_resolved[0, RARE]
    evidence.save(tmp_path / "evidence")
    again = Evidence.load(tmp_path / "evidence")
    np.testing.assert_array_equal(again.log_ratio, evidence.log_ratio)
    np.testing.assert_array_equal(again.is_resolved, evidence.is_resolved)


def test_the_work_folder_resolves_once(tmp_path: Path) -> None:
    demonstration, said = round_about(rare_cart, RARE), []

    def rank() -> Inference:
        settings = Settings("grid?num_points=61", num_trajectories=500)
        work = Work("test_resolving:rare_cart", tmp_path / "work", settings, say=said.append)
        result = infer(work.evidence(Task.stack([CART_TASK])), [demonstration])
        return infer(work.resolved(result), [demonstration])

    first = rank()
    assert not first.is_lower_bound[RARE]
    assert any("resolving" in line and first.hypothesis_name(RARE) in line for line in said)
    said.clear()
    assert rank().log_likelihood[RARE] == first.log_likelihood[RARE]
    assert not said


def test_a_bound_remains_where_nothing_avoids_it() -> None:
    """Nobody who starts at x = 0.6 stays there: at once they are in what lies all around."""
    cart = short_cart(beta=2.0)
    around = Union("around", [Box(x=(-2.0, 0.59)), Box(x=(0.61, 2.0))])
    problem = dataclasses.replace(cart, hypotheses=[around, Box(v=(0.9, 1.4))])
    nominal = learn(problem, "grid?num_points=61")
    evidence = sample(nominal, CART_TASK, 500)
    inference = infer(evidence)
    assert inference.is_open[0, 0]
    resolved = resolve(nominal, evidence, [])
    assert not resolved.is_resolved[0, 0]
    assert resolved.log_ratio[0, 0] == evidence.log_ratio[0, 0]
    assert not infer(resolved).is_open.any()  # tried once is enough


def test_what_cannot_be_done_is_said() -> None:
    problem = rare_cart
    nominal = learn(problem, "enumeration")
    evidence = sample(nominal, CART_TASK)
    with pytest.raises(ValueError, match=r"soft value that adapts \(grid, soft-value\), got 'enum"):
        resolve(nominal, evidence, [])
    other = learn(short_cart(beta=1.0), "grid?num_points=61")
    with pytest.raises(ValueError, match="the evidence is of another problem"):
        resolve(other, evidence, [])
