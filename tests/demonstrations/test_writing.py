"""Demonstrations are written so that they can be read again."""

from __future__ import annotations

import math
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.demonstration_files import PENDULUM, PLANE, make, save

from swerve.base.space import Task
from swerve.demonstrations.demonstration import (
    Demonstration,
    read_demonstrations,
    write_demonstrations,
)

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
