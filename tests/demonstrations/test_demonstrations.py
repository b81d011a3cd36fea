import math
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.demonstrations.checks import START_TOLERANCE, check_states
from swerve.demonstrations.demonstration import (
    Demonstration,
    read_demonstrations,
    read_tasks,
    write_demonstrations,
)

PENDULUM = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-6.0, 6.0]]))
PLANE = StateSpace(("x", "y"), (), np.array([[0.0, 10.0], [-2.0, 2.0]]))
ROWS = "x,y\n1,0\n2,0.5\n3,1\n"
TASKS = "demo,start_x,start_y,goal_x,goal_y\n7,1,0,3,1\n8,5,0,6,1\n"


def save(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())
    return path


def read_one(path: Path, **options: Any) -> Demonstration:
    (demonstration,) = read_demonstrations([path], PLANE, **options)
    return demonstration


def make(states: Sequence[Sequence[float]], name: str = "a", **parts: Any) -> Demonstration:
    return Demonstration(
        name, np.array(states), Task(np.array(states[0]), np.array(states[-1])), **parts
    )


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
            ("x;y\n1;2\n", r"no column x, y; .* separated by commas, found x;y"),
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
            ({"x": [1.0, 2.0]}, "no column y; expected x, y"),
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


class TestChecks:
    def test_good_states_pass(self) -> None:
        turns = np.linspace(0, 60, 100)
        for theta in (turns, turns % TWO_PI, -turns, -turns % TWO_PI):
            check_states(np.stack([theta, 0 * theta], axis=1), None, PENDULUM, "a")

    @pytest.mark.parametrize(
        ("states", "message"),
        [
            (np.zeros((3, 1)), r"a: expected states of shape \(any, 2\), got \(3, 1\)"),
            (np.zeros(2), r"a: expected states of shape \(any, 2\), got \(2,\)"),
            (np.zeros((0, 2)), r"a: expected at least 2 states, got 0"),
            (np.array([[0, 0], [180.0, 0]]), r"a: row 2, column theta: 180 is an angle of more"),
            (np.array([[-64, 0], [-64.0, 0]]), r"than 10 turns. Degrees\? Radians are expected; "),
            (np.array([[0, 0], [0, 61.0]]), r"row 2, column omega: 61 is more than 10 half-width"),
            (np.array([[0, 0], [0, 0], [3.0, 0]]), r"row 3, column theta: 3.000 rad from the row "),
            (np.array([[0, 0], [TWO_PI - 3, 0]]), r"too close to pi .* higher sampling rate. Degr"),
            (np.array([[0, 0], [0, np.nan]]), r"a: row 2, column omega: expected a finite number"),
        ],
    )
    def test_what_is_wrong_in_states(self, states: np.ndarray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            check_states(states, None, PENDULUM, "a")

    def test_limits(self) -> None:
        near = np.array([[0.0, 0.0], [0.999 * 0.9 * math.pi, 0.0]])
        check_states(near, None, PENDULUM, "a")
        check_states(near[:, ::-1] * [1, 4], None, PLANE, "a")  # no angles there
        with pytest.raises(ValueError, match="too close to pi"):
            check_states(near * 1.002, None, PENDULUM, "a")
        check_states(np.array([[0.0, 0.0], [0.0, 59.9]]), None, PENDULUM, "a")
        check_states(np.array([[55.0, 0.0], [-45.0, 0.0]]), None, PLANE, "a")
        with pytest.raises(ValueError, match=r"-45\.1 is more than"):
            check_states(np.array([[55.0, 0.0], [-45.1, 0.0]]), None, PLANE, "a")

    def test_times(self) -> None:
        states = np.zeros((3, 2))
        check_states(states, np.array([1.7e9, 1.7e9 + 1e-3, 1.7e9 + 1]), PENDULUM, "a")
        with pytest.raises(ValueError, match=r"a: expected times of shape \(3,\), got \(2,\)"):
            check_states(states, np.zeros(2), PENDULUM, "a")
        with pytest.raises(ValueError, match=r"a: row 2 has t = 1.0 and row 3 has t = 1.0"):
            check_states(states, np.array([0, 1, 1]), PENDULUM, "a")

    def test_demonstrations_made_in_code(self) -> None:
        item = make([[0, 1], [2, 3]], times=[0, 1], actions=[[5]])
        assert item.states.dtype == np.float64
        assert item.times is not None
        assert item.times.dtype == np.float64
        assert item.actions is not None
        assert item.actions.shape == (1, 1)
        assert isinstance(item.task.start, np.ndarray)

    @pytest.mark.parametrize(
        ("parts", "message"),
        [
            ({"states": np.zeros(3)}, r"d: expected states of shape \(any, any\), got \(3,\)"),
            ({"task": Task(np.zeros(3), np.zeros(2))}, r"d: expected a start of shape \(2,\), got"),
            (
                {"task": Task(np.zeros(2), np.zeros((1, 2)))},
                r"d: expected a goal of shape \(any,\)",
            ),
            ({"times": np.zeros(4)}, r"d: expected times of shape \(3,\), got \(4,\)"),
            ({"actions": np.zeros(3)}, r"d: expected actions of shape \(any, any\), got \(3,\)"),
            ({"actions": np.zeros((1, 1))}, "d: expected 2 or 3 actions for 3 states, got 1"),
            ({"actions": np.zeros((4, 1))}, "d: expected 2 or 3 actions for 3 states, got 4"),
        ],
    )
    def test_shapes_of_demonstrations_made_in_code(
        self, parts: dict[str, Any], message: str
    ) -> None:
        good = {"states": np.zeros((3, 2)), "task": Task(np.zeros(2), np.zeros(2))}
        with pytest.raises(ValueError, match=message):
            Demonstration("d", **(good | parts))


class TestTasks:
    @pytest.mark.parametrize("stem", ["7", "demo_7"])
    @pytest.mark.parametrize("suffix", [".csv", ".parquet"])
    def test_matched_by_name(self, tmp_path: Path, stem: str, suffix: str) -> None:
        path = save(tmp_path / f"{stem}.csv", ROWS)
        tasks = save(tmp_path / "tasks.csv", TASKS.replace("3,1", "4,2"))
        if suffix == ".parquet":
            frame = pl.read_csv(tasks, schema_overrides={"demo": pl.String})
            tasks = tmp_path / "tasks.parquet"
            frame.write_parquet(tasks)
        item = read_one(path, tasks=tasks)
        np.testing.assert_array_equal(item.task.goal, [4, 2])
        assert item.name == stem

    def test_read_tasks(self, tmp_path: Path) -> None:
        text = "goal_line,start_y,demo,start_x,note\n9, 0,007,1,x\n8,1,demo_b,2,\n"
        tasks = read_tasks(save(tmp_path / "tasks.csv", text), PLANE, ["line"])
        assert list(tasks) == ["007", "demo_b"]
        np.testing.assert_array_equal(tasks["007"].start, [1, 0])
        np.testing.assert_array_equal(tasks["007"].goal, [9])

    def test_a_goal_that_is_no_state_may_lie_anywhere(self, tmp_path: Path) -> None:
        text = "demo,start_x,start_y,goal_line\na,1,0,1e6\n"
        tasks = read_tasks(save(tmp_path / "tasks.csv", text), PLANE, ["line"])
        np.testing.assert_array_equal(tasks["a"].goal, [1e6])

    def test_angles_may_lie_anywhere(self, tmp_path: Path) -> None:
        text = "demo,start_theta,start_omega,goal_theta,goal_omega\n1,-1,0,12,6\n"
        (task,) = read_tasks(save(tmp_path / "tasks.csv", text), PENDULUM).values()
        np.testing.assert_array_equal(task.goal, [12, 6])
        path = save(tmp_path / "1.csv", f"theta,omega\n{TWO_PI - 1},0\n5.8,0\n")
        read_demonstrations([path], PENDULUM, tasks=tmp_path / "tasks.csv")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                "demo,start_x,start_y,goal_x\n",
                "no column goal_y; expected demo, start_x, start_y, ",
            ),
            ("start_x,start_y,goal_x,goal_y\n", "no column demo; expected demo, start_x"),
            ("demo,start_x,start_y,goal_x,goal_y\n", "a header and no rows"),
            (TASKS + "7,1,0,3,2\n", "two rows for demo '7'; keep one of them"),
            (TASKS + "9,1,0,3\n", r"row 3 \(line 4\): expected 5 cells as the header, got 4"),
            (
                TASKS + "9,1,0,3,?\n",
                r"row 3 \(line 4\), column goal_y: expected a number, got '\?'",
            ),
            (TASKS + "9,1,0,inf,1\n", r"row 3 \(line 4\), column goal_x: expected a finite number"),
            (
                TASKS + "9,1,0,10.5,1\n",
                r"task '9': goal x = 10.5 is outside the bounds \[0, 10\] of the state space; corr",
            ),
            (TASKS + "9,1,-3,10,1\n", r"task '9': start y = -3 is outside the bounds \[-2, 2\]"),
        ],
    )
    def test_what_is_wrong_in_tasks(self, tmp_path: Path, text: str, message: str) -> None:
        path = save(tmp_path / "demo_7.csv", ROWS)
        tasks = save(tmp_path / "tasks.csv", text)
        with pytest.raises(ValueError, match=f"^{re.escape(str(tasks))}: {message}"):
            read_one(path, tasks=tasks)

    def test_rounding_may_leave_the_bounds_by_a_little(self, tmp_path: Path) -> None:
        slack = 0.9 * START_TOLERANCE * 10
        text = f"demo,start_x,start_y,goal_x,goal_y\n1,{-slack},0,{10 + slack},1\n"
        assert list(read_tasks(save(tmp_path / "tasks.csv", text), PLANE)) == ["1"]

    def test_a_file_without_a_task(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo_9.csv", ROWS)
        tasks = save(tmp_path / "tasks.csv", TASKS)
        with pytest.raises(
            ValueError, match=r"demo_9.csv: no task in .*tasks.csv; expected a row with demo_9 or 9"
        ):
            read_one(path, tasks=tasks)
        with pytest.raises(FileNotFoundError, match=r"nothing\.csv: no such file"):
            read_one(path, tasks=tmp_path / "nothing.csv")

    def test_a_file_with_two_tasks(self, tmp_path: Path) -> None:
        path = save(tmp_path / "demo_7.csv", ROWS)
        tasks = save(tmp_path / "tasks.csv", TASKS + "demo_7,1,0,3,1\n")
        with pytest.raises(ValueError, match=r"demo_7.csv: two tasks in .*, demo_7 and 7; rename"):
            read_one(path, tasks=tasks)

    def test_a_file_that_starts_elsewhere(self, tmp_path: Path) -> None:
        tasks = save(tmp_path / "tasks.csv", TASKS)
        near, far = (1 + factor * START_TOLERANCE * 10 for factor in (0.99, 1.01))
        read_one(save(tmp_path / "demo_7.csv", f"x,y\n{near},0\n2,1\n"), tasks=tasks)
        path = save(tmp_path / "demo_7.csv", f"x,y\n{far},0\n2,1\n")
        with pytest.raises(
            ValueError,
            match=r"demo_7.csv: the first state is x = 1.0101, y = 0, but the task starts at "
            r"x = 1, y = 0: 0.001 of the extent apart, expected at most 0.001; correct either",
        ):
            read_one(path, tasks=tasks)


numbers = st.floats(-1.0, 1.0, allow_subnormal=False)


@st.composite
def demonstrations(draw: st.DrawFn) -> list[Demonstration]:
    names = st.text("abcdefXYZ0123456789_-. ä,'\"", min_size=1, max_size=8).filter(
        lambda name: name == name.strip() and not name.startswith("demo_") and name != "."
    )
    items = []
    for name in draw(st.lists(names, min_size=1, max_size=3, unique_by=str.lower)):
        length = draw(st.integers(2, 5))
        theta = draw(hnp.arrays(float, length, elements=numbers)).cumsum()
        omega = 6.0 * draw(hnp.arrays(float, length, elements=numbers))
        steps = draw(hnp.arrays(float, length, elements=st.floats(1e-3, 1.0)))
        offset = draw(st.sampled_from([0.0, 1.7e9]))
        rows = draw(st.sampled_from([length - 1, length]))
        states = np.stack([theta, omega], axis=1)
        prefix = draw(st.sampled_from(["", "demo_"]))
        goal = draw(hnp.arrays(float, 2, elements=numbers))
        items.append(
            Demonstration(
                prefix + name,
                states,
                Task(states[0], goal),
                times=draw(st.sampled_from([None, offset + steps.cumsum()])),
                actions=1e3 * draw(hnp.arrays(float, (rows, 1), elements=numbers)),
            )
        )
    return items


class TestWriting:
    @given(items=demonstrations())
    def test_read_back(self, items: list[Demonstration]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            paths = write_demonstrations(folder, items, PENDULUM, action_names=["u"])
            tasks = Path(folder) / "tasks.csv"
            back = read_demonstrations(paths, PENDULUM, tasks=tasks, action_names=["u"])
            assert len(list(Path(folder).iterdir())) == len(items) + 1
        for item, copy in zip(items, back, strict=True):
            assert item.name == copy.name
            np.testing.assert_allclose(copy.states, item.states, rtol=1e-8, atol=0)
            np.testing.assert_allclose(copy.task.start, item.task.start, rtol=1e-8, atol=0)
            np.testing.assert_allclose(copy.task.goal, item.task.goal, rtol=1e-8, atol=0)
            np.testing.assert_array_equal(copy.times, item.times)
            assert item.actions is not None
            assert copy.actions is not None
            length = len(item.actions)
            np.testing.assert_allclose(copy.actions[:length], item.actions, rtol=1e-8, atol=0)
            assert len(copy.actions) == len(item.states)
            assert (copy.actions[length:] == 0.0).all()

    def test_what_the_files_look_like(self, tmp_path: Path) -> None:
        states = [[1 / 3, 0], [2, 1e-7]]
        item = make(states, "demo_03", times=[1.7e9, 1.7e9 + 0.01], actions=[[0.5]])
        folder = tmp_path / "new" / "folder"
        paths = write_demonstrations(folder, [item], PLANE, action_names=["u"])
        assert paths == [folder / "demo_03.csv"]
        assert paths[0].read_text() == (
            "t,x,y,u\n1700000000.0,0.333333333,0,0.5\n1700000000.01,2,1e-07,0\n"
        )
        assert (folder / "tasks.csv").read_text() == (
            "demo,start_x,start_y,goal_x,goal_y\n03,0.333333333,0,2,1e-07\n"
        )

    def test_other_goals(self, tmp_path: Path) -> None:
        item = Demonstration("a", np.zeros((2, 2)), Task(np.zeros(2), np.array([70.0])))
        paths = write_demonstrations(tmp_path, [item], PLANE, goal_names=["line"])
        (back,) = read_demonstrations(
            paths, PLANE, tasks=tmp_path / "tasks.csv", goal_names=["line"]
        )
        np.testing.assert_array_equal(back.task.goal, [70])
        with pytest.raises(ValueError, match=r"a: expected a goal of shape \(2,\), got \(1,\)"):
            write_demonstrations(tmp_path / "b", [item], PLANE)

    @pytest.mark.parametrize("existing", ["a.csv", "tasks.csv", "b.csv"])
    def test_never_overwrites(self, tmp_path: Path, existing: str) -> None:
        save(tmp_path / existing, "precious")
        items = [make([[1, 0], [2, 0]], name) for name in "ab"]
        with pytest.raises(
            FileExistsError, match=f"{existing} exists already; choose another fold"
        ):
            write_demonstrations(tmp_path, items, PLANE)
        assert [path.name for path in tmp_path.iterdir()] == [existing]
        assert (tmp_path / existing).read_text() == "precious"

    @pytest.mark.parametrize(
        ("items", "message"),
        [
            ([make([[1, 0], [2, 0]], "tasks")], "'tasks' cannot be the file name of a demonstr"),
            ([make([[1, 0], [2, 0]], "../a")], "'../a' cannot be the file name"),
            ([make([[1, 0], [2, 0]], "a\nb")], r"'a\\nb' cannot be the file name"),
            ([make([[1, 0], [2, 0]], " a")], "' a' cannot be the file name"),
            ([make([[1, 0], [2, 0]], "")], "'' cannot be the file name"),
            (
                [make([[1, 0], [2, 0]], "a")] * 2,
                "more than one demonstration would be 'a' in tasks",
            ),
            (
                [make([[1, 0], [2, 0]], "demo_1"), make([[2, 0], [1, 0]], "demo_demo_1")],
                "demo_1: two tasks in tasks.csv, demo_1 and 1; rename one",
            ),
            ([make([[1, 0], [math.nan, 0]])], "a: goal x = nan|a: row 2, column x: expected a fin"),
            ([make([[1, 0], [2, 9]])], r"a: goal y = 9 is outside the bounds \[-2, 2\]"),
            (
                [Demonstration("a", np.ones((2, 2)), Task(np.zeros(2), np.zeros(2)))],
                "a: the first state is x = 1, y = 1, but the task starts at x = 0, y = 0",
            ),
        ],
    )
    def test_refuses_what_could_not_be_read_back(
        self, tmp_path: Path, items: list[Demonstration], message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            write_demonstrations(tmp_path, items, PLANE)
        assert list(tmp_path.iterdir()) == []

    def test_actions_have_to_fit_their_names(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="a: expected actions u, v, got none"):
            write_demonstrations(tmp_path, [make([[1, 0], [2, 0]])], PLANE, action_names=["u", "v"])
        item = make([[1, 0], [2, 0]], actions=[[1]])
        with pytest.raises(ValueError, match=r"expected actions of shape \(any, 2\), got \(1, 1\)"):
            write_demonstrations(tmp_path, [item], PLANE, action_names=["u", "v"])
        write_demonstrations(tmp_path, [item], PLANE)
        assert (tmp_path / "a.csv").read_text() == "x,y\n1,0\n2,0\n"

    def test_actions_have_to_be_finite(self, tmp_path: Path) -> None:
        item = make([[1, 0], [2, 0]], actions=[[math.inf]])
        with pytest.raises(ValueError, match="a: row 1, column u: expected a finite number, got i"):
            write_demonstrations(tmp_path, [item], PLANE, action_names=["u"])

    def test_an_interruption_leaves_no_part_of_a_file(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(_: int) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_demonstrations(tmp_path, [make([[1, 0], [2, 0]])], PLANE)
        assert list(tmp_path.iterdir()) == []


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
