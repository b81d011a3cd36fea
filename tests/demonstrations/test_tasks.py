"""Files of tasks, and which demonstration has which task."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from support.demonstration_files import PENDULUM, PLANE, ROWS, TASKS, read_one, save

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.demonstrations.checks import START_TOLERANCE, check_start
from swerve.demonstrations.demonstration import read_demonstrations, read_tasks


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
            r"x = 1, y = 0: 0.00101 of the extent apart, expected at most 0.001; correct either",
        ):
            read_one(path, tasks=tasks)

    def test_a_start_that_differs_in_late_digits(self) -> None:
        """At 1,000 km from the origin of a map, a millimetre is the tenth digit."""
        space = StateSpace(("x", "y"), (), np.array([[1e6, 1e6 + 1.0], [0.0, 1.0]]))
        task = Task(np.array([1e6, 0.0]), np.array([1e6, 0.0]))
        message = (
            "walk: the first state is x = 1000000.004, y = 0, but the task starts at x = 1000000, "
            "y = 0: 0.004 of the extent apart, expected at most 0.001; correct either"
        )
        with pytest.raises(ValueError, match=message):
            check_start(np.array([1e6 + 0.004, 0.0]), task, space, "walk")
