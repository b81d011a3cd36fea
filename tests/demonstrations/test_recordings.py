"""Several recordings in one file are told from rows that are out of order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from swerve import read_demonstrations
from swerve.base.space import StateSpace

SPACE = StateSpace(("x", "v"), (), np.array([[-3.0, 3.0], [-4.0, 4.0]]))
SPLIT = "several recordings in one file[?] Split it, one file each"
SORT = "sort the rows, or remove those recorded twice$"


def error_of(path: Path, times: np.ndarray, **others: np.ndarray | list) -> str:
    """What reading says of rows with these times and further columns."""
    columns = {"t": times, "x": np.zeros(len(times)), "v": np.zeros(len(times)), **others}
    lines = [
        ",".join(columns),
        *(",".join(map(str, r)) for r in zip(*columns.values(), strict=True)),
    ]
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match="expected times that strictly increase") as caught:
        read_demonstrations([path], SPACE)
    return str(caught.value)


ONE = np.arange(20) / 10


def test_times_since_1970_whose_last_digits_are_cut(tmp_path: Path) -> None:
    for times in (1.7e9 + np.floor(ONE), 1.7e12 + 100.0 * np.floor(10.0 * ONE / 2.0)):
        text = error_of(tmp_path / "a.csv", times)
        assert "times since 1970 with too few digits? Save them with all digits, or as" in text
        assert "several recordings" not in text
    back = np.concatenate([1.7e9 + ONE, 1.7e9 + ONE])
    assert "several recordings in one file?" in error_of(tmp_path / "a.csv", back)


@pytest.mark.parametrize(
    "times",
    [
        np.concatenate([ONE, ONE]),
        np.concatenate([ONE, ONE + 0.5, ONE]),
        np.concatenate([ONE + 100.0, ONE + 100.7]),
        np.concatenate([ONE + 9.0, ONE]),
        np.repeat(ONE, 2),
        np.repeat(ONE, 3),
    ],
)
def test_recordings_below_one_another_and_mixed(tmp_path: Path, times: np.ndarray) -> None:
    text = error_of(tmp_path / "a.csv", times)
    assert "several recordings in one file? Split it, one file each; to sort the rows" in text
    assert "tells them apart" not in text


def test_the_column_that_tells_them_apart_is_named(tmp_path: Path) -> None:
    times = np.concatenate([ONE, ONE])
    index = np.repeat([3, 4], 20)
    columns = {"name": ["a"] * 40, "frame": np.arange(40), "episode_index": index}
    assert error_of(tmp_path / "a.csv", times, **columns).endswith(
        ". The column episode_index tells them apart"
    )
    mixed = error_of(tmp_path / "b.csv", np.repeat(ONE, 2), id=np.tile([7, 9], 20))
    assert mixed.endswith(". The column id tells them apart")
    named = error_of(tmp_path / "c.csv", np.repeat(ONE, 2), vehicle=np.tile(["red", "blue"], 20))
    assert named.endswith(". The column vehicle tells them apart")


@pytest.mark.parametrize(
    "times",
    [
        np.random.default_rng(0).permutation(ONE),
        np.concatenate([ONE[:9], ONE[[10, 9]], ONE[11:]]),
        np.concatenate([ONE[:9], ONE[8:]]),
        ONE[::-1],
    ],
)
def test_rows_out_of_order_are_to_be_sorted(tmp_path: Path, times: np.ndarray) -> None:
    text = error_of(tmp_path / "a.csv", times)
    assert text.endswith("sort the rows, or remove those recorded twice")


def test_the_name_of_a_folder_says_nothing_about_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "several recordings in one file"
    folder.mkdir()
    times = np.concatenate([ONE[:9], ONE[[10, 9]], ONE[11:]])
    text = error_of(folder / "a.csv", times, gear=np.repeat([1, 2], 10))
    assert text.endswith("sort the rows, or remove those recorded twice")


def test_a_column_of_many_values_may_tell_them_apart(tmp_path: Path) -> None:
    """Or may not: within a value times have to increase, however the rows lie."""
    times = np.repeat(np.arange(2.0), 500)
    number = np.random.default_rng(0).permutation(500)
    columns = {"noise": np.random.default_rng(1).random(1000), "number": np.tile(number, 2)}
    assert error_of(tmp_path / "a.csv", times, **columns).endswith(
        "The column number tells them apart"
    )
    again = np.repeat(number, 2)
    assert "apart" not in error_of(tmp_path / "a.csv", times, number=again)


def test_a_time_column_of_another_name_is_looked_at_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{t},0.1,0.2" for t in np.concatenate([ONE, ONE])]
    path.write_text("\n".join(["timestamp,x,v", *rows]))
    with pytest.raises(ValueError, match=SPLIT) as caught:
        read_demonstrations([path], SPACE)
    assert "row 20 (line 21) has timestamp = 1.9 and row 21 has timestamp = 0.0" in str(
        caught.value
    )


def test_recordings_that_begin_at_other_times_are_told_by_another_column(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    starts = np.repeat([3.0, 9.0, 1.0], 20)
    rows = [f"{t},{k // 20},0.1,0.2" for k, t in enumerate(np.tile(ONE, 3) + starts)]
    path.write_text("\n".join(["time,person,x,v", *rows]))
    with pytest.raises(ValueError, match="The column person tells them apart"):
        read_demonstrations([path], SPACE)


def written(path: Path, **columns: np.ndarray | list) -> Path:
    """A file with states that lie still, unless they are given, and these columns."""
    num = len(next(iter(columns.values())))
    table = {"x": [0.0] * num, "v": [0.0] * num, **{k: list(c) for k, c in columns.items()}}
    if path.suffix == ".parquet":
        pl.DataFrame(table).write_parquet(path)
        return path
    rows = [",".join(map(str, row)) for row in zip(*table.values(), strict=True)]
    path.write_text("\n".join([",".join(table), *rows]))
    return path


NAMES = ("episode_index", "episode", "traj", "trajectory", "track_id", "agent", "robot", "id")
NAMES = (
    *NAMES,
    "run",
    "demo",
    "Trial No",
    "run#",
    "trajectoryId",
    "recording-number",
    "persons_id",
    "ep_idx",
    "seq_name",
)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("name", "values", "told"),
    [
        *((name, np.repeat([3, 4], 20), "2 values (3, 4)") for name in NAMES),
        ("id", np.tile([7.5, 9.0], 20), "2 values (7.5, 9)"),
        ("robot", ["left"] * 20 + ["right"] * 20, "2 values (left, right)"),
        ("run", np.repeat(np.arange(20), 2), "20 values (0, 1, 2 and 17 more)"),
        ("demo", ["a", "a", "b"], "2 values (a, b)"),
    ],
)
def test_a_column_that_numbers_recordings_tells_them(
    tmp_path: Path, name: str, values: np.ndarray | list, told: str, suffix: str
) -> None:
    """Whether times go on from recording to recording, while states jump, or there are none."""
    x = np.unique(values, return_inverse=True)[1] / 10.0
    for number, times in enumerate(({}, {"t": np.arange(len(values)) / 10, "x": x})):
        path = written(tmp_path / f"{number}{suffix}", **{name: values, **times})
        with pytest.raises(ValueError, match="several recordings in one file: split") as caught:
            read_demonstrations([path], SPACE)
        assert str(caught.value) == (
            f"{path}: column {name} has {told}, so there are several recordings in one file: split "
            "it, one file for each value. If the column says something else, leave it out or "
            "rename it"
        )


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("episode", [3] * 40),
        ("robot", ["left"] * 40),
        ("id", np.arange(40)),
        ("id", [f"row {k}" for k in range(40)]),
        ("id", [*range(39), 38]),  # a row that was recorded twice
        ("run", [True] * 20 + [False] * 20),
        ("frame", np.repeat([3, 4], 20)),
        ("gear", ["low"] * 20 + ["high"] * 20),
        ("track_error", np.repeat([0.25, 0.5], 20)),
    ],
)
def test_one_recording_and_columns_of_something_else(
    tmp_path: Path, name: str, values: np.ndarray | list, suffix: str
) -> None:
    [item] = read_demonstrations([written(tmp_path / f"a{suffix}", **{name: values})], SPACE)
    assert item.states.shape == (40, 2)


T = np.arange(200) / 10
SMOOTH = np.sin(T / 4.0)
ROW = np.arange(200)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    ("name", "values", "is_told"),
    [
        ("seq", ROW // 5, False),  # of a slower sensor
        ("seq", ROW % 64, False),  # a number that wraps
        ("sequence", ROW // 5, True),
        ("run", ROW // 50 % 2, False),
        ("human", ROW // 100, False),
        ("driver", ["yes"] * 90 + ["no"] * 110, False),
        ("user", ["On", "off"] * 100, False),
        ("objects", ROW // 70, False),  # counts
        ("humans", ROW // 70, False),
        ("agents", 1 + ROW // 30 % 4, False),
        ("scene", ["hall"] * 90 + ["kitchen"] * 110, True),
        ("object", ["none"] * 90 + ["cup"] * 60 + ["none"] * 50, True),
        ("id", 256 + ROW % 3, True),  # of three messages in turn
        ("track", 3 + ROW // 40 % 3, True),  # of whoever is nearest
    ],
)
def test_times_and_states_that_go_on_are_one_recording(
    tmp_path: Path, name: str, values: np.ndarray | list, is_told: bool, suffix: str
) -> None:
    path = written(tmp_path / f"a{suffix}", **{name: values, "t": T, "x": SMOOTH})
    [item] = read_demonstrations([path], SPACE)
    assert item.times is not None
    assert len(item.notes) == is_told
    for note in item.notes:
        assert note.startswith(f"has {len(set(values))} values in column {name} (")
        assert note.endswith(
            "): if these are several recordings, split the file, one file for each value"
        )


@pytest.mark.parametrize(
    ("values", "changes"),
    [
        (ROW // 100, {"x": np.tile(SMOOTH[:100], 2)}),  # back to the start
        (ROW // 50, {"t": T + 2.0 * (ROW >= 100)}),
        (ROW % 2, {"x": SMOOTH + ROW % 2}),  # two persons, row by row
        (ROW // 3 % 2, {"x": SMOOTH + ROW // 3 % 2}),
        (["1", *[""] * 99, "2", *[""] * 99], {"x": np.tile(SMOOTH[:100], 2)}),
    ],
)
def test_times_go_on_and_states_or_times_jump_with_the_value(
    tmp_path: Path, values: np.ndarray | list, changes: dict[str, np.ndarray]
) -> None:
    columns = {"person": values, "t": T, "x": SMOOTH, **changes}
    with pytest.raises(ValueError, match=r"column person has . values .*: split it, one file for"):
        read_demonstrations([written(tmp_path / "a.csv", **columns)], SPACE)


@pytest.mark.parametrize("row", [50, 100])
def test_a_jump_within_a_recording_says_nothing_of_its_labels(tmp_path: Path, row: int) -> None:
    """Nor does one at a change of a label that comes back."""
    glitch = SMOOTH + 1.5 * (row == ROW)
    values = np.array([0, 2, 0, 3])[ROW // 50] if row == 100 else ROW // 100
    path = written(tmp_path / "a.csv", person=values + 5, t=T, x=glitch)
    [item] = read_demonstrations([path], SPACE)
    assert item.notes[0].startswith("has ")


def test_seconds_and_nanoseconds_from_0_are_no_recordings(tmp_path: Path) -> None:
    """Nor are other parts of a time."""
    for name in ("nanosecs", "nanosec", "nsec", "stamp.nanoseconds", "milliseconds", "usecs"):
        parts = {"secs": ROW // 10, name: ROW % 10 * 100}
        [item] = read_demonstrations([written(tmp_path / "a.csv", **parts)], SPACE)
        assert item.times is None
        assert "'secs'" in item.notes[0]


def test_a_value_in_the_first_row_of_each_recording_alone(tmp_path: Path) -> None:
    values = [""] * 40
    values[0], values[20] = "1", "2"
    with pytest.raises(ValueError, match=r"column run has 2 values \(1, 2\)"):
        read_demonstrations([written(tmp_path / "a.csv", run=values)], SPACE)


def test_a_state_or_an_action_of_such_a_name_numbers_nothing(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", id=np.repeat([0.5, 1.0], 20), run=np.repeat([0, 1], 20))
    space = StateSpace(("x", "id"), (), SPACE.bounds)
    [item] = read_demonstrations([path], space, action_names=["run"])
    assert item.actions is not None
    with pytest.raises(ValueError, match="column run has 2 values"):
        read_demonstrations([path], space)


def test_a_turn_too_wide_back_to_the_start_may_be_another_recording(tmp_path: Path) -> None:
    space = StateSpace(("x", "v"), ("x",), np.array([[0.0, 6.4], [-4.0, 4.0]]))
    path = tmp_path / "a.csv"
    once = [f"{x},0" for x in np.linspace(0.1, 3.1, 9)]
    path.write_text("\n".join(["x,v", *once, *once]))
    with pytest.raises(ValueError, match=r"too close to pi .* are expected\. Several recordings"):
        read_demonstrations([path], space)
    path.write_text("\n".join(["x,v", *once, "5.95,0"]))
    with pytest.raises(ValueError, match=r"too close to pi .* are expected$"):
        read_demonstrations([path], space)
