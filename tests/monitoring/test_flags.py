"""What a monitor flags as odd."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.monitors import START, Known, make_monitor
from support.motions import cart_motion, cart_record, drive
from support.synthetic import TASKS, make_evidence, make_record

from swerve import Box, Monitor, Task
from swerve.base.space import TWO_PI
from swerve.evidence.evidence import Evidence


def slow_evidence(**changes) -> Evidence:
    """Evidence whose nominal trajectories change by at most 2 a second."""
    evidence = make_evidence(**changes)
    fastest = np.full(TASKS.start.shape, 2.0)
    return dataclasses.replace(evidence, summary=evidence.summary._replace(fastest=fastest))


def test_the_end_before_the_shortest_nominal_trajectory_is_flagged() -> None:
    evidence = make_evidence()
    shortest = evidence.summary._replace(shortest=np.full(3, 0.4))
    monitor = make_monitor(dataclasses.replace(evidence, summary=shortest))
    monitor.observe(START, 0.0)
    monitor.observe(START, 0.35)
    assert monitor.finish().flags == ("cut short",)
    monitor.observe(START, 0.37)
    assert monitor.finish().flags == ()


def test_odd_states_are_flagged_and_the_monitor_goes_on() -> None:
    evidence = slow_evidence()
    monitor = make_monitor(evidence)
    theta, x = START
    assert monitor.observe([theta, x], 0.0).flags == ()
    assert monitor.observe([theta, x + 0.3], 0.1).flags == ()
    assert monitor.observe([theta, x + 0.4], 0.1).flags == ("another state at the same time",)
    assert monitor.observe([theta, x + 0.5], 0.3).flags == ("gap",)
    assert monitor.observe([theta, x + 6.0], 0.4).flags == ("unreachable",)
    assert monitor.observe([theta, 10.1], 0.5).flags == ("unreachable", "outside the bounds")
    assert monitor.observe([theta + TWO_PI, 10.0], 0.6).flags == ("past the horizon",)


UNTIMED = "no times: another rate than the model's?"
OTHER_UNIT = "times of another unit: milliseconds?"


@pytest.mark.parametrize("scale", [1e3, 1e6])
def test_times_of_another_unit_are_flagged(scale: float) -> None:
    """A horizon of 5 steps lasts 0.5 s; microseconds come after far too long to be states of it."""
    monitor = make_monitor(slow_evidence())
    assert monitor.observe(START, 0.0).flags == ()
    if scale > 1e3:
        match = "is ignored. The times may be microseconds. After a pause, another demonstration"
        with pytest.raises(ValueError, match=match):
            monitor.observe(START, 0.1 * scale)
        return
    for step in range(1, 5):
        flags = monitor.observe(START, 0.1 * step * scale).flags
        assert flags == ("gap", OTHER_UNIT, "past the horizon")


def test_gaps_after_steps_of_the_model_are_no_other_unit() -> None:
    """Nor is a demonstrator who is watched every now and then, or after the end."""
    monitor = make_monitor(slow_evidence())
    monitor.observe(START, 0.0)
    monitor.observe(START, 0.1)
    assert monitor.observe(START, 100.0).flags == ("gap", "past the horizon")
    assert monitor.observe(START, 200.0).flags == ("gap", "past the horizon")
    monitor = make_monitor(slow_evidence())
    monitor.observe(START, 0.0)
    assert monitor.observe(START, 0.4).flags == ("gap",)
    assert monitor.observe(START, 100.0).flags == ("gap", "past the horizon")


def seconds_apart(dt: float, times: list[float]) -> list[tuple[str, ...]]:
    """The flags of states at these times, after one at 0, where a step of the model takes dt s."""
    monitor = make_monitor(slow_evidence(record=make_record(dt=dt, num_steps=10_000)))
    return [monitor.observe(START, time).flags for time in [0.0, *times]][1:]


@pytest.mark.parametrize("apart", [0.3, 1.0, 3.0, 6.0])
def test_a_slow_feed_has_gaps_and_no_other_unit(apart: float) -> None:
    assert seconds_apart(0.02, [apart, 2.0 * apart, 3.0 * apart]) == [("gap",)] * 3


@pytest.mark.parametrize(
    ("dt", "number", "unit"),
    [
        (0.02, 1e3, "milliseconds"),
        (0.1, 1e3, "milliseconds"),
        (0.05, 1e6, "microseconds"),
    ],
)
def test_the_unit_of_the_times_is_named(dt: float, number: float, unit: str) -> None:
    """Also where states come a little faster or slower than steps of the model."""
    for share in (0.5, 1.0, 1.4):
        [flags] = seconds_apart(dt, [share * dt * number])
        assert flags[:2] == ("gap", f"times of another unit: {unit}?")
    [flags] = seconds_apart(dt, [5.0 * dt * number])
    assert flags[:2] in {("gap",), ("gap", "past the horizon")}


@pytest.mark.parametrize("rate", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("is_timed", [True, False])
def test_states_without_times_at_another_rate_are_flagged(rate: float, is_timed: bool) -> None:
    item = drive(rate)
    evidence = make_evidence(cart_record(), tasks=Task(*(part[None] for part in item.task)))
    evidence = dataclasses.replace(evidence, motion=cart_motion())
    monitor, found = Monitor(evidence, item.task, Known(evidence)), set()
    assert item.times is not None
    for state, time in zip(item.states, item.times.tolist(), strict=True):
        flags = monitor.observe(state, time if is_timed else None).flags
        assert ("against the dynamics" in flags) == (flags[-1:] == (UNTIMED,))
        found |= set(flags)
    assert (UNTIMED in found) == (not is_timed and rate != 1.0)


def test_a_known_constraint_is_flagged() -> None:
    evidence = make_evidence(make_record(known=(Box(x=(2.0, 3.0)),)))
    monitor = make_monitor(evidence)
    assert monitor.observe(START).flags == ()
    assert "in a known constraint" in monitor.observe([START[0], 2.5]).flags


def test_a_model_without_a_clock_has_no_late_early_and_missing_states() -> None:
    evidence = slow_evidence(record=make_record(is_timed=False))
    shortest = evidence.summary._replace(shortest=np.full(3, 0.4))
    monitor = make_monitor(dataclasses.replace(evidence, summary=shortest))
    theta, x = START
    assert monitor.observe([theta, x], 0.2).flags == ()
    assert monitor.observe([theta, x + 0.6], 0.21).flags == ()  # a quick one
    assert monitor.finish().flags == ()
    assert monitor.observe([theta, x + 0.7], 5.0).flags == ()
    assert monitor.observe([theta, x + 6.0], 5.1).flags == ("unreachable",)
