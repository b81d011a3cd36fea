"""After its last state a monitor says of a demonstration what `infer` says of it as a whole."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from support.monitors import Known
from support.synthetic import TASKS, make_evidence, make_record

import swerve
from swerve import Ball, Box, Demonstration, HalfSpace, Monitor, Task, infer
from swerve.base.space import TWO_PI
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.monitoring.monitor import REPEATED, Belief

CELLS = grid(theta=(0.0, TWO_PI, 5), x=(0.0, 10.0, 4))
SHAPES = ConstraintHypotheses(
    [
        *(Box(theta=(k, k + 1.5), x=(2.0 * k, 2.0 * k + 2.5)) for k in range(4)),
        Box(x=(7.0, 9.5)),
        Ball(1.2, theta=4.5, x=3.0),
        HalfSpace(8.0, x=1.0, theta=0.3),
    ]
)
MARGIN = {"x": 0.6, "theta": 0.15}
ROUNDING = 1e-7  # of what was foreseen, in single precision
OPTIONS: list[dict[str, Any]] = [
    {"margin": MARGIN},
    {"margin": {"x": 0.8}, "tolerance": 0.05},
    {"margin": MARGIN, "prior": 0.2, "clearance": 0.7},
    {"margin": MARGIN, "prior": 0.9, "tolerance": 0.2, "clearance": 0.7},
]


def wander(generator: np.random.Generator, task: int, name: str) -> Demonstration:
    """A demonstration that roams at uneven times, some of them later than the model's horizon."""
    num = int(generator.integers(5, 60))
    steps = generator.normal(size=(num, 2)) * generator.choice([0.1, 0.5]) * [1.0, 1.5]
    steps[0] = 0.0
    states = TASKS.start[task] + np.cumsum(np.clip(steps, -2.0, 2.0), axis=0)
    states[:, 1] = np.abs(states[:, 1]) % 12.0
    states[0] = TASKS.start[task]
    if generator.random() < 0.5:
        states[:, 0] %= TWO_PI
    times = np.cumsum(generator.uniform(0.001, generator.choice([0.01, 0.1]), num))
    return Demonstration(
        name, states, Task(TASKS.start[task], TASKS.goal[task]), times=times - times[0]
    )


def watched(
    monitor: Monitor, demonstration: Demonstration, generator: np.random.Generator
) -> Belief:
    """Return what a monitor says at the end of a demonstration, some of its samples sent twice."""
    assert demonstration.times is not None
    for state, time in zip(demonstration.states, demonstration.times.tolist(), strict=True):
        belief = monitor.observe(state, time)
        if generator.random() < 0.3:
            again = monitor.observe(state, time)
            assert again.flags == (REPEATED,)
            np.testing.assert_array_equal(again.log_likelihood, belief.log_likelihood)
            np.testing.assert_array_equal(again.hypotheses, belief.hypotheses)
    return monitor.finish()


def check_same(found: Belief, expected: swerve.Inference) -> None:
    np.testing.assert_array_equal(found.struck_out, expected.struck_out)
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, atol=ROUNDING)
    np.testing.assert_allclose(found.hypotheses, expected.posterior.hypotheses, atol=ROUNDING)
    assert found.none == pytest.approx(expected.posterior.none, abs=ROUNDING)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("between_states", [True, False])
@pytest.mark.parametrize("hypotheses", [CELLS, SHAPES])
def test_it_ends_where_infer_ends(hypotheses, between_states: bool, options) -> None:
    evidence = make_evidence(make_record(hypotheses=hypotheses, between_states=between_states))
    generator = np.random.default_rng(5)
    made = [wander(generator, k % len(TASKS.start), f"demo_{k}") for k in range(12)]
    ends, foresight = [], Known(evidence)
    for item in made:
        monitor = Monitor(evidence, item.task, foresight, **options)
        ends.append(watched(monitor, item, generator))
        check_same(ends[-1], infer(evidence, [item], **options))
    result = infer(evidence, made, **options)
    total = np.sum([end.log_likelihood for end in ends], axis=0)
    np.testing.assert_allclose(total, result.log_likelihood, atol=1e-9)
    whole = infer(evidence, made, **options | {"margin": None})
    assert (result.entered <= whole.entered).all()
    assert 0 < result.entered.sum() < 0.9 * whole.entered.sum()  # so that the margin matters


def evidence_from(task: Task, log_avoid: np.ndarray, evidence: Evidence) -> Evidence:
    """Evidence of one task alone, whose log Z_c / Z_0 [H] is known."""
    tasks = Task(task.start[None], task.goal[None])
    made = make_evidence(evidence.problem, tasks=tasks)
    known = made.summary._replace(
        log_ratio=log_avoid[None], log_ratio_error=np.zeros((1, len(log_avoid)))
    )
    return dataclasses.replace(made, summary=known)


@pytest.mark.parametrize("options", OPTIONS)
def test_a_late_start_ends_where_infer_ends_for_a_task_that_starts_there(options) -> None:
    evidence = make_evidence(make_record(hypotheses=CELLS))
    foresight, num_steps = Known(evidence), evidence.problem.num_steps
    generator, begun_at = np.random.default_rng(8), set()
    for k in range(12):
        whole = wander(generator, k % len(TASKS.start), f"demo_{k}")
        assert whole.times is not None
        first = int(generator.integers(1, len(whole.states) - 1))
        times = whole.times[first:]
        task = Task(whole.states[first], whole.task.goal)
        late = Demonstration(whole.name, whole.states[first:], task, times=times)
        step = min(round(times[0] / evidence.problem.dt), num_steps)
        left = np.zeros(len(CELLS))  # at the horizon
        if step < num_steps:
            left = foresight.towards(task.goal)(task.start, step)
        expected = infer(evidence_from(task, left, evidence), [late], **options)
        monitor = Monitor(evidence, whole.task, foresight, **options)
        check_same(watched(monitor, late, generator), expected)
        begun_at.add(step)
    assert {0, num_steps} < begun_at
