"""Parquet is read whatever its path and its damage, by a process of its own."""

from __future__ import annotations

import datetime
import os
import signal
import subprocess
import sys
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from support.demonstration_files import PLANE, ROWS, read_one, save

from swerve.demonstrations import parquet_format
from swerve.demonstrations.demonstration import read_demonstrations, read_tasks
from swerve.demonstrations.formats import read_table

ODD_NAMES = ("demo_[1]", "demo_*", "demo_?", "d*r/a", "x=7/a", "~", "a\\b", "{a,b}", "%41", "a b#c")


def save_parquet(path: Path, **columns: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        pl.DataFrame(columns).write_parquet(file)
    return path


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_path_is_no_pattern(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = ["demo_1", "dir/a", "dr/a", "a", *ODD_NAMES]
    for number, name in enumerate(names):
        x = [1.0, 2.0 + number / 100]
        if suffix == ".csv":
            save(Path(name + suffix), f"x,y\n{x[0]},0\n{x[1]},1\n")
        else:
            save_parquet(Path(name + suffix), x=x, y=[0.0, 1.0])
    for number, name in enumerate(names):
        item = read_one(Path(name + suffix))
        np.testing.assert_array_equal(item.states, [[1, 0], [2 + number / 100, 1]])
    for name in ("de*", "[d]emo_1", "d?r/a", "~/demo_1"):
        with pytest.raises(FileNotFoundError, match="no such file; check the path"):
            read_one(Path(name + suffix))


@pytest.mark.parametrize("scheme", ["s3://", "http://", "https://", "file://", "hf://", "gs://"])
def test_addresses_are_no_files(scheme: str, tmp_path: Path) -> None:
    path = save_parquet(tmp_path / "demo.parquet", x=[1.0, 2.0], y=[0.0, 1.0])
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_demonstrations(f"{scheme}{path}", PLANE)


@pytest.mark.parametrize("name", ["demo.parquet", "demo.csv"])
def test_what_may_never_end_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    for read in (read_one, lambda path: read_tasks(path, PLANE)):
        with pytest.raises(OSError, match=f"{path}: expected a file, got a pipe"):
            read(path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(OSError, match=f"{path}: expected a file, got a device"):
        read_one(path)


def test_a_file_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "demo.csv"
    with path.open("wb") as file:
        file.truncate(2**30 + 1)
    with pytest.raises(ValueError, match="expected at most 1,073,741,824 bytes, got 1,073,741,825"):
        read_one(path)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ([True, False], "expected numbers, got Boolean values"),
        ([datetime.date(2020, 1, 1)] * 2, "expected numbers, got Date values"),
        ([datetime.timedelta(1)] * 2, "expected numbers, got Duration"),
        ([[1.0], [2.0]], r"expected numbers, got List\(Float64\) values"),
        ([{"a": 1}] * 2, "expected numbers, got Struct"),
        ([b"1", b"2"], "expected numbers, got Binary values"),
        ([1.0, float("inf")], r"row 2, column x: expected a finite number, got inf"),
        ([None, None], "expected numbers, got Null values"),
    ],
)
def test_columns_that_hold_no_numbers(tmp_path: Path, column: list[Any], message: str) -> None:
    path = save_parquet(tmp_path / "demo.parquet", x=column, y=[0, 1])
    with pytest.raises(ValueError, match=message):
        read_one(path)


@pytest.mark.parametrize("kind", [pl.Int8, pl.UInt64, pl.Int128, pl.Float32, pl.Decimal(9, 2)])
def test_every_kind_of_number_is_read(tmp_path: Path, kind: Any) -> None:
    path = save_parquet(tmp_path / "demo.parquet", x=pl.Series([1, 2]).cast(kind), y=[0, 1])
    np.testing.assert_array_equal(read_one(path).states, [[1, 0], [2, 1]])
    save_parquet(path, x=[Decimal("0.1"), Decimal("0.2")], y=[0, 1])
    np.testing.assert_array_equal(read_one(path).states, [[0.1, 0], [0.2, 1]])


def test_labels_are_texts_or_whole_numbers(tmp_path: Path) -> None:
    path = tmp_path / "tasks.parquet"
    for labels in (["7", "8"], [7, 8], pl.Series(["7", "8"]).cast(pl.Categorical)):
        save_parquet(path, demo=labels, a=[1.0, 2.0])
        assert read_table(path, ["a"], label="demo").labels == ["7", "8"]
    for labels, message in (
        (["7", None], "row 2, column demo: expected a text, got null"),
        ([7.0, 8.0], "column demo: expected texts, got Float64 values"),
        ([[7], [8]], r"column demo: expected texts, got List\(Int64\) values"),
        ([b"\xff", b"8"], "column demo: expected texts, got Binary values"),
    ):
        save_parquet(path, demo=labels, a=[1.0, 2.0])
        with pytest.raises(ValueError, match=message):
            read_table(path, ["a"], label="demo")


def test_a_file_that_ends_the_reader_is_refused_and_the_next_one_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader here aborts as polars does where memory that a damaged file asks for is not had.

    The true reader has the file before, and the file after.
    """
    good = save_parquet(tmp_path / "good.parquet", x=[1.0, 2.0], y=[0.0, 1.0])
    bad = save(tmp_path / "bad.parquet", f"PAR1 {ROWS} PAR1")
    read_one(good)
    source = parquet_format.CHILD.read_text()
    aborting = tmp_path / "aborting.py"
    abort = 'if b"x,y" in content: __import__("os").abort()'
    aborting.write_text(source.replace("schema = pl", f"{abort}\n    schema = pl"))
    monkeypatch.setattr(parquet_format, "CHILD", aborting)
    parquet_format._end()
    for _ in range(2):
        with pytest.raises(
            ValueError, match=r"bad.parquet: cannot be read as Parquet: damaged, or"
        ):
            read_one(bad)
        assert len(read_one(good).states) == 2
    with pytest.raises(ValueError, match=r"bad\.parquet: cannot be read"):
        read_demonstrations([good, bad], PLANE)
    parquet_format._end()


def test_memory_is_limited(tmp_path: Path) -> None:
    """Constant numbers are a few bytes in a file, whatever their count."""
    path = tmp_path / "demo.parquet"
    part = pl.DataFrame({"x": np.zeros(2**25), "y": np.zeros(2**25)})
    pl.concat([part] * 4, rechunk=False).write_parquet(path)
    assert path.stat().st_size < 2**22
    good = save_parquet(tmp_path / "good.parquet", x=[1.0, 2.0], y=[0.0, 1.0])
    for _ in range(2):
        with pytest.raises(
            ValueError, match=r"cannot be read as Parquet: damaged, or it needs too"
        ):
            read_one(path)
        assert len(read_one(good).states) == 2


@pytest.mark.parametrize("is_noticed", [False, True])
def test_a_reader_that_was_killed_is_started_again(tmp_path: Path, is_noticed: bool) -> None:
    path = save_parquet(tmp_path / "demo.parquet", x=[1.0, 2.0], y=[0.0, 1.0])
    read_one(path)
    child = parquet_format._held()
    assert child is not None
    child.send_signal(signal.SIGKILL)
    if is_noticed:
        child.wait()  # before anything is written to it
    assert len(read_one(path).states) == 2
    assert parquet_format._held() is not child


def test_the_reader_takes_no_module_of_the_current_folder_and_ends_with_its_parent(
    tmp_path: Path,
) -> None:
    path = save_parquet(tmp_path / "demo.parquet", x=[1.0, 2.0], y=[0.0, 1.0])
    for name in ("polars", "json", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('wrong module')\n")
    code = (
        "import sys; from pathlib import Path; from swerve.demonstrations import parquet_format\n"
        f"print(len(parquet_format.read_parquet(Path({str(path)!r}), ['x'], (), None).values))\n"
        "print(parquet_format._held().pid)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=True,
    )
    rows, child = done.stdout.split()
    assert rows == "2"
    with pytest.raises(ProcessLookupError):
        os.kill(int(child), 0)
