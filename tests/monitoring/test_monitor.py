from __future__ import annotations

import dataclasses
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from support.monitors import START, TASK, Known, make_monitor
from support.synthetic import make_demonstration, make_evidence, make_record

from swerve import ActionBox, Box, Monitor, Predicate, Task, infer
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.monitoring.monitor import AGREEMENT


def test_a_prefix_has_the_ratio_of_what_is_left_to_what_there_was() -> None:
    evidence = make_evidence()
    monitor = make_monitor(evidence)
    belief = monitor.observe(START)
    entered = np.zeros(12, bool)
    entered[list(belief.entered)] = True
    foreseen = -np.arange(12) * 5 / 100.0
    expected = foreseen - evidence.log_ratio[0]
    assert 0 < np.count_nonzero(expected > AGREEMENT) < 4
    # what foresight is that far off at the start, it is held against itself
    expected = np.where(np.abs(expected) <= AGREEMENT, expected, 0.0)
    np.testing.assert_array_equal(belief.struck_out, entered)
    np.testing.assert_allclose(belief.log_likelihood[~entered], expected[~entered], atol=1e-5)
    assert np.isneginf(belief.log_likelihood[entered]).all()
    later = monitor.observe(START)
    np.testing.assert_allclose(
        later.log_likelihood[~entered] - belief.log_likelihood[~entered],
        np.arange(12)[~entered] / 100.0,
        atol=1e-5,
    )
    assert later.entered == ()


def test_the_posterior_is_bayes() -> None:
    belief = make_monitor(prior=0.25).observe(START)
    joint = np.exp(belief.log_likelihood.astype(float)) * 0.75 / 12
    total = 0.25 + joint.sum()
    assert belief.none == pytest.approx(0.25 / total, rel=1e-5)
    np.testing.assert_allclose(belief.hypotheses, joint / total, rtol=1e-4)


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
@pytest.mark.parametrize("prior", [None, 0.2])
@pytest.mark.parametrize("clearance", [None, 0.5])
def test_it_ends_where_inference_ends(
    tolerance: float, prior: float | None, clearance: float | None
) -> None:
    evidence = make_evidence()
    demonstration = make_demonstration(x=4.0, num_states=6)
    monitor = make_monitor(evidence, tolerance=tolerance, prior=prior, clearance=clearance)
    last = [monitor.observe(state) for state in demonstration.states][-1]
    expected = infer(
        evidence, [demonstration], tolerance=tolerance, prior=prior, clearance=clearance
    )
    assert expected.is_counted.all() == (clearance is None)
    found = monitor.finish()
    np.testing.assert_array_equal(found.struck_out, expected.struck_out)
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, atol=1e-12)
    np.testing.assert_allclose(found.hypotheses, expected.posterior.hypotheses)
    assert found.none == pytest.approx(expected.posterior.none)
    np.testing.assert_allclose(last.log_likelihood, found.log_likelihood, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(last.hypotheses, found.hypotheses, rtol=1e-4)


def test_a_tolerance_keeps_what_was_entered() -> None:
    belief = make_monitor(tolerance=0.1).observe(START)
    assert belief.entered
    assert not belief.struck_out.any()
    assert belief.log_likelihood[belief.entered[0]] == pytest.approx(np.log(0.1), rel=1e-5)


@pytest.mark.parametrize("foreseen", [-0.01, -30.0])
def test_who_has_not_moved_tells_nothing(foreseen: float) -> None:
    """However far foresight is from ratios that are resolved, bounded or sampled."""
    evidence = make_evidence()
    summary = evidence.summary
    log_ratio, error = summary.log_ratio.copy(), summary.log_ratio_error.copy()
    log_ratio[0, 3], error[0, 3] = -25.0, 0.1  # resolved
    avoid = summary.avoid_probability.copy()
    avoid[0, 4] = 0.0  # floored
    evidence = dataclasses.replace(
        evidence,
        summary=summary._replace(
            log_ratio=log_ratio, log_ratio_error=error, avoid_probability=avoid
        ),
    )
    assert evidence.is_resolved[0, 3]
    assert evidence.is_floored[0, 4]
    foresight = Known(evidence)
    foresight.towards = lambda goal: lambda state, step: np.full(12, foreseen)
    monitor = Monitor(evidence, TASK, foresight)
    belief = monitor.observe(START, 0.0)
    far = np.abs(evidence.log_ratio[0] - foreseen) > AGREEMENT
    assert far[3:5].all()
    left = far & ~belief.struck_out
    np.testing.assert_allclose(belief.log_likelihood[left], 0.0, atol=1e-6)
    assert np.abs(belief.log_likelihood[~belief.struck_out]).max() <= AGREEMENT
    resting = make_demonstration(0)
    expected = infer(evidence, [resting])  # the end still tells what the evidence knows
    found = monitor.finish()
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood)
    over = monitor.observe(START, 0.5)
    np.testing.assert_allclose(over.log_likelihood, expected.log_likelihood, rtol=1e-5)


