"""Demonstrations that the dynamics do not allow are told, and so is what would explain them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from support.motions import SPACE, cart_motion, cart_record, changed, drive
from support.synthetic import make_evidence

from swerve import infer, read_demonstrations
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.motion import fit_motion
from swerve.sampling.motion import motion_of
from swerve.systems.pendulum import pendulum
from swerve.trust.impossible import against_dynamics

RECORD, MOTION = cart_record(), cart_motion()


def said(item: Demonstration) -> str:
    return against_dynamics(item, RECORD, MOTION)


@pytest.mark.parametrize("rate", [0.2, 0.5, 1.0, 5.0])
def test_nothing_is_said_of_what_the_dynamics_allow(rate: float) -> None:
    """At any rate, timed or not, with uneven times, with noise, at rest at the end."""
    generator = np.random.default_rng(1)
    for seed in range(5):
        item = drive(rate, seed)
        num = len(item.states)
        assert said(item) == ""
        assert said(dataclasses.replace(item, times=None)) == ""
        rows = np.sort(generator.choice(num, size=num // 2, replace=False))
        assert item.times is not None
        few = dataclasses.replace(item, states=item.states[rows], times=item.times[rows])
        assert said(few) == ""
        noise = 0.003 * SPACE.extent * generator.standard_normal((num, 2))
        assert said(changed(item, item.states + noise)) == ""
        rests = np.vstack([item.states, np.repeat(item.states[-1:], num, axis=0)])
        later = np.concatenate([item.times, item.times + item.times[-1] + 0.1])
        assert said(dataclasses.replace(item, states=rests, times=later)) == ""


def test_stronger_actions_than_the_model_has_are_not_impossible() -> None:
    """Forces up to five times the strongest: people act more strongly than models."""
    times = np.linspace(0.0, 3.0, 301)
    x, v = 0.4 * np.sin(5.0 * times), 2.0 * np.cos(5.0 * times)
    item = Demonstration("strong", np.stack([x, v], axis=1), Task([0.0, 2.0], [0.3, 1.5]), times)
    assert said(item) == ""


@pytest.mark.parametrize("is_timed", [True, False])
@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda s: s * [1, -1], "It fits with the sign of x or of v reversed"),
        (lambda s: s * [-1, 1], "It fits with the sign of x or of v reversed"),
        (lambda s: np.vstack([s[:1], s[1:] * [1, -1]]), "with the sign of x or of v reversed"),
        (lambda s: s[:, ::-1], "It fits with the columns x and v swapped"),
        (lambda s: np.vstack([s[:1], s[1:, ::-1]]), "It fits with the columns x and v swapped"),
    ],
)
@pytest.mark.parametrize("rate", [0.5, 1.0, 5.0])
def test_a_wrong_sign_and_swapped_columns(change, cause: str, rate: float, is_timed: bool) -> None:
    item = drive(rate)
    item = changed(item, change(item.states))
    text = said(item if is_timed else dataclasses.replace(item, times=None))
    assert text.startswith("does what the dynamics cannot: from row ")
    assert "% of its motion in x is like this" in text
    assert cause in text


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda s: s * [180 / np.pi, 1], "x times 0.01745 (degrees in place of radians)"),
        (lambda s: s * [0.001, 1], "x times 1000 (thousandths, such as m in place of mm)"),
        (lambda s: s * [1, 3.6], "v times 0.2778 (km/h in place of m/s)"),
        (lambda s: s * [1, 0.01], "v times 100 (hundreds, such as m in place of cm)"),
    ],
)
def test_another_unit(change, cause: str) -> None:
    text = said(changed(drive(), change(drive().states)))
    assert text.startswith("does what the dynamics cannot")
    assert cause.partition(" (")[0] in text


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_another_rate(factor: float, rate: float) -> None:
    item = drive(rate)
    assert item.times is not None
    text = said(dataclasses.replace(item, times=factor * item.times))
    assert f"t times {1 / factor:g} (another rate, or another unit of t)" in text


def test_the_place_and_the_size_are_told() -> None:
    item = drive(5.0)
    item = changed(item, item.states + 0.0)
    item.states[150, 0] += 0.5
    text = said(item)
    assert text.startswith("does what the dynamics cannot: from row 15")
    assert "(t = 1.4" in text or "(t = 1.5" in text
    assert " x changes by " in text
    assert ", a residual of 0.5, " in text
    assert " times what the actions of a step can do" in text
    assert text.endswith(
        "A glitch of the recording, or rows that are left out, swapped or repeated?"
    )


@pytest.mark.parametrize(
    "spoil",
    [
        lambda s: s[100].__setitem__(slice(None), s[100, ::-1].copy()),
        lambda s: s[100:, 0].__iadd__(0.5),
        lambda s: s[200:, 0].__isub__(0.5),
        lambda s: s[100].__setitem__(slice(None), s[200]),
        lambda s: s[50].__iadd__(1.0),
    ],
)
def test_one_wrong_row_and_a_jump(spoil) -> None:
    for seed in range(5):
        item = drive(5.0, seed)
        spoil(item.states)
        text = said(changed(item, item.states))
        assert "rows that are left out, swapped or repeated?" in text


def test_a_step_back_to_the_start_may_be_another_recording() -> None:
    item = drive(5.0)
    states = np.vstack([item.states[:200], item.states[:200]])
    twice = dataclasses.replace(item, states=states, times=0.01 * np.arange(400))
    text = said(twice)
    assert "from row 200 (t = 1.99 s) to row 201 x changes by -1." in text
    assert text.endswith(
        "It leads back to the start. Several recordings in one file? Split it, one file each"
    )


def test_an_offset_of_a_speed_has_no_named_cause() -> None:
    text = said(changed(drive(), drive().states + np.array([0.0, 2.5])))
    assert text.startswith("does what the dynamics cannot")
    assert text.endswith("A wrong sign, columns swapped, another unit, or another rate?")


def test_a_model_of_direct_moves_tells_another_rate_alone() -> None:
    """Where actions are the motion, twice as fast is the only thing that cannot be."""
    before = np.random.default_rng(0).uniform(SPACE.bounds[:, 0], SPACE.bounds[:, 1], (900, 2))
    moves = 0.05 * np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
    motion = fit_motion(before, before[:, None] + moves, SPACE, 0.05)
    times = np.linspace(0.0, 2.0, 41)
    states = np.stack([times - 1.0, 0.5 * times], axis=1)
    item = Demonstration("direct", states, Task(states[0], states[-1]), times)
    assert against_dynamics(item, RECORD, motion) == ""
    brisk = dataclasses.replace(item, times=times / 1.5)
    assert against_dynamics(brisk, RECORD, motion) == ""
    text = against_dynamics(dataclasses.replace(item, times=times / 4.0), RECORD, motion)
    assert "t times 2 (another rate, or another unit of t)" in text


def test_infer_tells_it_once_with_the_names() -> None:
    evidence = make_evidence(RECORD, tasks=Task(*(x[None] for x in drive().task)))
    evidence = dataclasses.replace(evidence, motion=MOTION)
    good = drive(seed=0)
    wrong = changed(good, np.vstack([good.states[:1], good.states[1:] * [1, -1]]))
    wrong = dataclasses.replace(wrong, task=good.task)
    names = ["wrong", "too"]
    items = [dataclasses.replace(wrong, name=names[0]), dataclasses.replace(wrong, name=names[1])]
    warnings = [w for w in infer(evidence, items).warnings if "dynamics cannot" in w]
    assert len(warnings) == 1
    assert warnings[0].startswith("wrong does what the dynamics cannot: from row ")
    assert warnings[0].endswith("(the same holds for too)")
    assert not [w for w in infer(evidence, [good]).warnings if "dynamics" in w]
    old = dataclasses.replace(evidence, motion=None)
    assert not [w for w in infer(old, items).warnings if "dynamics" in w]


@pytest.mark.parametrize("max_torque", [10.0, 1.0])
def test_real_demonstrations_are_possible_and_their_mistakes_are_told(
    shared_data: Path, max_torque: float
) -> None:
    """Of the paper's authors, whose torques are ten times what the paper states."""
    problem = pendulum(max_torque=max_torque)
    motion, record = motion_of(problem), problem.record
    assert motion is not None
    folder = shared_data / "pendulum"
    items = read_demonstrations(
        sorted(folder.glob("demo_*.csv")), record.space, tasks=folder / "tasks.csv"
    )
    assert len(items) == 33
    told = 0
    for item in items:
        few = dataclasses.replace(item, states=item.states[::10], times=item.times[::10])  # pyright: ignore
        for good in (item, few, dataclasses.replace(item, times=None)):
            assert against_dynamics(good, record, motion) == ""
        text = against_dynamics(changed(item, item.states * [1, -1]), record, motion)
        assert "It fits with the sign of theta or of omega reversed" in text
        swapped = np.vstack([item.states[:1], item.states[1:, ::-1]])
        text = against_dynamics(changed(item, swapped), record, motion)
        assert "It fits with the columns theta and omega swapped" in text
        assert item.times is not None
        text = against_dynamics(dataclasses.replace(item, times=0.5 * item.times), record, motion)
        told += "t times 2" in text
    assert told >= 32  # one hardly moves
