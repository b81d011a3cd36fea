"""Doubts about demonstrations: each is raised where it should be and not where it should not."""

from __future__ import annotations

import dataclasses
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from support.synthetic import (
    TASKS,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
)

from swerve.answer import infer
from swerve.base.phrases import some_names
from swerve.base.space import TWO_PI, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.grid import grid
from swerve.trust.doubts import _again, doubts

DURATION = 0.5  # s, of the model's episodes: 5 steps of 0.1 s


def straight(
    to: np.ndarray, duration: float = DURATION, name: str = "a", num_states: int = 11
) -> Demonstration:
    """A demonstration of the second task that goes straight to a state."""
    share = np.linspace(0.0, 1.0, num_states)[:, None]
    start, goal = TASKS.start[1], TASKS.goal[1]
    times = np.linspace(7.0, 7.0 + duration, num_states)
    return Demonstration(name, start + share * (to - start), Task(start, goal), times)


@pytest.fixture
def evidence() -> Evidence:
    """Evidence by which nominal trajectories end close and move as `straight` does."""
    found = make_evidence()
    speed = np.abs(TASKS.goal[1] - TASKS.start[1]) / DURATION
    summary = found.summary._replace(
        end=TASKS.goal + np.array([0.0, 0.1]),
        end_reach=np.full((3, 2), 0.1),
        shortest=np.full(3, 0.4),
        fastest=np.tile(speed * 1.5, (3, 1)),
    )
    return dataclasses.replace(found, summary=summary)


def test_no_doubt_about_one_that_does_as_nominal_ones_do(evidence: Evidence) -> None:
    for num_states in (3, 11, 200):
        item = straight(TASKS.goal[1], num_states=num_states)
        assert doubts(item, evidence, 1) == {}
        assert doubts(dataclasses.replace(item, times=None), evidence, 1) == {}


def test_an_end_far_from_the_goal(evidence: Evidence) -> None:
    """At least 5 % of the extent from the goal and from where nominal ones end; an angle wraps."""
    turn = np.array([2 * np.pi, 0.0])
    assert doubts(straight(TASKS.goal[1] - turn), make_evidence(), 1) == {}
    for there in (-0.4, 0.0, 0.4, 0.65):  # of an extent of 10; nominal ones end in 0 to 0.2
        assert "end" not in doubts(straight(TASKS.goal[1] + np.array([0.0, there])), evidence, 1)
    far = straight(TASKS.goal[1] + np.array([0.0, 0.75]))
    text = doubts(far, evidence, 1)["end"]
    assert text.startswith(
        "ends at x = 2.75, where nominal trajectories end between 2 and 2.2: cut"
    )
    wide = evidence.summary._replace(end_reach=np.full((3, 2), 0.4))
    assert "end" not in doubts(far, dataclasses.replace(evidence, summary=wide), 1)
    below = straight(TASKS.goal[1] - np.array([0.5, 0.0]))  # of the angle's 6.28
    assert "ends at theta = 1.5," in doubts(below, evidence, 1)["end"]


def test_the_end_of_one_whose_goal_is_no_state(evidence: Evidence) -> None:
    """It is held against where nominal trajectories end alone."""
    other = dataclasses.replace(evidence, problem=make_record(goal_names=("p", "q")))
    assert "end" not in doubts(straight(TASKS.goal[1] + np.array([0.0, 0.65])), other, 1)
    cut = doubts(straight(TASKS.start[1] + 0.01), other, 1)["end"]
    assert "ends at x = 5.01, where nominal trajectories end between 2 and 2.2" in cut


@pytest.mark.parametrize(
    ("changes", "method", "text"),
    [
        ({"kl": 0.6}, "importance", "more than 0.5 nats from pi_0 (worst: demo_b, KL 0.60)"),
        ({"kl": 0.4}, "importance", None),
        (
            {"kl": 0.4},
            "plain",
            "plain weights assume that the policy is pi_0: use importance weights",
        ),
        ({"kl": 0.05}, "plain", None),
        ({"kl": 0.05, "effective_sample_size": 400.0 * (1.0 + 1e-12)}, "plain", None),
        ({"soft_value": 3.2}, "importance", "log Z_0 is not that of its samples (worst: demo_b, "),
        ({"soft_value": 3.08}, "importance", None),
        ({"soft_value": 3.7, "effective_sample_size": 220.0}, "importance", None),
        ({"soft_value": 2.8}, "importance", "log Z_0 is not that of its samples"),
        ({"soft_value": np.nan}, "importance", None),
        (
            {"soft_value": -np.inf},
            "importance",
            "close the start in for 1 of 2 tasks (first: demo_b",
        ),
        ({"kl": 0.6, "effective_sample_size": 20.0}, "importance", "effective sample size"),
    ],
)
def test_a_policy_or_a_value_that_is_wrong(changes: dict, method: str, text: str | None) -> None:
    """Of the task that is used, and only once for a task whose samples are too few already."""
    good = {"kl": 0.0, "soft_value": 3.0, "log_partition": 3.0, "effective_sample_size": 400.0}
    found = make_evidence(method=method, solver="Grid(num_points=(9, 9))")
    columns = {name: np.full(3, value) for name, value in good.items()}
    for name, value in changes.items():
        columns[name][1] = value
    columns["kl"][2] = columns["soft_value"][2] = 9.0  # of a task that is not used
    found = dataclasses.replace(found, summary=found.summary._replace(**columns))
    demonstrations = [make_demonstration(k, name) for k, name in enumerate(("demo_a", "demo_b"))]
    warnings = infer(found, demonstrations).warnings
    assert len(warnings) == (text is not None)
    assert all(str(text) in warning for warning in warnings)
    if "soft_value" in changes:
        assert all("give it more num_points" in warning for warning in warnings)