def test_beliefs_are_not_to_be_written_to() -> None:
    belief = make_monitor().observe(START)
    for array in (belief.struck_out, belief.log_likelihood, belief.hypotheses):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_it_cannot_end_before_it_begins() -> None:
    with pytest.raises(ValueError, match="finish: no state of the demonstration has come yet"):
        make_monitor().finish()


def test_foresight_that_is_nan_is_told_from_evidence() -> None:
    monitor = make_monitor()
    good, monitor._ahead = monitor._ahead, lambda state, step: np.full(12, np.nan)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"foresight: gave NaN for \[0.1, 1.0\] at 0 s"):
            monitor.observe(START, 0.0)
    monitor._ahead = good
    assert monitor.observe(START, 0.1).none > 0.0


def test_a_late_start_is_judged_from_there_on() -> None:
    monitor = make_monitor()
    belief = monitor.observe([2.0, 6.0], 0.2)
    assert belief.flags == ("late start",)
    left = ~belief.struck_out
    np.testing.assert_allclose(belief.log_likelihood[left], 0.0, atol=1e-6)
    final = monitor.finish()
    np.testing.assert_allclose(final.log_likelihood[left], 0.03 * np.arange(12)[left], atol=1e-6)
    # at the start, but later than the task begins
    assert make_monitor().observe(START, 0.1).flags == ("late start",)


def test_a_state_that_comes_again_changes_nothing() -> None:
    monitor = make_monitor()
    first = monitor.observe(START, 0.0)
    again = monitor.observe(START, 0.0)
    assert again.flags == ("repeated",)
    assert again.entered == ()
    np.testing.assert_array_equal(first.log_likelihood, again.log_likelihood)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ([0.1, np.nan], "expected finite numbers, got x = nan"),
        ([0.1, np.inf], "expected finite numbers, got x = inf"),
        ([0.1], r"expected 2 numbers \(theta, x\), got \[0.1\]"),
        ([0.1, 1.0, 2.0], "expected 2 numbers"),
        (["a", 1.0], "expected 2 numbers"),
        (None, "expected 2 numbers"),
        (3.0, "expected 2 numbers"),
        ("01", "expected 2 numbers"),
        ([0.1, 10**400], "expected 2 numbers"),
        ([0.1, 56.0], r"state: x: 56 is more than 10 half-widths from .* bounds \[0, 10\]. Anoth"),
        ([0.1, -1e308], "state: x: -1e\\+308 is more than 10 half-widths"),
        ([360.0, 1.0], "state: theta: 360 is an angle of more than 10 turns. Degrees?"),
        ([1e308, 1.0], "state: theta: 1e\\+308 is an angle of more than"),
    ],
)
def test_a_bad_state_changes_nothing(state, message: str) -> None:
    monitor = make_monitor()
    monitor.observe(START, 0.0)
    with pytest.raises(ValueError, match=message):
        monitor.observe(state, 0.1)
    assert monitor.observe(START, 0.0).flags == ("repeated",)


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (0.1, "runs backwards, from 0.2 s to 0.1 s"),
        (-1.0, "expected seconds since the start of the task, got -1"),
        (np.nan, "expected seconds since the start of the task, got nan"),
        ("soon", "expected seconds since the start of the task, got 'soon'"),
        (10**400, "expected seconds since the start of the task, got 1000"),
        (
            1e308,
            r"expected seconds since .* got 1e\+308 s, where the horizon is 0.5 s; this state is",
        ),
        (
            5e4,
            "expected seconds since the start of the task, got 50000 s, where the horizon is 0.5",
        ),
        (
            501.0,
            r"got 501 s, where the horizon is 0.5 s; this state is ignored. The times may be mill",
        ),
        (None, "expected a time for every state or for none, got None, and the last had a time"),
    ],
)
def test_a_bad_time_changes_nothing(time, message: str) -> None:
    monitor = make_monitor()
    monitor.observe(START, 0.2)
    with pytest.raises(ValueError, match=message):
        monitor.observe([0.2, 8.0], time)
    assert monitor.observe(START, 0.2).flags == ("repeated",)


def test_after_a_long_pause_a_new_monitor_is_needed() -> None:
    """No unit is told to whoever has given seconds."""
    monitor = make_monitor()
    monitor.observe(START, 0.0)
    monitor.observe(START, 0.4)
    for time in (510.0, 520.0):
        with pytest.raises(ValueError, match=r"is ignored. After a pause, another demonst"):
            monitor.observe(START, time)
    assert make_monitor().observe(START, 0.0).flags == ()


