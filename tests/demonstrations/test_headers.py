"""Names of columns that say time, and names that are misspelt."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from support.synthetic import make_evidence, make_record

from swerve import ActionBox, infer, read_demonstrations
from swerve.base.space import StateSpace, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.headers import (
    names_recordings,
    nearly,
    notes_on_columns,
    tells_recordings,
)
from swerve.hypotheses.base import ConstraintHypotheses

SPACE = StateSpace(("x", "v"), (), np.array([[-3.0, 3.0], [-4.0, 4.0]]))
ROWS = [[0.0, -1.0, 0.5], [0.1, -0.9, 0.5], [0.2, -0.8, 0.5]]


def read(path: Path, *header: str, rows=ROWS, action_names=()) -> Demonstration:
    if path.suffix == ".csv":
        lines = [",".join(header), *(",".join(map(str, row)) for row in rows)]
        path.write_text("\n".join(lines))
    else:
        pl.DataFrame(dict(zip(header, zip(*rows, strict=True), strict=True))).write_parquet(path)
    (item,) = read_demonstrations([path], SPACE, action_names=action_names)
    return item


TIMES = ("t", "time", "T", "Time", "t [s]", "t(s)", "t_s", "time_s", "Time [sec]", "timestamp")
TIMES = (*TIMES, "TIMESTAMP", "stamp", "sec", "secs", "seconds", "elapsed_s", "times")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("name", TIMES)
def test_the_only_column_that_says_time_is_taken(tmp_path: Path, name: str, suffix: str) -> None:
    item = read(tmp_path / f"a{suffix}", "x", name, "v", rows=[[r[1], r[0], r[2]] for r in ROWS])
    assert item.times is not None
    assert item.times.tolist() == [0.0, 0.1, 0.2]
    assert item.states[:, 1].tolist() == [0.5] * 3
    assert item.notes == ()


@pytest.mark.parametrize("header", ["# t", "#t", "# time", "#"])
def test_a_hash_before_the_header_is_no_part_of_a_name(tmp_path: Path, header: str) -> None:
    item = read(tmp_path / "a.csv", header, "x", "v")
    assert (item.times is None) == (header == "#")
    states_first = read(tmp_path / "b.csv", "# x", "v", "t", rows=[r[1:] + r[:1] for r in ROWS])
    assert states_first.times is not None
    assert states_first.states[:, 0].tolist() == [-1.0, -0.9, -0.8]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("t_ms", "x", "v"), "'t_ms'"),
        (("time [ns]", "x", "v"), "'time [ns]'"),
        (("timestamp_us", "x", "v"), "'timestamp_us'"),
        (("header.stamp.secs", "x", "v"), "'header.stamp.secs'"),
        (("DateTime", "x", "v"), "'DateTime'"),
        (("update", "x", "v"), None),
        (("min", "x", "v"), None),
        (("frame", "x", "v"), None),
        (("temperature", "x", "v"), None),
        (("torque", "x", "v"), None),
    ],
)
def test_a_time_that_is_not_taken_is_told(tmp_path: Path, names, told: str | None) -> None:
    item = read(tmp_path / "a.csv", *names)
    assert item.times is None
    if told is None:
        assert item.notes == ()
        return
    [note] = item.notes
    assert note == (
        f"has no column t, and {told} was not taken for it: expected one column of seconds that "
        "strictly increase. Durations, rates and speeds are not checked: convert the times to "
        "seconds, and name them t"
    )


NOISE = 0.02 * np.random.default_rng(0).standard_normal(40)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("T", 21.0 + NOISE),  # a temperature
        ("T", np.round(21.0 + np.sin(np.arange(40) / 5.0), 2)),
        ("sec", (58 + np.arange(40)) % 60),  # of the minute
        ("sec", (58 + np.arange(100)) % 60),
        ("s", np.zeros(40)),
        ("timestamp", 1.7e18 + 5e7 * np.arange(40)),
        ("%time", 1.7e18 + 5e7 * np.arange(40)),
        ("timestamp", 1.7e15 + 5e4 * np.arange(40)),
        ("timestamp", 1.7e12 + 50.0 * np.arange(40)),
        ("timestamp", np.tile(1.7e18 + 5e7 * np.arange(20), 2)),
    ],
)
def test_what_cannot_be_seconds_is_not_taken(
    tmp_path: Path, name: str, values: np.ndarray, suffix: str
) -> None:
    rows = [[0.0, 0.5, float(value), k // 60] for k, value in enumerate(values)]
    item = read(tmp_path / f"a{suffix}", "x", "v", name, "minute", rows=rows)
    assert item.times is None
    assert item.states.shape == (len(values), 2)
    told = f"'{name}' was not taken for it: expected one column of seconds that strictly increase"
    assert name == "s" or told in item.notes[0]


def test_seconds_since_1970_are_taken(tmp_path: Path) -> None:
    rows = [[1.7e9 + 0.05 * k, 0.0, 0.5] for k in range(40)]
    times = read(tmp_path / "a.csv", "timestamp", "x", "v", rows=rows).times
    assert times is not None
    np.testing.assert_allclose(np.diff(times), 0.05, rtol=1e-4)


def test_two_times_dates_and_clocks_that_stand_still_are_not_taken(tmp_path: Path) -> None:
    both = [[*row, row[0]] for row in ROWS]
    item = read(tmp_path / "a.csv", "time", "x", "v", "stamp", rows=both)
    assert item.times is None
    assert "'time' or 'stamp' was not taken" in item.notes[0]
    dates = [[f"2024-01-0{k + 1}", *row[1:]] for k, row in enumerate(ROWS)]
    for suffix in (".csv", ".parquet"):
        item = read(tmp_path / f"b{suffix}", "time", "x", "v", rows=dates)
        assert item.times is None
        assert "'time' was not taken" in item.notes[0]
    still = [[7, *row[1:]] for row in ROWS]
    assert read(tmp_path / "c.csv", "time", "x", "v", rows=still).times is None
    t_and_time = read(tmp_path / "d.csv", "t", "x", "v", "time", rows=both)
    assert t_and_time.times is not None
    assert t_and_time.notes == ()


def test_a_misspelt_action_is_told_and_a_misspelt_state_is_named(tmp_path: Path) -> None:
    rows = [[*row, 1.0] for row in ROWS]
    item = read(
        tmp_path / "a.csv", "t", "x", "v", "Torque [Nm]", rows=rows, action_names=["torque"]
    )
    assert item.actions is None
    assert item.notes == (
        "has no column torque, and 'Torque [Nm]' was not taken for it: rename the column",
    )
    with pytest.raises(
        ValueError, match=r"no column v; .*found t, x, V \[m/s\]; rename 'V \[m/s\]'"
    ):
        read(tmp_path / "b.csv", "t", "x", "V [m/s]")
    with pytest.raises(ValueError, match=r"no column v; expected x, v .*found t, x, speed$"):
        read(tmp_path / "c.csv", "t", "x", "speed")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("action", "name", "is_near"),
    [
        ("torque", "torqe", True),
        ("torque", "Troque", True),
        ("torque", "torques", True),
        ("torque", "torque_Nm", True),
        ("steering_angle", "stering angle (deg)", True),
        ("acc", "accl", True),
        ("torque", "temperature", False),
        ("force", "source", False),
        ("u", "ux", False),
        ("steering_rate", "steering_angle", False),
        ("acceleration", "deceleration", False),
        ("acc_x", "acc_z", False),
        ("heading_rate", "heading_rad", False),
        ("velocity", "velocity_ref", False),
        ("acc_x", "acc_X", True),
        ("dx", "ddx", False),
    ],
)
def test_the_closest_column_is_told_for_an_action(
    tmp_path: Path, action: str, name: str, is_near: bool, suffix: str
) -> None:
    rows = [[*row, 1.0, 2.0] for row in ROWS]
    header = ("t", "x", "v", "current", name)
    item = read(tmp_path / f"a{suffix}", *header, rows=rows, action_names=[action])
    assert item.actions is None
    note = f"has no column {action}, and '{name}' was not taken for it: rename the column"
    assert item.notes == ((note,) if is_near else ())


def test_some_of_the_actions_and_states_name_the_closest_columns(tmp_path: Path) -> None:
    rows = [[*row, 1.0, 2.0] for row in ROWS]
    names, path = ("t", "x", "v", "force_left", "force_rigth"), tmp_path / "a.csv"
    match = (
        "no column force_right; expected all of the actions .* or none; rename 'force_rigth'[?]$"
    )
    with pytest.raises(ValueError, match=match):
        read(path, *names, rows=rows, action_names=["force_left", "force_right"])
    space = StateSpace(("speed_x", "speed_y"), (), SPACE.bounds)
    path.write_text("speed_x,sped_y\n0,0\n1,1")
    with pytest.raises(ValueError, match=r"no column speed_y; .*; rename 'sped_y'\?$"):
        read_demonstrations([path], space)
    path.write_text("speed_x,other\n0,0\n1,1")
    with pytest.raises(ValueError, match=r"no column speed_y; .* found speed_x, other$"):
        read_demonstrations([path], space)


def test_where_actions_are_needed_the_error_names_the_closest_column(tmp_path: Path) -> None:
    names, rows = ("t", "x", "v", "torqe"), [[*row, 1.0] for row in ROWS]
    item = read(tmp_path / "a.csv", *names, rows=rows, action_names=["torque"])
    told = r"; its file has no column torque, and 'torqe' was not taken for it: rename the column$"
    pushes = ConstraintHypotheses([ActionBox(torque=(0.0, 1.0))])
    record = make_record(space=SPACE, action_names=("torque",), hypotheses=pushes)
    evidence = make_evidence(record, tasks=Task(*(part[None] for part in item.task)))
    with pytest.raises(ValueError, match=rf"needs its actions, columns torque, got none{told}"):
        infer(evidence, [item])
    late = dataclasses.replace(item, notes=("has no column t, and so on",))
    with pytest.raises(ValueError, match=r"needs its actions, columns torque, got none$"):
        infer(evidence, [late])


def test_infer_tells_the_notes() -> None:
    evidence = make_evidence()
    task = evidence.tasks
    states = np.repeat(task.start[:1], 3, axis=0)
    item = Demonstration("demo", states, type(task)(task.start[0], task.goal[0]))
    noted = dataclasses.replace(item, notes=("has no column t, and so on",))
    assert infer(evidence, [noted]).warnings[0] == "demo has no column t, and so on"
    assert "has no column t, and so on" not in infer(evidence, [item]).warnings


@pytest.mark.parametrize("mark", ["[", "(", "m[", "(["])
def test_a_long_name_of_brackets_takes_no_time(mark: str) -> None:
    """In a tenth of a second, where the square of the length would take half a minute."""
    name = mark * (40_000 // len(mark))
    began = time.process_time()
    assert nearly("goal_yaw", ["goal_yaw [rad]", name]) == ["goal_yaw [rad]"]
    assert not tells_recordings(f"{name} min")
    assert not names_recordings(name)
    assert notes_on_columns([name], ["t"]) == ()
    assert time.process_time() - began < 2.0