@pytest.mark.parametrize(
    ("duration", "text"),
    [
        (0.56, "lasts 0.56 s, and the model's episodes at most 0.5 s"),
        (0.35, "lasts 0.35 s, and nominal trajectories at least 0.4 s"),
        (0.54, None),
        (0.37, None),
    ],
)
def test_duration(evidence: Evidence, duration: float, text: str | None) -> None:
    found = doubts(straight(TASKS.goal[1], duration), evidence, 1)
    assert found.get("duration", "").startswith(text or "")
    assert ("duration" in found) == (text is not None)


def test_degrees_are_noticed_by_their_speed(evidence: Evidence) -> None:
    item = straight(TASKS.goal[1], num_states=200)
    degrees = np.stack([np.degrees(item.states[:, 0]), item.states[:, 1]], axis=1)
    for times in (item.times, None):
        found = doubts(Demonstration("a", degrees, item.task, times), evidence, 1)
        assert found["speed"].startswith("changes theta by ")
        assert (
            "times as fast as any nominal trajectory: another unit, such as degrees"
            in (found["speed"])
        )


def test_single_fast_steps_are_noise(evidence: Evidence) -> None:
    item = straight(TASKS.goal[1], num_states=200)
    item.states[100, 1] += 0.09  # of an extent of 10
    assert "speed" not in doubts(item, evidence, 1)


@pytest.mark.parametrize("is_timed", [True, False])
def test_a_jump_is_a_glitch(evidence: Evidence, is_timed: bool) -> None:
    item = straight(TASKS.goal[1], num_states=200)
    item.states[100:, 1] += 1.0
    if not is_timed:
        item = dataclasses.replace(item, times=None)
    text = doubts(item, evidence, 1)["speed"]
    assert text.startswith("jumps by ")
    assert " in x from row 100 to row 101, in 0.002" in text


@pytest.mark.parametrize("is_timed", [True, False])
def test_a_jump_back_to_the_start_may_be_another_recording(
    evidence: Evidence, is_timed: bool
) -> None:
    item = straight(TASKS.goal[1], num_states=200)
    states = np.vstack([item.states, item.states])
    twice = Demonstration("a", states, item.task, np.arange(400) / 400.0 if is_timed else None)
    text = doubts(twice, evidence, 1)["speed"]
    assert " in x from row 200 to row 201, in 0.00" in text
    assert "back to its start. Several recordings in one file? Split it, one file each. H" in text
    moved = doubts(dataclasses.replace(twice, times=None), untimed(evidence), 1)["move"]
    assert moved.startswith("jumps by 3 in x from row 200 to row 201, where")
    assert "back to its start. Several recordings in one file? Split it, one file each. H" in moved


def test_copies_are_found_in_little_memory() -> None:
    """The states of all demonstrations are not kept a second time."""
    task = Task(*(part[1] for part in TASKS))
    states = np.random.default_rng(0).normal(size=(40, 10_000, 2))
    states[7] = states[3]
    made = [Demonstration(f"demo_{k}", rows, task) for k, rows in enumerate(states)]
    tracemalloc.start()
    [warning] = _again(SimpleNamespace(demonstrations=made))  # pyright: ignore[reportArgumentType]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert warning.startswith("demo_3 is given 2 times (as demo_3, demo_7): ")
    assert peak < states.nbytes / 10


def test_the_same_demonstration_twice() -> None:
    evidence = make_evidence()
    items = [make_demonstration(1, "a"), make_demonstration(1, "b"), make_demonstration(2, "c")]
    [warning] = infer(evidence, items).warnings
    assert warning == "a is given 2 times (as a, b): each copy counts as a separate demonstration"
    assert not infer(evidence, items[1:]).warnings