def test_the_time_of_a_clock_is_told_at_the_first_state() -> None:
    monitor = make_monitor()
    with pytest.raises(ValueError, match=r"These may be times since 1970: subtract the time of th"):
        monitor.observe(START, 1.7e9)
    assert monitor.observe(START, 0.0).flags == ()


def test_a_monitor_may_go_on_for_long_after_the_end() -> None:
    """As long as states come: only between two of them there are at most 1000 horizons."""
    monitor = make_monitor()
    for number in range(1, 90):
        assert "past the horizon" in monitor.observe(START, 500.0 * number).flags
    with pytest.raises(ValueError, match=r"got 45001 s, where the horizon is 0.5 s; this state"):
        monitor.observe(START, 45001.0)
    assert monitor.observe(START, 45000.0).flags
    untimed = make_monitor(make_evidence(make_record(is_timed=False)))
    untimed.observe(START, 0.0)
    assert untimed.observe(START, 10_000.0).flags == ()


def test_a_predicate_that_fails_changes_nothing() -> None:
    """Nothing of a state is kept where code of a user fails at it."""

    def enters(state: np.ndarray) -> np.ndarray:
        if (state == 7.0).any():
            raise KeyError("seven")
        return state[..., 1] > 8.0

    space = ConstraintHypotheses([Predicate("high", enters)] * 12)
    evidence = make_evidence(make_record(hypotheses=space, between_states=True))
    monitors = [Monitor(evidence, TASK, Known(evidence)) for _ in range(2)]
    beliefs = []
    for monitor in monitors:
        monitor.observe(START, 0.0)
        if monitor is monitors[0]:
            with pytest.raises(KeyError):
                monitor.observe([0.1, 7.0], 0.1)
        beliefs.append(monitor.observe([0.1, 2.0], 0.1))
    assert beliefs[0].flags == beliefs[1].flags
    assert beliefs[0].entered == beliefs[1].entered == ()
    np.testing.assert_array_equal(beliefs[0].log_likelihood, beliefs[1].log_likelihood)


def test_bad_arguments() -> None:
    evidence = make_evidence()
    foresight = Known(evidence)
    with pytest.raises(ValueError, match=r"evidence: expected a swerve\.Evidence"):
        Monitor(None, TASK, foresight)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"foresight: expected what swerve\.foresee returns"):
        Monitor(evidence, TASK, None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="no evidence for start"):
        Monitor(evidence, Task([5.0, 5.0], [0.0, 0.0]), foresight)
    other = make_evidence(make_record(beta=0.7))
    with pytest.raises(ValueError, match="foresight: it is of another problem"):
        Monitor(other, TASK, foresight)
    acting = make_evidence(
        make_record(hypotheses=ConstraintHypotheses([ActionBox(u=(0.0, 1.0))] * 12))
    )
    with pytest.raises(ValueError, match="hypotheses: some are about actions"):
        Monitor(acting, TASK, foresight)
    with pytest.raises(ValueError, match="tolerance: expected"):
        make_monitor(tolerance=1.0)
    with pytest.raises(ValueError, match="prior: expected probabilities that sum to 1"):
        make_monitor(prior=np.full(13, 0.1))
    with pytest.raises(ValueError, match="clearance: expected a distance >= 0, got -1"):
        make_monitor(clearance=-1)


def test_a_prior_without_none_may_leave_nothing() -> None:
    everything = ConstraintHypotheses([Box(x=(-5.0, 15.0))] * 12)
    monitor = make_monitor(make_evidence(make_record(hypotheses=everything)), prior=0.0)
    for _ in range(2):
        with pytest.raises(ValueError, match="rule out every hypothesis"):
            monitor.observe(START, 0.0)
    with pytest.raises(ValueError, match="rule out every hypothesis"):
        monitor.finish()


def test_memory_does_not_grow() -> None:
    monitor = make_monitor()
    states = np.random.default_rng(0).uniform([0.0, 0.0], [6.0, 9.0], (3000, 2))

    def observe_all() -> None:
        for state in states:
            monitor.observe(state)

    observe_all()
    tracemalloc.start()
    try:
        observe_all()
        before = tracemalloc.get_traced_memory()[0]
        observe_all()
        assert tracemalloc.get_traced_memory()[0] - before < 2000  # bytes, of 3000 states
    finally:
        tracemalloc.stop()


def test_it_needs_no_jax() -> None:
    code = "import sys, swerve; swerve.Monitor, swerve.Foresight; import swerve.cli.json_lines; "
    code += "assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
