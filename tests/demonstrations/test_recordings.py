"""Several recordings in one file are told from rows that are out of order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
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