def test_a_margin_that_speaks_for_the_first() -> None:
    columns = np.random.default_rng(0).random((3, 1000, 3)) < [0.01, 0.9, 0.01]
    cells = grid(x=(0.0, 9.0, 3))
    evidence = evidence_of_columns(columns, cells)
    items = [make_demonstration(2, "clear"), make_demonstration(2, "grazing", x=5.9)]
    assert infer(evidence, items).struck_out[1]
    [warning] = infer(evidence, items, margin={"x": 0.2}).warnings
    assert warning.startswith(
        "1 of 2 demonstrations (grazing) enter hypothesis 1 no deeper than the margin"
    )
    assert not infer(evidence, items[:1], margin={"x": 0.2}).warnings


def test_coarse_sampling_is_named_where_segments_count(evidence: Evidence) -> None:
    """The model steps every 0.1 s."""
    between = dataclasses.replace(evidence, problem=make_record(between_states=True))
    goal = TASKS.goal[1]
    assert "rate" not in doubts(straight(goal, num_states=5), between, 1)  # 0.125 s
    text = doubts(straight(goal, num_states=3), between, 1)["rate"]
    assert text.startswith("has states up to 0.25 s apart, where the model steps every 0.1 s")
    assert "rate" not in doubts(straight(goal, num_states=3), evidence, 1)


def test_warnings_name_those_they_are_about(evidence: Evidence) -> None:
    items = [straight(TASKS.start[1] + 0.1 * k, name=f"d{k}") for k in range(6)]
    [warning] = [text for text in infer(evidence, items).warnings if "ends at" in text]
    assert warning.startswith("d0 ends at ")
    assert warning.endswith("(the same holds for d1, d2, d3 and 2 more)")
    good = infer(evidence, [straight(TASKS.goal[1])])
    assert not good.warnings


def test_some_names() -> None:
    assert some_names(["a", "b", "c"]) == "a, b, c"
    assert some_names(["a", "b", "c", "d"]) == "a, b, c and 1 more"


def untimed(evidence: Evidence) -> Evidence:
    """The evidence of a model whose moves take no definite time: at most 0.15 in x."""
    record = make_record(between_states=True, is_timed=False, transitions=None)
    return dataclasses.replace(evidence, problem=record)


@pytest.mark.parametrize("duration", [0.01, 0.3, 5.0, 500.0])
def test_a_model_without_a_clock_has_no_durations_speeds_and_rates(
    evidence: Evidence, duration: float
) -> None:
    item = straight(TASKS.goal[1], duration, num_states=25)
    assert doubts(item, untimed(evidence), 1) == {}
    assert doubts(dataclasses.replace(item, times=None), untimed(evidence), 1) == {}
    assert "duration" in doubts(item, evidence, 1) or duration == 0.5 or duration == 0.3


def test_rows_far_apart_and_jumps_are_told_without_a_clock(evidence: Evidence) -> None:
    """The moves of the model change x by 0.9 at most."""
    found = doubts(straight(TASKS.goal[1], num_states=2), untimed(evidence), 1)
    assert found["move"].startswith("has rows 3 apart in x, where a move of the model changes it ")
    assert "by at most 0.9: the straight lines between them may cut" in found["move"]
    item = straight(TASKS.goal[1], num_states=200)
    item.states[100:, 1] += 3.5
    item.states[:] -= [0.0, 1.0]
    text = doubts(item, untimed(evidence), 1)["move"]
    assert text.startswith("jumps by 3.48 in x from row 100 to row 101, where a move of the model ")
    assert "and the other rows by 0.0151 as a rule: a glitch of the recording?" in text
    assert item.times is not None
    later = item.times + 10.0 * (np.arange(200) >= 100)
    assert "move" not in doubts(dataclasses.replace(item, times=later), untimed(evidence), 1)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_one_that_never_moves(evidence: Evidence, noise: float) -> None:
    """Not by more than a thousandth of the extent, which is noise."""
    item = straight(TASKS.goal[1])
    generator = np.random.default_rng(0)
    states = TASKS.start[1] + noise * generator.uniform(-1.0, 1.0, (11, 2)) * [TWO_PI, 10.0]
    still = Demonstration("still", states, Task(states[0], states[0]), item.times)
    text = doubts(still, evidence, 1)["still"]
    assert text.startswith("never moves: all of its 11 rows are at theta = 3")
    assert "x = 5" in text
    assert text.endswith("not running? It avoids every hypothesis but those that it is in")
    turned = dataclasses.replace(still, states=still.states + np.array([TWO_PI, 0.0]))
    assert "still" in doubts(turned, evidence, 1)
    assert "still" not in doubts(item, evidence, 1)
    slow = dataclasses.replace(item, states=TASKS.start[1] + 0.02 * np.eye(11, 2))
    assert "still" not in doubts(slow, evidence, 1)
