"""Files of demonstrations are read, or refused by name and row."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from support.demonstration_files import PENDULUM, PLANE, ROWS, read_one, save

from swerve.demonstrations.demonstration import read_demonstrations, write_demonstrations


class TestReal:
    def test_reads_every_pendulum_demonstration(self, shared_data: Path) -> None:
        folder = shared_data / "pendulum"
        paths = sorted(folder.glob("demo_*.csv"))
        demonstrations = read_demonstrations(
            paths, PENDULUM, tasks=folder / "tasks.csv", action_names=["torque"]
        )
        assert [item.name for item in demonstrations] == [path.stem for path in paths]
        assert len(demonstrations) == 33
        for item in demonstrations:
            assert item.states.shape == (501, 2)
            assert item.states.dtype == np.float64
            assert item.times is not None
            np.testing.assert_allclose(item.times, np.linspace(0, 5, 501), atol=1e-12)
            assert item.actions is not None
            assert item.actions.shape == (501, 1)
            end = np.abs(PENDULUM.difference(item.states[-1], np.asarray(item.task.goal)))
            assert (end < [0.046, 0.031]).all()
        first = demonstrations[0]
        np.testing.assert_array_equal(first.states[1], [-0.845374526, -1.16400602])
        np.testing.assert_array_equal(first.task.start, [-0.8337590205340073, -1.1615505196721068])
        np.testing.assert_array_equal(first.task.goal, [1.6735358776899325, 0.25022707199687577])

    def test_the_last_state_is_the_goal_without_tasks(self, shared_data: Path) -> None:
        (item,) = read_demonstrations(shared_data / "pendulum" / "demo_002.csv", PENDULUM)
        np.testing.assert_array_equal(item.task.start, item.states[0])
        np.testing.assert_array_equal(item.task.goal, [-4.60260435, 0.255115421])
        assert item.actions is None

    def test_written_and_read_again(self, shared_data: Path, tmp_path: Path) -> None:
        folder = shared_data / "pendulum"
        options: dict[str, Any] = {"action_names": ("torque",)}
        originals = read_demonstrations(
            sorted(folder.glob("demo_*.csv")), PENDULUM, tasks=folder / "tasks.csv", **options
        )
        paths = write_demonstrations(tmp_path, originals, PENDULUM, **options)
        back = read_demonstrations(paths, PENDULUM, tasks=tmp_path / "tasks.csv", **options)
        for original, copy in zip(originals, back, strict=True):
            assert original.name == copy.name
            np.testing.assert_array_equal(original.states, copy.states)
            np.testing.assert_array_equal(original.actions, copy.actions)
            np.testing.assert_allclose(original.task.goal, copy.task.goal, rtol=1e-8)


class TestReadingFiles:
    @pytest.mark.parametrize(
        "text",
        [
            ROWS,
            "\ufeff" + ROWS,
            ROWS.replace("\n", "\r\n"),
            ROWS.replace("\n", "\r"),
            ROWS + "\n\n  \n",
            ROWS.rstrip("\n"),
            ROWS.replace("x,y", " x , y "),
            ROWS.replace("3,1", " 3 , 1 "),
            ROWS.replace("2,0.5", "\n2,0.5\n"),
            "\n\n" + ROWS,
            'y,"note","x"\n0,"a, b",1\n0.5,"c\nd",2\n1,,"3"\n',
            "y,note,x,,\n0,a,1,,\n0.5,,2,,\n1,-,3,,\n",
            '"a,b,c,d",x,y\n"-,9,9,-",1,0\n"-,9,9,-",2,0.5\n"-,9,9,-",3,1\n',
            "x,y\n1e0,+0\n2.0,5e-1\n3.,1\n",
        ],
        ids=[
            "plain", "bom", "crlf", "cr", "trailing-lines", "no-last-newline", "spaces-in-header",
            "spaces-in-cells", "blank-lines", "leading-lines", "quotes", "other-columns",
            "quoted-commas", "formats",
        ],
    )  # fmt: skip
    def test_forms_of_csv(self, tmp_path: Path, text: str) -> None:
        item = read_one(save(tmp_path / "demo.CSV", text))
        np.testing.assert_array_equal(item.states, [[1, 0], [2, 0.5], [3, 1]])
        assert item.states.flags.c_contiguous
        assert item.name == "demo"
        assert item.times is None
        assert item.actions is None

    def test_uneven_times_and_actions(self, tmp_path: Path) -> None:
        text = "ay,t,x,y,ax\n4,0.5,1,0,1\n5,0.6,2,0.5,2\n6,3,3,1,3\n"
        item = read_one(save(tmp_path / "demo.csv", text), action_names=("ax", "ay"))
        np.testing.assert_array_equal(item.times, [0.5, 0.6, 3.0])
        np.testing.assert_array_equal(item.actions, [[1, 4], [2, 5], [3, 6]])

    def test_parquet_and_csv_agree(self, tmp_path: Path) -> None:
        columns = {"t": [0, 1, 2], "y": [0.0, 0.5, 1.0], "note": ["a", None, "c"], "x": [1, 2, 3]}
        pl.DataFrame(columns).write_parquet(tmp_path / "demo.parquet")
        item = read_one(tmp_path / "demo.parquet")
        np.testing.assert_array_equal(item.states, [[1, 0], [2, 0.5], [3, 1]])
        np.testing.assert_array_equal(item.times, [0, 1, 2])
        assert item.states.flags.c_contiguous

    def test_a_single_path_need_not_be_in_a_list(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", ROWS)
        assert len(read_demonstrations(str(path), PLANE)) == 1
        assert read_demonstrations([], PLANE) == []

    def test_equal_stems_in_different_folders(self, tmp_path: Path) -> None:
        paths = [save(tmp_path / folder / "demo.csv", ROWS) for folder in "ab"]
        assert [item.name for item in read_demonstrations(paths, PLANE)] == ["demo", "demo"]

    def test_the_same_file_twice_is_refused(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", ROWS)
        other = tmp_path / "folder" / ".." / "demo.csv"
        other.parent.parent.mkdir()
        with pytest.raises(ValueError, match=r"demo\.csv is given 2 times"):
            read_demonstrations([path, other], PLANE)

    def test_goal_of(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", ROWS)
        item = read_one(path, goal_of=lambda states: states[1, :1], goal_names=["line"])
        np.testing.assert_array_equal(item.task.goal, [2])
        with pytest.raises(ValueError, match=r"demo.csv: expected a goal of shape \(2,\), got \(1"):
            read_one(path, goal_of=lambda states: states[1, :1])

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "the file is empty; expected a header"),
            (" \n\n", "the file is empty"),
            ("x,y\n", "a header and no rows"),
            ("x,y\n\n\n", "a header and no rows"),
            ("x,z\n1,2\n", r"no column y; expected x, y in a first line of names .* found x, z"),
            ("1,2\n3,4\n", r"no column x, y; .* found 1, 2"),
            (
                "x;y\n1;2\n",
                r"no column x, y; .* separated by commas, found x;y; .* by semicolons: save",
            ),
            ("x\ty\n1\t2\n", "no column x, y; .* these are separated by tabs: save them"),
            ("# x y\n1 2\n", "no column x, y; .* are separated by spaces: .* points in numbers$"),
            ("x,y,x,a,a\n1,2,3,4,5\n", "more than one column is named x, a; rename them"),
            ("x,y\n1,0\n", "expected at least 2 states, got 1"),
            ("x,y\n1,0\n2\n", r"row 2 \(line 3\): expected 2 cells as the header, got 1"),
            ("x,y\n1,0\n2,1,7\n3,1\n", r"row 2 \(line 3\): expected 2 cells as the header, got 3"),
            ("x,y\n1,0\n2,1,7\n3\n", r"row 2 \(line 3\): expected 2 cells"),
            ("x,y\n1,0\n\n2,?\n", r"row 2 \(line 4\), column y: expected a number, got '\?'"),
            ("x,y\n1,0\n,1\n", r"row 2 \(line 3\), column x: expected a number, got ''"),
            ("x,y\n1,0\n2,1,5\n", r"row 2 \(line 3\): expected 2 cells"),
            ('x,y,n\n1,0,"a\nb"\n2,z,\n', r"row 2 \(line 4\), column y: expected a number, got 'z"),
            ("x,y\n1,0\n2,nan\n", r"row 2 \(line 3\), column y: expected a finite number, got nan"),
            ("x,y\n1,0\n\n-inf,1\n", r"row 2 \(line 4\), column x: expected a finite .* got -inf"),
            ("x,y,t\n1,0,0\n2,1,nan\n", r"row 2 \(line 3\), column t: expected a finite number"),
            (
                "x,y,t\n1,0,0\n2,1,0.5\n3,1,0.5\n",
                r"row 2 \(line 3\) has t = 0.5 and row 3 has t = 0.5; expected times that strictly",
            ),
            ("x,y,t\n1,0,0\n2,1,-1\n", r"row 1 \(line 2\) has t = 0.0 and row 2 has t = -1.0"),
            (
                "x,y\n1,0\n500,1\n",
                (
                    r"row 2 \(line 3\), column x: 500 is more than 10 half-widths .* bounds \[0, 10"
                    r"\]. Another unit\? If it is right, widen the MDP's bounds"
                ),
            ),
            ("x,y\n11,0\n5,1\n", r"start x = 11 is outside the bounds \[0, 10\]"),
            ("x,y\n1,0\n5,2.5\n", r"goal y = 2.5 is outside the bounds \[-2, 2\]"),
        ],
    )
    def test_what_is_wrong_in_a_csv(self, tmp_path: Path, text: str, message: str) -> None:
        path = save(tmp_path / "demo.csv", text)
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: {message}"):
            read_one(path)

    @pytest.mark.parametrize(
        ("columns", "message"),
        [
            ({"x": [1.0, 2.0]}, "no column y; expected x, y, found x$"),
            ({"x": [], "y": []}, "a header and no rows|column x: expected numbers, got Null"),
            ({"x": ["1", "2"], "y": [1, 2]}, "column x: expected numbers, got String values"),
            ({"x": [1.0, None], "y": [1, 2]}, "row 2, column x: expected a number, got null"),
        ],
    )
    def test_what_is_wrong_in_a_parquet_file(
        self, tmp_path: Path, columns: dict[str, list[Any]], message: str
    ) -> None:
        path = tmp_path / "demo.parquet"
        pl.DataFrame(columns).write_parquet(path)
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: {message}"):
            read_one(path)

    @pytest.mark.parametrize("content", [b"", b"x,y\n1,2\n", b"PAR1" + bytes(50) + b"PAR1"])
    def test_what_is_no_parquet_file(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "demo.parquet"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"demo\.parquet: cannot be read as Parquet"):
            read_one(path)

    def test_a_parquet_file_that_is_cut_short(self, tmp_path: Path) -> None:
        path = tmp_path / "demo.parquet"
        pl.DataFrame({"x": [1.0, 2.0], "y": [0.0, 1.0]}).write_parquet(path)
        whole = path.read_bytes()
        for size in (4, 10, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:size])
            message = f"Parquet: it is cut short, after {size} bytes, since Parquet ends with PAR1;"
            with pytest.raises(ValueError, match=message):
                read_one(path)
        for content, message in (
            (b"", "the file is empty;"),
            (b"x,y", "does not begin with PAR1;"),
        ):
            path.write_bytes(content)
            with pytest.raises(ValueError, match=f"{message} save it as Parquet, or name it .csv"):
                read_one(path)

    def test_what_is_no_text(self, tmp_path: Path) -> None:
        path = tmp_path / "demo.csv"
        path.write_bytes(ROWS.encode("utf-16"))
        with pytest.raises(ValueError, match=r"demo\.csv: not UTF-8 text .* save it as CSV in"):
            read_one(path)

    def test_an_open_quote(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", 'x,y\n1,"0\n' + "2,1\n" * 50_000)
        with pytest.raises(ValueError, match=r"demo\.csv: line .*; is a quote open\?"):
            read_one(path)

    def test_paths_that_are_no_files(self, tmp_path: Path) -> None:
        with pytest.raises(FileNotFoundError, match=r"nothing\.csv: no such file; check the path"):
            read_one(tmp_path / "nothing.csv")
        with pytest.raises(
            IsADirectoryError, match=r"is a folder; name the files in it: .*\*\.csv"
        ):
            read_one(tmp_path)
        with pytest.raises(ValueError, match=r"demo\.txt: expected a file ending in .csv or .parq"):
            read_one(save(tmp_path / "demo.txt", ROWS))

    def test_some_of_the_actions_are_refused(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", "x,y,ax\n1,0,1\n2,1,1\n")
        with pytest.raises(
            ValueError, match="no column ay; expected all of the actions ax, ay, or"
        ):
            read_one(path, action_names=["ax", "ay"])
        assert read_one(path, action_names=["bx"]).actions is None

    def test_actions_are_finite(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo.csv", "x,y,ax\n1,0,1\n2,1,nan\n3,1,1\n")
        with pytest.raises(ValueError, match=r"row 2 \(line 3\), column ax: expected a finite num"):
            read_one(path, action_names=["ax"])

    @pytest.mark.parametrize("blank", ["", " ", "nan"])
    def test_no_action_need_follow_the_last_state(self, tmp_path: Path, blank: str) -> None:
        path = save(tmp_path / "demo.csv", f"x,y,ax\n1,0,1\n2,1,2\n3,1,{blank}\n")
        actions = read_one(path, action_names=["ax"]).actions
        np.testing.assert_array_equal(actions, [[1.0], [2.0]])
        pl.DataFrame({"x": [1, 2], "y": [0, 1], "ax": [3.0, None]}).write_parquet(
            tmp_path / "demo.parquet"
        )
        actions = read_one(tmp_path / "demo.parquet", action_names=["ax"]).actions
        np.testing.assert_array_equal(actions, [[3.0]])

    def test_blank_cells_elsewhere_are_refused(self, tmp_path: Path) -> None:
        for text, at in (
            ("1,0,\n2,1,1\n", "row 1 .* column ax: expected a number, got ''"),
            ("1,0,1\n2,,1\n", "row 2 .* column y: expected a number, got ''"),
        ):
            path = save(tmp_path / "demo.csv", f"x,y,ax\n{text}")
            with pytest.raises(ValueError, match=at):
                read_one(path, action_names=["ax"])

    def test_the_tasks_are_no_demonstration(self, tmp_path: Path) -> None:
        tasks = save(tmp_path / "tasks.csv", "demo,start_x\n")
        with pytest.raises(ValueError, match=r"tasks\.csv is given as a demonstration and as the"):
            read_demonstrations([tmp_path / "a.csv", tasks], PLANE, tasks=tasks)


def test_all_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"demo_{k}.csv", ROWS) for k in range(14)]
    for path in paths[1:13]:
        path.write_text("x,y\n1,0\n1,nan\n")
    with pytest.raises(ValueError, match="12 of 14 files cannot be used:") as raised:
        read_demonstrations(paths, PLANE)
    lines = str(raised.value).split("\n")
    assert len(lines) == 12
    for path, line in zip(paths[1:11], lines[1:11], strict=True):
        assert f"{path}: row 2" in line
    assert lines[-1].strip() == "... and 2 more"
