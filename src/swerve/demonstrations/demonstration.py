"""Define demonstrations, and read and write files of them.

A demonstration holds the states that a demonstrator went through, and the demonstrator's task:

    xi = s_0, ..., s_{L-1},   s_0 = task.start,   |difference(s_i, s_{i+1})| <= 0.9 pi for angles.

The states may be recorded at any rate, even an uneven rate. Angles may be wrapped or not, as long
as each angle takes its shorter arc between two states. Files are read with NumPy; polars is
imported for Parquet alone.

Shapes: L samples, n state dimensions, m action dimensions, g goal dimensions, N tasks.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swerve.base.files import AnyPath, check_link, whole_folder, write_text
from swerve.base.interrupts import saving
from swerve.base.space import StateSpace, Task
from swerve.demonstrations.checks import (
    check_bounds,
    check_finite,
    check_start,
    check_states,
    row_namer,
    shaped,
)
from swerve.demonstrations.csv_format import csv_text
from swerve.demonstrations.formats import read_table
from swerve.demonstrations.recordings import read_recording

MAX_ERRORS = 10  # unusable files named in one error message: a longer list would not be read


@dataclass(frozen=True, eq=False)
class Demonstration:
    """The states that a demonstrator went through, and the demonstrator's task.

    Attributes:
      name: name of the demonstration in results; the file name without its suffix.
      states: [L, n] states, float64; angles wrapped or not [rad].
      task: start [n] and goal [g].
      times: [L] time of each state [s], where known.
      actions: [L-1, m] actions between the states; or [L, m], where the last action is not used.
      notes: what was odd about the file that it was read from, for `infer` to tell.
    """

    name: str
    states: np.ndarray
    task: Task
    times: np.ndarray | None = None
    actions: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        states = shaped(self.states, (None, None), "states", self.name)
        start = shaped(self.task.start, states.shape[1:], "a start", self.name)
        goal = shaped(self.task.goal, (None,), "a goal", self.name)
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "task", Task(start, goal))
        if self.times is not None:
            times = shaped(self.times, states.shape[:1], "times", self.name)
            object.__setattr__(self, "times", times)
        if self.actions is not None:
            actions = shaped(self.actions, (None, None), "actions", self.name)
            if len(states) - len(actions) not in (0, 1):
                raise ValueError(
                    f"{self.name}: expected {len(states) - 1} or {len(states)} actions for "
                    f"{len(states)} states, got {len(actions)}"
                )
            object.__setattr__(self, "actions", actions)


def read_demonstrations(
    paths: AnyPath | Iterable[AnyPath],
    space: StateSpace,
    *,
    tasks: AnyPath | None = None,
    goal_names: Sequence[str] | None = None,
    action_names: Sequence[str] = (),
    goal_of: Callable[[np.ndarray], np.ndarray] | None = None,
) -> list[Demonstration]:
    """Read and check demonstration files, one demonstration each.

    The first line of a file names its columns: the states, `t` [s] if known, and the actions if
    known; the actions of the last row may be blank. Without a column `t`, the only column whose
    name says time in seconds, such as `time` or `T [s]`, is taken for it. Other columns are
    ignored; `infer` warns of those that look like times or like misspelt actions.

    Args:
      paths: CSV or Parquet files.
      space: names, angles and bounds of the states.
      tasks: file of `read_tasks`, whose row for demo_7.csv has `demo_7` or `7` as its `demo`.
      goal_names: names of a goal's components; the names of the states unless given.
      action_names: the columns that hold actions.
      goal_of: where there is no tasks file, maps states [L, n] to the goal [g]; by default the goal
        is the last state.

    Returns:
      One demonstration for each path, in the order of the paths.

    Raises:
      OSError: if a file does not exist or cannot be opened.
      ValueError: if a file cannot be understood; if its states fail `check_states`; if its task is
        not known, lies outside the state space or starts in another state; or if a path is given
        twice or is the tasks file.
    """
    files = _distinct_files(paths, tasks)
    goal_names = space.names if goal_names is None else tuple(goal_names)
    known = None if tasks is None else read_tasks(tasks, space, goal_names)

    def read(path: Path) -> Demonstration:
        states, times, actions, notes = read_recording(path, space, action_names)
        if known is None:
            goal = states[-1] if goal_of is None else goal_of(states)
            task = Task(states[0], shaped(goal, (len(goal_names),), "a goal", str(path)))
            check_bounds(task, space, goal_names, str(path))
        else:
            task = _find_task(path.stem, known, str(path), f"in {tasks}")
            check_start(states[0], task, space, str(path))
        return Demonstration(path.stem, states, task, times, actions, notes)

    return _read_all(files, read)


def _distinct_files(paths: AnyPath | Iterable[AnyPath], tasks: AnyPath | None) -> list[Path]:
    """Return the paths as a list; raise ValueError if one is given twice or is the tasks file."""
    files = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    for file, count in Counter(path.resolve() for path in files).items():
        if count > 1:
            raise ValueError(f"{file} is given {count} times; give each demonstration once")
    if tasks is not None and Path(tasks).resolve() in [path.resolve() for path in files]:
        raise ValueError(
            f"{tasks} is given as a demonstration and as the tasks; leave it out of one"
        )
    return files


def _read_all(files: list[Path], read: Callable[[Path], Demonstration]) -> list[Demonstration]:
    """Read all files; raise one ValueError with the errors of all unusable files."""
    demonstrations, errors = [], []
    for path in files:
        try:
            demonstrations.append(read(path))
        except ValueError as error:
            errors.append(str(error))
    if errors:
        raise ValueError(_all_errors(errors, len(files)))
    return demonstrations


def _all_errors(errors: list[str], num_files: int) -> str:
    """Return one message for all unusable files."""
    if len(errors) == 1:
        return errors[0]
    shown = errors[:MAX_ERRORS]
    more = [f"... and {len(errors) - len(shown)} more"] if len(errors) > len(shown) else []
    return "\n  ".join([f"{len(errors)} of {num_files} files cannot be used:", *shown, *more])


def read_tasks(
    path: AnyPath, space: StateSpace, goal_names: Sequence[str] | None = None
) -> dict[str, Task]:
    """Read tasks from a file with columns demo, start_<state name> and goal_<goal name>.

    Args:
      path: CSV or Parquet file.
      space: names, angles and bounds of the states.
      goal_names: names of a goal's components; the names of the states unless given.

    Returns:
      The tasks by the texts in the `demo` column, in the order of the file.

    Raises:
      OSError: if the file does not exist or cannot be opened.
      ValueError: if the file cannot be understood, two rows have the same `demo`, or a start or a
        goal lies outside the bounds of the states.
    """
    goal_names = space.names if goal_names is None else tuple(goal_names)
    header = _tasks_header(space, goal_names)
    table = read_table(Path(path), header[1:], label=header[0])
    check_finite(table.values, table.names, row_namer(str(path), table.line_of))
    starts, goals = np.split(table.columns(header[1:]), [len(space.names)], axis=1)
    tasks: dict[str, Task] = {}
    for demo, start, goal in zip(table.labels, starts, goals, strict=True):
        if demo in tasks:
            raise ValueError(f"{path}: two rows for demo {demo!r}; keep one of them")
        tasks[demo] = Task(start, goal)
        check_bounds(tasks[demo], space, goal_names, f"{path}: task {demo!r}")
    return tasks


def write_demonstrations(
    directory: AnyPath,
    demonstrations: Sequence[Demonstration],
    space: StateSpace,
    *,
    action_names: Sequence[str] = (),
    goal_names: Sequence[str] | None = None,
) -> list[Path]:
    """Write each demonstration to <name>.csv, and all tasks to tasks.csv.

    Numbers have 9 significant digits, and times have all digits: with 9 digits, seconds since 1970
    would not increase. Where there is one action fewer than states, the last row has action 0. A
    file is written complete or not at all, and so is a folder that did not exist.

    Args:
      directory: folder of the files; created if need be.
      demonstrations: demonstrations with different names.
      space: names, angles and bounds of the states.
      action_names: the columns of the actions; without names no actions are written.
      goal_names: names of a goal's components; the names of the states unless given.

    Returns:
      The path of each demonstration.

    Raises:
      FileExistsError: if one of the files exists already, or the folder is a link that leads
        nowhere; then nothing is written.
      ValueError: if a demonstration could not be read back: its states fail `check_states`, its
        task does not fit, its actions are missing, or its name cannot be a file name or is used
        twice.
    """
    goal_names = space.names if goal_names is None else tuple(goal_names)
    tasks, *paths = new_files(directory, [item.name for item in demonstrations])
    texts = {tasks: _tasks_text(demonstrations, space, goal_names)}
    for path, item in zip(paths, demonstrations, strict=True):
        check_states(item.states, item.times, space, item.name)
        texts[path] = _trajectory_text(item, space, action_names)
    directory = Path(directory)
    place = nullcontext(directory) if directory.exists() else whole_folder(directory)
    with saving(), place as folder:
        for path, text in texts.items():
            write_text(folder / path.name, text)
    return paths


def new_files(directory: AnyPath, names: Sequence[str]) -> list[Path]:
    """Return the files that `write_demonstrations` writes: tasks.csv, then one for each name.

    Raises:
      FileExistsError: if one of the files exists already, or the folder is a link that leads
        nowhere.
      ValueError: if a name cannot be a file name, or two names would be the same in tasks.csv.
    """
    cells = Counter(_cell(name) for name in names)
    for name in names:
        if name in ("", "tasks") or Path(name).name != name.strip() or not name.isprintable():
            raise ValueError(f"{name!r} cannot be the file name of a demonstration; rename it")
        if cells[_cell(name)] > 1:
            raise ValueError(
                f"more than one demonstration would be {_cell(name)!r} in tasks.csv: rename"
            )
    check_link(Path(directory))
    paths = [Path(directory) / f"{name}.csv" for name in ("tasks", *names)]
    for path in paths:
        if path.exists():
            raise FileExistsError(f"{path} exists already; choose another folder or remove it")
    return paths


def _cell(name: str) -> str:
    """Return the name of a demonstration in the `demo` column of tasks.csv."""
    return name.removeprefix("demo_") or name


def _find_task(name: str, tasks: dict[str, Task], where: str, source: str) -> Task:
    names = list(dict.fromkeys([name, name.removeprefix("demo_")]))
    cells = [cell for cell in names if cell in tasks]
    if not cells:
        raise ValueError(
            f"{where}: no task {source}; expected a row with {' or '.join(names)} as demo"
        )
    if len(cells) > 1:
        raise ValueError(f"{where}: two tasks {source}, {' and '.join(cells)}; rename one")
    return tasks[cells[0]]


def _tasks_header(space: StateSpace, goal_names: Sequence[str]) -> list[str]:
    return ["demo", *(f"start_{name}" for name in space.names), *(f"goal_{n}" for n in goal_names)]


def _tasks_text(
    demonstrations: Sequence[Demonstration], space: StateSpace, goal_names: Sequence[str]
) -> str:
    tasks: dict[str, Task] = {}
    for item in demonstrations:
        name, task = item.name, item.task
        shaped(task.goal, (len(goal_names),), "a goal", name)
        check_bounds(task, space, goal_names, name)
        check_start(item.states[0], task, space, name)
        tasks[_cell(name)] = task
    for item in demonstrations:
        _find_task(item.name, tasks, item.name, "in tasks.csv")
    rows = [[cell, *(f"{x:.9g}" for x in np.concatenate(task))] for cell, task in tasks.items()]
    return csv_text([_tasks_header(space, goal_names), *rows])


def _trajectory_text(item: Demonstration, space: StateSpace, action_names: Sequence[str]) -> str:
    header, values = [*space.names, *action_names], item.states
    if action_names:
        if item.actions is None:
            raise ValueError(f"{item.name}: expected actions {', '.join(action_names)}, got none")
        actions = shaped(item.actions, (None, len(action_names)), "actions", item.name)
        check_finite(actions, action_names, row_namer(item.name, None))
        values = np.hstack([values, np.pad(actions, [(0, len(values) - len(actions)), (0, 0)])])
    rows = [[f"{x:.9g}" for x in row] for row in values]
    if item.times is not None:
        header = ["t", *header]
        rows = [[repr(float(t)), *row] for t, row in zip(item.times, rows, strict=True)]
    return csv_text([header, *rows])
