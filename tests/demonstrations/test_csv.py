"""CSV: cells of numbers, whichever way they are read, and the memory that this takes."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from support.demonstration_files import PLANE, read_one, save

from swerve.demonstrations import csv_format
from swerve.demonstrations.csv_format import read_csv
from swerve.demonstrations.demonstration import read_tasks

NO_NUMBERS = (
    "2_5", "0x10", "1 2", "1d3", "TRUE", "\u0661", "1.2.3", "1e", "--1", ".", "e5", "1e400",
    "\xa01", "1;5", "1\x00", "1\x1f", "1\x0b",
)  # fmt: skip


@pytest.mark.parametrize("cell", NO_NUMBERS)
@pytest.mark.parametrize("quoted", [False, True])
def test_a_cell_that_is_no_decimal_number_is_named(tmp_path: Path, cell: str, quoted: bool) -> None:
    """A quoted cell makes the file one whose cells are read one by one."""
    note = '"n"' if quoted else "n"
    path = save(tmp_path / "demo.csv", f"x,note,y\n1,{note},0\n{cell},{note},1\n3,{note},1\n")
    wanted = "a number that a float can hold" if cell == "1e400" else "a number"
    expected = re.escape(f"expected {wanted}, got {cell!r}")
    with pytest.raises(ValueError, match=rf": row 2 \(line 3\), column x: {expected}$"):
        read_one(path)
    path = save(path, f"demo,start_x,start_y,goal_x,goal_y\n1,{cell},0,1,1\n")
    with pytest.raises(ValueError, match=rf": row 1 \(line 2\), column start_x: {expected}$"):
        read_tasks(path, PLANE)


@pytest.mark.parametrize("quoted", [False, True])
def test_blanks_may_stand_around_a_number(tmp_path: Path, quoted: bool) -> None:
    note = '"n"' if quoted else "n"
    path = save(
        tmp_path / "demo.csv", f"x,y,note\n 1 ,\t0,{note}\n+2e0, 0.5\t,{note}\n03., 1,{note}\n"
    )
    np.testing.assert_array_equal(read_one(path).states, [[1, 0], [2, 0.5], [3, 1]])


@pytest.mark.parametrize("at", [2, 10, 400, 999])
@pytest.mark.parametrize("odd", ['"{}"', " {}", "{}"])
def test_files_are_read_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int, odd: str
) -> None:
    """Wherever the first row that is not plain comes, and wherever a part ends."""
    monkeypatch.setattr(csv_format, "PART", 64)
    numbers = np.random.default_rng(at).normal(size=(1000, 3))
    rows = [",".join(map(repr, row)) for row in numbers.tolist()]
    first, _, rest = rows[at].partition(",")
    rows[at] = f"{odd.format(first)},{rest}"
    table = read_csv(save(tmp_path / "a.csv", "\n".join(["a,b,c", *rows])), ["c", "a"], ["d"], None)
    np.testing.assert_array_equal(table.values, numbers[:, [2, 0]])
    assert table.line_of is not None
    assert [table.line_of(row) for row in (0, at, 999)] == [2, at + 2, 1001]
    rows[at] = f"{first},?,{rest.partition(',')[2]}"
    path = save(tmp_path / "a.csv", "\r\n".join(["a,b,c", "", *rows]))
    with pytest.raises(
        ValueError, match=rf"row {at + 1} \(line {at + 3}\), column b: expected a n"
    ):
        read_csv(path, ["b"], [], None)


def test_broken_text_is_named_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "demo.csv"
    path.write_bytes(b"x,y\n" + b"1,0\n" * 9000 + b"2,\xff\n")
    with pytest.raises(ValueError, match=r"not UTF-8 text \(line 9002: invalid start byte\); save"):
        read_one(path)


@pytest.mark.parametrize("note", ["", ",left", ',"left, right"'])
def test_memory_is_a_few_times_the_size_of_the_file(tmp_path: Path, note: str) -> None:
    header = "t,x,y" + ",note" * bool(note)
    rows = [f"{k / 100},{k % 977 / 100},{k % 31 / 50}{note}\n" for k in range(60_000)]
    path = save(tmp_path / "demo.csv", f"{header}\n{''.join(rows)}")
    del rows
    tracemalloc.start()
    try:
        read_one(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5.0 * path.stat().st_size
