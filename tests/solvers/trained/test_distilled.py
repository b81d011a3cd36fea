"""Direct policies distilled from soft values: against enumeration, and beside their teacher."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from support.reference import CART_TASK, enumerate_exactly, short_cart
from support.short_problems import assert_within_errors
from support.training import Interrupted, assert_resumes, weights

from swerve import PPO, Distilled, Grid, SoftValue, Task, learn, load_nominal, sample, save_nominal
from swerve.solvers.trained.distilled import DirectPolicy
from swerve.solvers.trained.soft_value import SoftValueTrainer
from swerve.solvers.trained.training import TrainedNominal
from swerve.work.settings import Settings
from swerve.work.work import Work

PROBLEM = short_cart()
TEACHER_SETTINGS = {"num_steps": 600_000, "num_lanes": 256, "segment": 8, "num_minibatches": 2}
TEACHER = SoftValue(**TEACHER_SETTINGS, width=32)
STUDENT = Distilled(num_steps=600_000, num_lanes=256, segment=8, num_minibatches=2, width=32)
SMALL_TEACHER = replace(TEACHER, num_steps=4_000)
TINY = Distilled(num_steps=8_000, num_lanes=16, segment=8, width=8)


@cache
def teacher() -> TrainedNominal:
    nominal = learn(PROBLEM, TEACHER)
    assert isinstance(nominal, TrainedNominal)
    return nominal


@cache
def student() -> TrainedNominal:
    return STUDENT.imitate(teacher())


def test_agrees_with_enumeration() -> None:
    evidence = sample(student(), CART_TASK, 20_000)
    assert evidence.method == "smc"
    assert evidence.effective_sample_size[0] > 4_000
    assert_within_errors(evidence, enumerate_exactly(PROBLEM, *CART_TASK))


def test_does_nearly_as_its_teacher_everywhere() -> None:
    tasks = [Task([0.3, 0.3], [-0.2, 0.2]), Task([-1.0, 0.5], [1.0, 0.0])]
    by_teacher, by_student = (
        sample(nominal, tasks, 4_000, method="importance") for nominal in (teacher(), student())
    )
    assert (by_teacher.kl < 0.1).all()
    assert (by_student.kl < by_teacher.kl + 0.2).all()
    np.testing.assert_allclose(by_student.soft_value, by_teacher.soft_value, atol=0.3)


def test_asks_one_network_once_a_step() -> None:
    policy = student().policy
    assert isinstance(policy, DirectPolicy)
    assert policy.network.weights[-1].shape[0] == PROBLEM.mdp.num_actions + 1


def test_saved_policy_samples_the_same(tmp_path: Path) -> None:
    save_nominal(tmp_path / "nominal", student())
    again = load_nominal(tmp_path / "nominal", PROBLEM)
    assert again.solver == STUDENT
    first, second = (sample(nominal, CART_TASK, 500) for nominal in (student(), again))
    np.testing.assert_array_equal(first.log_weight, second.log_weight)


def test_resumed_distillation_gives_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "distilled.checkpoint"
    assert_resumes(partial(TINY.imitate, teacher()), path, monkeypatch)
    another = learn(PROBLEM, SMALL_TEACHER)
    with pytest.raises(ValueError, match="checkpoint of another run: its teacher is"):
        TINY.imitate(another, seed=3, checkpoint=path)


def test_the_teacher_is_kept_when_learning_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "distilled.checkpoint"
    monkeypatch.setattr("swerve.solvers.trained.distilled.SoftValue", lambda: SMALL_TEACHER)

    def interrupted(*arguments: object, **settings: object) -> None:
        raise Interrupted

    with monkeypatch.context() as patched:
        patched.setattr(Distilled, "imitate", interrupted)
        with pytest.raises(Interrupted):
            learn(PROBLEM, TINY, checkpoint=path)
    assert path.with_name("distilled.checkpoint.teacher").exists()
    whole = learn(PROBLEM, TINY)
    monkeypatch.setattr(SoftValueTrainer, "run", interrupted)  # the teacher has learned already
    resumed = learn(PROBLEM, TINY, checkpoint=path)
    for name, array in weights(whole).items():
        np.testing.assert_array_equal(weights(resumed)[name], array)


def test_the_work_folder_distils_the_soft_value_that_it_holds(
    tmp_path: Path,
) -> None:
    text = f"soft-value?{'&'.join(f'{k}={v}' for k, v in TEACHER_SETTINGS.items())}"
    said: list[str] = []

    def work(solver: str) -> Work:
        return Work(f"{__name__}:PROBLEM", tmp_path, Settings(solver), say=said.append)

    work(text).nominal()
    student = work("distilled?num_steps=8000&num_lanes=16&segment=8&width=8")
    evidence = student.evidence(Task.stack([CART_TASK]))
    assert evidence.method == "smc"
    assert evidence.solver.startswith("Distilled(")
    assert sum("learning with soft-value" in line for line in said) == 1
    assert student.settings.solver == Work(f"{__name__}:PROBLEM", tmp_path).settings.solver


@pytest.mark.filterwarnings("ignore:training came no nearer to pi_0")  # a run this short
def test_what_has_no_value_cannot_be_imitated() -> None:
    tiny = PPO(num_steps=4_000, num_lanes=16, segment=8, num_minibatches=2, width=8)
    for other in (learn(PROBLEM, tiny), learn(PROBLEM, Grid(num_points=21))):
        with pytest.raises(ValueError, match=r"expected what swerve.SoftValue\(\) learned, got"):
            TINY.imitate(other)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="num_minibatches: expected a divisor of segment, 30"):
        Distilled(segment=30)
    with pytest.raises(ValueError, match="width: expected a whole number >= 1, got 0"):
        Distilled(width=0)
    with pytest.raises(ValueError, match="explore: expected a number from 0 to 1, got 2"):
        Distilled(explore=2.0)
    with pytest.raises(ValueError, match="loss_scale: expected a finite number > 0, got 0"):
        Distilled(loss_scale=0.0)
