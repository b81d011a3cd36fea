"""Near-certain violations: ratios down to one in millions against enumeration."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.command import Run
from support.reference import CART_TASK, enumerate_exactly, short_cart

from swerve import (
    Box,
    Demonstration,
    Evidence,
    Grid,
    Inference,
    Nominal,
    Problem,
    SoftValue,
    Task,
    Union,
    infer,
    learn,
    resolve,
    sample,
    write_demonstrations,
)
from swerve.constraints.base import violates
from swerve.sampling.resolve import _is_likely
from swerve.solvers.trained.soft_value import SoftValuePolicy, least_value
from swerve.solvers.trained.training import TrainedNominal
from swerve.work.settings import Settings
from swerve.work.work import Work

RARE = 17  # 5e-6 of the nominal trajectories avoid this cell
TRAINED = SoftValue(num_steps=1_000_000, num_lanes=256, segment=8, width=64, num_minibatches=2)


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
    evidence = sample(nominal, CART_TASK, 2_000, method="smc", seed=1)
    before = infer(evidence, [demonstration])
    assert before.is_open[0, RARE]
    assert before.is_lower_bound[RARE]
    after = infer(resolve(nominal, infer(evidence, [demonstration])), [demonstration])
    assert not after.is_lower_bound[RARE]
    assert after.evidence.log_ratio[0, RARE] == pytest.approx(truth, abs=math.log(1.2))
    assert after.evidence.standard_error[0, RARE] < 0.09
    assert after.log_likelihood[RARE] == -after.evidence.log_ratio[0, RARE]
    others = np.flatnonzero(~before.is_open[0])
    np.testing.assert_array_equal(
        after.evidence.log_ratio[0, others], evidence.log_ratio[0, others]
    )


def with_few_that_avoid(evidence: Evidence, number: float) -> Evidence:
    """Evidence in which so many trajectories avoid the rare hypothesis."""
    share = number * evidence.resolution[0]
    values = {"avoid_probability": share, "avoid_variance": share**2 / number}
    changed = {name: getattr(evidence.summary, name).copy() for name in values}
    for name, value in values.items():
        changed[name][0, RARE] = value
    return dataclasses.replace(evidence, summary=evidence.summary._replace(**changed))


class TestFew:
    """1 of 2,000 trajectories avoids it, as one evidence of a hundred has it, 5 nats off; or 3."""

    @pytest.fixture
    def nominal(self) -> Nominal:
        return learn(rare_cart, "grid?num_points=121")

    @pytest.fixture
    def evidence(self, nominal: Nominal) -> Evidence:
        return sample(nominal, CART_TASK, 2_000, method="smc")

    @pytest.fixture
    def made(self) -> list[Demonstration]:
        return [round_about(rare_cart, RARE)]

    def test_a_lone_one_is_not_believed(
        self, nominal: Nominal, evidence: Evidence, made: list[Demonstration]
    ) -> None:
        lone = with_few_that_avoid(evidence, 1)
        before = infer(lone, made)
        assert not before.is_lower_bound[RARE]
        assert before.is_open[0, RARE]
        resolved = resolve(nominal, infer(lone, made))
        truth = exact_log_ratio(rare_cart, RARE)
        assert resolved.log_ratio[0, RARE] == pytest.approx(truth, abs=math.log(1.2))
        assert not infer(resolved, made).is_open.any()

    def test_three_are_believed_where_a_ratio_contradicts_them(
        self, nominal: Nominal, evidence: Evidence, made: list[Demonstration]
    ) -> None:
        three = with_few_that_avoid(evidence, 3)
        assert infer(three, made).is_open[0, RARE]
        resolved = resolve(nominal, infer(three, made))
        result = infer(resolved, made)
        assert result.log_likelihood[RARE] == pytest.approx(-math.log(3.0 * evidence.resolution[0]))
        assert not result.is_open.any()
        (warning,) = [text for text in result.warnings if "did not settle" in text]
        assert warning.startswith(f"the score of hypothesis {RARE} rests on the two or three")

    def test_four_are_enough(self, evidence: Evidence, made: list[Demonstration]) -> None:
        assert not infer(with_few_that_avoid(evidence, 4.01), made).is_open[0, RARE]

    @pytest.mark.parametrize(
        ("seen", "expected", "likely"),
        [
            *((0, 0.01, True), (0, 6.8, True), (0, 7.0, False)),
            *((1, 0.0011, True), (1, 9e-4, False), (1, 9.2, True), (1, 9.3, False)),
            *((3, 0.2, True), (3, 0.18, False), (3, 14.0, False)),
        ],
    )
    def test_ratios_are_held_against_the_few(
        self, evidence: Evidence, seen: int, expected: float, likely: bool
    ) -> None:
        """Poisson: P(0 of 6.9) = P(1 or more of 0.001) = P(3 or more of 0.19) = 0.001."""
        of_few = with_few_that_avoid(evidence, seen) if seen else evidence
        log_ratio = math.log(expected * evidence.resolution[0])
        assert _is_likely(of_few, 0, RARE, log_ratio) == likely

    def test_nothing_is_worked_out_from_what_is_not_to_be_trusted(
        self, evidence: Evidence, made: list[Demonstration]
    ) -> None:
        assert infer(evidence, made).is_open[0, RARE]
        summary = evidence.summary._replace(effective_sample_size=np.array([99.0]))
        assert not infer(dataclasses.replace(evidence, summary=summary), made).is_open.any()


def test_a_task_where_nothing_is_left_does_not_spoil_another() -> None:
    """From x = 0.6 everybody enters at once, from x = -0.9 some go round."""
    hypotheses = [Union("around", [Box(x=(0.0, 0.59)), Box(x=(0.61, 2.0))]), Box(v=(0.9, 1.4))]
    problem = dataclasses.replace(rare_cart, hypotheses=hypotheses)
    nominal = learn(problem, "grid?num_points=61")
    away = Task(np.array([-0.9, 1.5]), np.array([0.9, 0.5]))
    evidence = sample(nominal, [CART_TASK, away], 1_000, method="importance")
    is_open = infer(evidence).is_open[:, 0]
    assert is_open[0]
    assert is_open[1]
    resolved = resolve(nominal, infer(evidence, []))
    assert resolved.is_resolved[:, 0].tolist() == [False, True]
    narrower = dataclasses.replace(problem, known=[problem.hypotheses.constraint(0)])
    truth = enumerate_exactly(narrower, *away).log_partition
    truth -= enumerate_exactly(problem, *away).log_partition
    assert resolved.log_ratio[1, 0] == pytest.approx(truth, abs=math.log(1.2))


def test_what_was_resolved_is_kept(tmp_path: Path) -> None:
    problem = rare_cart
    demonstration = round_about(problem, RARE)
    nominal = learn(problem, "grid?num_points=61")
    evidence = resolve(nominal, infer(sample(nominal, CART_TASK, 500), [demonstration]))
    assert evidence.is_resolved[0, RARE]
    evidence.save(tmp_path / "evidence")
    again = Evidence.load(tmp_path / "evidence")
    np.testing.assert_array_equal(again.log_ratio, evidence.log_ratio)
    np.testing.assert_array_equal(again.is_resolved, evidence.is_resolved)


def test_the_work_folder_resolves_once(tmp_path: Path) -> None:
    demonstration, said = round_about(rare_cart, RARE), []

    def rank() -> Inference:
        settings = Settings("grid?num_points=61", num_trajectories=500)
        work = Work(f"{__file__}:rare_cart", tmp_path / "work", settings, say=said.append)
        result = infer(work.evidence(Task.stack([CART_TASK])), [demonstration])
        return infer(work.resolved(result), [demonstration])

    first = rank()
    assert not first.is_lower_bound[RARE]
    assert any("resolving" in line and first.hypothesis_name(RARE) in line for line in said)
    said.clear()
    assert rank().log_likelihood[RARE] == first.log_likelihood[RARE]
    assert not said


def test_the_command_leaves_bounds_where_it_is_told_to(tmp_path: Path, run: Run) -> None:
    demonstration = round_about(rare_cart, RARE)
    files = write_demonstrations(tmp_path / "made", [demonstration], rare_cart.mdp.space)
    ask = ("infer", f"{__file__}:rare_cart", *files, "--tasks", tmp_path / "made/tasks.csv")
    is_bound = []
    for more in ((), ("--no-resolve", "--resolve-seconds", 1e-3)):
        settings = ("--solver", "grid?num_points=61", "--samples", 500, "--json")
        status, out, said = run(*ask, *settings, *more)
        assert status == 0, said
        [row] = [row for row in json.loads(out)["ranking"] if row["index"] == RARE]
        is_bound.append(row["is_lower_bound"])
        told = "--no-resolve leaves their scores as bounds; without it they are worked out"
        assert (told in said) == bool(more)
        assert not more or "--resolve-seconds" not in said  # more time would not help
    assert is_bound == [False, True]


def test_a_bound_remains_where_nothing_avoids_it() -> None:
    """Nobody who starts at x = 0.6 stays there: at once they are in what lies all around."""
    cart = short_cart(beta=2.0)
    around = Union("around", [Box(x=(-2.0, 0.59)), Box(x=(0.61, 2.0))])
    problem = dataclasses.replace(cart, hypotheses=[around, Box(v=(0.9, 1.4))])
    nominal = learn(problem, "grid?num_points=61")
    evidence = sample(nominal, CART_TASK, 500)
    inference = infer(evidence)
    assert inference.is_open[0, 0]
    resolved = resolve(nominal, infer(evidence, []))
    assert not resolved.is_resolved[0, 0]
    assert resolved.log_ratio[0, 0] == evidence.log_ratio[0, 0]
    assert not infer(resolved).is_open.any()  # tried once is enough
    assert not any("did not settle" in text for text in infer(evidence).warnings)
    in_vain = r"Sampling with hypothesis 0 in force did not settle it: .* more num_points"
    assert any(re.search(in_vain, text) for text in infer(resolved).warnings)


def test_what_cannot_be_done_is_said() -> None:
    problem = rare_cart
    nominal = learn(problem, "enumeration")
    evidence = sample(nominal, CART_TASK)
    with pytest.raises(ValueError, match=r"soft value that adapts \(grid, soft-value\), got 'enum"):
        resolve(nominal, infer(evidence, []))
    other = learn(short_cart(beta=1.0), "grid?num_points=61")
    with pytest.raises(ValueError, match="the evidence is of another problem"):
        resolve(other, infer(evidence, []))


def test_who_has_to_enter_lies_a_hundred_nats_below_the_worst() -> None:
    """The network has to follow the cliff, which at -10,000 nats it could not."""
    nominal = learn(rare_cart, TRAINED)
    assert isinstance(nominal, TrainedNominal)
    assert isinstance(nominal.policy, SoftValuePolicy)
    trap = Box(x=(0.65, 9.0))  # too close to brake before it
    narrower = dataclasses.replace(rare_cart, known=[trap])
    worst = least_value(nominal.policy, 0)
    adapted = next(iter(TRAINED.adapted(nominal, narrower, 0))).policy
    assert isinstance(adapted, SoftValuePolicy)
    assert worst < 0.0
    floor = worst - 100.0
    assert adapted.settings.floor == pytest.approx(floor)
    again = dataclasses.replace(narrower, known=[trap, Box(x=(-9.0, -1.6))])
    nominal = dataclasses.replace(nominal, problem=narrower, policy=adapted)
    further = next(iter(TRAINED.adapted(nominal, again, 0))).policy
    assert isinstance(further, SoftValuePolicy)
    assert further.settings.floor == adapted.settings.floor
    goal = jnp.asarray(CART_TASK.goal, jnp.float32)
    doomed, free = (
        float(adapted.value(jnp.array(state), jnp.array(1), goal))
        for state in ([0.62, 1.2], [-0.5, 0.0])
    )
    assert floor - 1e-3 < doomed < floor + 60.0  # float32
    assert free > worst
