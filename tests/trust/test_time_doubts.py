"""Doubts about times name the likely unit, and the rate where there are no times."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.motions import DT, FORCES, cart_motion, cart_record, changed, drive
from support.synthetic import make_evidence, make_record

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.evidence.motion import fit_motion
from swerve.hypotheses.grid import grid
from swerve.trust.doubts import doubts

LASTS = "and the model's episodes at most 3 s: another unit of t, or a horizon that is too short?"


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """Evidence for the drive of 3 s, with segments between states and the cart's motion."""
    record = cart_record()
    record = dataclasses.replace(record, between_states=True)
    found = make_evidence(record, tasks=Task(*(x[None] for x in drive().task)))
    summary = found.summary._replace(shortest=np.array([2.9]))
    return dataclasses.replace(found, summary=summary, motion=cart_motion())


def timed(scale: float, rate: float = 1.0) -> Demonstration:
    """The drive with times in another unit, of which `scale` are a second."""
    item = drive(rate)
    assert item.times is not None
    return dataclasses.replace(item, times=scale * item.times)


@pytest.mark.parametrize(
    ("scale", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_a_duration_too_long_names_the_unit(evidence: Evidence, scale: float, unit: str) -> None:
    found = doubts(timed(scale), evidence, 0)
    assert found["duration"] == (
        f"lasts {3.0 * scale:.4g} s, {LASTS} The times may be {unit}: give them in seconds"
    )
    assert "rate" not in found  # rows 50 s apart are not
    coarse = doubts(timed(scale, 0.5), evidence, 0)["rate"]
    assert coarse.startswith(
        f"has states up to 0.1 s apart, if its times are {unit}, where the model steps every 0.05 "
    )


def test_minutes_and_a_horizon_too_short(evidence: Evidence) -> None:
    short = doubts(timed(1 / 60), evidence, 0)["duration"]
    assert short.endswith("another unit of t? The times may be minutes: give them in seconds")
    long = doubts(timed(4.0), evidence, 0)
    assert long["duration"] == f"lasts 12 s, {LASTS}"
    assert long["rate"].startswith("has states up to 0.2 s apart, where the model steps")


@pytest.mark.parametrize("duration", [0.05, 0.3, 0.5])
def test_a_demonstration_cut_short_has_no_coarse_rows(evidence: Evidence, duration: float) -> None:
    """Nor are its times minutes, unless they would then be as long as a demonstration."""
    item = drive()
    assert item.times is not None
    num = round(duration / DT) + 1
    part = Demonstration("cut", item.states[:num], item.task, item.times[:num])
    found = doubts(part, evidence, 0)
    assert "cut short, or another unit of t?" in found["duration"]
    assert ("minutes" in found["duration"]) == (duration == 0.05)
    assert "rate" not in found


def test_a_long_recording_of_coarse_rows_is_not_of_milliseconds(evidence: Evidence) -> None:
    """Where 150 s of an episode of 3 s are recorded, with rows 0.2 s apart, they are too coarse."""
    item = dataclasses.replace(drive(12.5), times=np.linspace(0.0, 150.0, 751))
    found = doubts(item, evidence, 0)
    assert found["duration"] == f"lasts 150 s, {LASTS}"
    assert found["rate"].startswith(
        "has states up to 0.2 s apart, where the model steps every 0.05"
    )


def test_times_that_count_the_rows(evidence: Evidence) -> None:
    item = dataclasses.replace(drive(), times=np.arange(61.0))
    found = doubts(item, evidence, 0)
    assert found["duration"].endswith(f"{LASTS} The times may count the rows: give them in seconds")
    assert "rate" not in found
    fine = drive(10.0)
    fine = dataclasses.replace(fine, times=np.arange(float(len(fine.states))))
    text = doubts(fine, evidence, 0)["duration"]
    assert "The times may be milliseconds or count the rows: give them in seconds" in text


def test_steps_of_a_second_do_not_count_the_rows(evidence: Evidence) -> None:
    record = dataclasses.replace(evidence.problem, dt=1.0, num_steps=20)
    slow = dataclasses.replace(evidence, problem=record, motion=None)
    item = dataclasses.replace(drive(), times=np.arange(61.0))
    assert doubts(item, slow, 0)["duration"].endswith("or a horizon that is too short?")


@pytest.mark.parametrize("rate", [0.1, 0.2, 0.5, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_rows_without_times_at_another_rate(evidence: Evidence, rate: float, noise: float) -> None:
    item = dataclasses.replace(drive(rate), times=None)
    generator = np.random.default_rng(0)
    item = changed(item, item.states + noise * generator.standard_normal(item.states.shape))
    text = doubts(item, evidence, 0)["rate"]
    start, _, rest = text.partition(
        " s apart, where the model steps every 0.05 s: another rate, or "
    )
    assert start.startswith("moves as if its rows were about ")
    assert float(start.split()[-1]) == pytest.approx(DT / rate, rel=0.1)
    assert rest.startswith("another unit of a state? ")
    assert rest.endswith(
        "There are no times, so fits and monitors take each row for a step: give them [s] in a "
        "column t"
    )
    assert ("At that rate, the straight lines between them may cut" in rest) == (rate < 0.66)


@pytest.mark.parametrize("rate", [0.8, 1.0, 1.2])
def test_rows_without_times_that_may_be_steps(evidence: Evidence, rate: float) -> None:
    for seed in range(5):
        item = dataclasses.replace(drive(rate, seed), times=None)
        assert "rate" not in doubts(item, evidence, 0)
    assert "rate" not in doubts(drive(5.0), evidence, 0)
    unknown = dataclasses.replace(evidence, motion=None)
    assert "rate" not in doubts(dataclasses.replace(drive(5.0), times=None), unknown, 0)


@pytest.mark.parametrize("num", [20, 60, 200])
def test_noise_of_a_pendulum_at_rest_tells_no_rate(num: int) -> None:
    space = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))

    def step(states: np.ndarray, torque: np.ndarray) -> np.ndarray:
        theta, omega = states[..., 0], states[..., 1]
        speed = omega + DT * (torque - 9.81 * np.sin(theta))
        return np.stack(np.broadcast_arrays(theta + DT * omega, speed), axis=-1)

    before = np.random.default_rng(0).uniform(space.bounds[:, 0], space.bounds[:, 1], (900, 2))
    motion = fit_motion(before, step(before[:, None], FORCES), space, DT)
    cells = grid(theta=(0.0, 6.2, 4), omega=(-4.0, 4.0, 3))
    record = make_record(space=space, goal_names=space.names, dt=DT, num_steps=60, hypotheses=cells)
    for seed in range(5):
        states = 0.1 * np.random.default_rng(seed).standard_normal((num, 2))
        task = Task(states[0], states[-1])
        found = make_evidence(record, tasks=Task(*(x[None] for x in task)))
        found = dataclasses.replace(found, motion=motion)
        assert "rate" not in doubts(Demonstration("rest", states, task), found, 0)


def test_what_fits_no_rate_is_not_a_rate(evidence: Evidence) -> None:
    """It is impossible whatever the times, and the message says how to give them."""
    item = dataclasses.replace(drive(), times=None)
    late = np.stack([item.states[:, 0], np.roll(item.states[:, 1], 12)], axis=1)
    found = doubts(changed(item, late), evidence, 0)
    assert "rate" not in found
    [text] = [text for kind, text in found.items() if kind.startswith("dynamics")]
    assert text.endswith(
        "another unit, or another rate? It has no times: if its rows are not evenly spaced, give "
        "them [s] in a column t"
    )


def test_a_speed_without_times_names_the_rate(evidence: Evidence) -> None:
    summary = evidence.summary._replace(fastest=np.array([[0.1, 0.1]]))
    slow = dataclasses.replace(evidence, summary=summary)
    assert doubts(drive(), slow, 0)["speed"].endswith(
        "another unit, such as degrees, or another t?"
    )
    text = doubts(dataclasses.replace(drive(), times=None), slow, 0)["speed"]
    assert "such as degrees, or another rate? There are no times, so fits and monitors take" in text
