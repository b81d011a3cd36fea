"""Demonstrations: reading, checking and writing them.

A demonstration is what somebody did, with the task that they were given:

    xi = s_0, ..., s_{L-1},   s_0 = task.start,   |difference(s_i, s_{i+1})| <= 0.9 pi for angles.

It may be sampled at any rate, unevenly too, and its angles may be wrapped or not, as long as each
angle takes its shorter arc between two samples. Files are read with NumPy; polars is imported for
Parquet alone.

Shapes: L samples, n state dimensions, m action dimensions, g goal dimensions, N tasks.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swerve import store
from swerve.space import TWO_PI, StateSpace, Task
from swerve.tables import csv_text, read_table

START_TOLERANCE = 1e-3
"""How far a first state may lie from the start of its task, and a start or a goal outside the
bounds, in units of the extent of the state space."""

MAX_HALF_EXTENTS = 10
MAX_TURNS = 10
MAX_ARC = 0.45 * TWO_PI

AnyPath = str | os.PathLike[str]
RowNamer = Callable[[int], str]


@dataclass(frozen=True, eq=False)
class Demonstration:
    """States that somebody went through, and the task that they were given.

    Attributes:
      name: what results call it; the file name without its suffix.
      states: [L, n] states, float64; angles wrapped or not [rad].
      task: its start [n] and goal [g].
      times: [L] time of each state [s], where known.
      actions: [L-1, m] actions between the states, or [L, m] with one more that is not used.
    """

    name: str
    states: np.ndarray
    task: Task
    times: np.ndarray | None = None
    actions: np.ndarray | None = None

    def __post_init__(self) -> None:
        states = _shaped(self.states, (None, None), "states", self.name)
        start = _shaped(self.task.start, states.shape[1:], "a start", self.name)
        goal = _shaped(self.task.goal, (None,), "a goal", self.name)
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "task", Task(start, goal))
        if self.times is not None:
            times = _shaped(self.times, states.shape[:1], "times", self.name)
            object.__setattr__(self, "times", times)
        if self.actions is not None:
            actions = _shaped(self.actions, (None, None), "actions", self.name)
            if len(states) - len(actions) not in (0, 1):
                raise ValueError(
                    f"{self.name}: expected {len(states) - 1} or {len(states)} actions for "
                    f"{len(states)} states, got {len(actions)}"
                )
            object.__setattr__(self, "actions", actions)


def check_states(
    states: np.ndarray,
    times: np.ndarray | None,
    space: StateSpace,
    where: str,
    *,
    line_of: Callable[[int], int] | None = None,
) -> None:
    """Check the states of a demonstration before anything is computed from them.

    Args:
      states: [L, n] states.
      times: [L] time of each state [s], or None.
      space: what is known of the states.
      where: the file or demonstration, for messages.
      line_of: maps a row, counted from 0, to its line in the file.

    Raises:
      ValueError: if there are fewer than 2 states, a number is NaN or infinite, the times do not
        strictly increase, a state is so far out that its unit must be wrong (more than
        MAX_HALF_EXTENTS half extents from the middle of the bounds, MAX_TURNS turns for an
        angle), or an angle changes by more than MAX_ARC [rad] between two samples.
    """
    states = _shaped(states, (None, len(space.names)), "states", where)
    if len(states) < 2:
        raise ValueError(f"{where}: expected at least 2 states, got {len(states)}")
    at = _row_namer(where, line_of)
    _check_finite(states, space.names, at)
    if times is not None:
        _check_times(_shaped(times, (len(states),), "times", where), at)
    _check_units(states, space, at)
    _check_arcs(states, space, at)


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

    The first line of a file names its columns: the states, `t` [s] if known, the actions if
    known; all others are ignored.

    Args:
      paths: CSV or Parquet files.
      space: names, angles and bounds of the states.
      tasks: file with the start and goal of each demonstration, see `read_tasks`. The row of
        demo_7.csv has `demo_7` or `7` in its `demo` column.
      goal_names: the components of a goal; the states unless given.
      action_names: the columns that hold actions.
      goal_of: maps states [L, n] to the goal [g] where there is no tasks file; the last state
        unless given.

    Returns:
      One demonstration for each path, in their order.

    Raises:
      OSError: if a file does not exist or cannot be opened.
      ValueError: if a file cannot be understood, its states fail `check_states`, its task is not
        known, lies outside the state space or starts elsewhere, or a path is given twice.
    """
    files = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    for file, count in Counter(path.resolve() for path in files).items():
        if count > 1:
            raise ValueError(f"{file} is given {count} times; give each demonstration once")
    goal_names = space.names if goal_names is None else tuple(goal_names)
    known = None if tasks is None else read_tasks(tasks, space, goal_names)
    demonstrations = []
    for path in files:
        states, times, actions = _read_trajectory(path, space, action_names)
        if known is None:
            goal = states[-1] if goal_of is None else goal_of(states)
            task = Task(states[0], _shaped(goal, (len(goal_names),), "a goal", str(path)))
            _check_bounds(task, space, goal_names, str(path))
        else:
            task = _find_task(path.stem, known, str(path), f"in {tasks}")
            _check_start(states[0], task, space, str(path))
        demonstrations.append(Demonstration(path.stem, states, task, times, actions))
    return demonstrations


def read_tasks(
    path: AnyPath, space: StateSpace, goal_names: Sequence[str] | None = None
) -> dict[str, Task]:
    """Read tasks from a file with columns demo, start_<state name> and goal_<goal name>.

    Args:
      path: CSV or Parquet file.
      space: names, angles and bounds of the states.
      goal_names: the components of a goal; the states unless given.

    Returns:
      The task of each cell of the `demo` column, in the order of the file.

    Raises:
      OSError: if the file does not exist or cannot be opened.
      ValueError: if the file cannot be understood, two rows have the same `demo`, or a start or a
        goal lies outside the bounds of the states.
    """
    goal_names = space.names if goal_names is None else tuple(goal_names)
    header = _tasks_header(space, goal_names)
    table = read_table(Path(path), header[1:], label=header[0])
    _check_finite(table.values, table.names, _row_namer(str(path), table.line_of))
    starts, goals = np.split(table.columns(header[1:]), [len(space.names)], axis=1)
    tasks: dict[str, Task] = {}
    for demo, start, goal in zip(table.labels, starts, goals, strict=True):
        if demo in tasks:
            raise ValueError(f"{path}: two rows for demo {demo!r}; keep one of them")
        tasks[demo] = Task(start, goal)
        _check_bounds(tasks[demo], space, goal_names, f"{path}: task {demo!r}")
    return tasks


def write_demonstrations(
    directory: AnyPath,
    demonstrations: Sequence[Demonstration],
    space: StateSpace,
    *,
    action_names: Sequence[str] = (),
    goal_names: Sequence[str] | None = None,
) -> list[Path]:
    """Write each demonstration to <name>.csv and their tasks to tasks.csv.

    Numbers have 9 significant digits; times have all of theirs, since with 9 the seconds since
    1970 would not increase. Where there is one action fewer than states, the last row has 0. A
    file appears complete or not at all.

    Args:
      directory: where to write; created if need be.
      demonstrations: what to write, each with a name of its own.
      space: names, angles and bounds of the states.
      action_names: the columns of the actions, which are not written without.
      goal_names: the components of a goal; the states unless given.

    Returns:
      The path of each demonstration.

    Raises:
      FileExistsError: if one of the files exists already; then nothing is written.
      ValueError: if a demonstration could not be read back: its states fail `check_states`, its
        task does not fit, it lacks actions, or its name is no file name or taken already.
    """
    directory = Path(directory)
    goal_names = space.names if goal_names is None else tuple(goal_names)
    texts = {directory / "tasks.csv": _tasks_text(demonstrations, space, goal_names)}
    for item in demonstrations:
        check_states(item.states, item.times, space, item.name)
        texts[directory / f"{item.name}.csv"] = _trajectory_text(item, space, action_names)
    for path in texts:
        if path.exists():
            raise FileExistsError(f"{path} exists already; choose another folder or remove it")
    directory.mkdir(parents=True, exist_ok=True)
    for path, text in texts.items():
        store.write_text(path, text)
    return [directory / f"{item.name}.csv" for item in demonstrations]


def _shaped(value: object, shape: Sequence[int | None], what: str, where: str) -> np.ndarray:
    """Return a value as float64, of a shape in which None stands for any length."""
    array = np.asarray(value, dtype=float)
    fits = len(shape) == array.ndim and all(
        size is None or size == found for size, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        sizes = str(tuple(shape)).replace("None", "any")
        raise ValueError(f"{where}: expected {what} of shape {sizes}, got {array.shape}")
    return array


def _row_namer(where: str, line_of: Callable[[int], int] | None) -> RowNamer:
    return lambda row: (
        f"{where}: row {row + 1}" + ("" if line_of is None else f" (line {line_of(row)})")
    )


def _check_finite(values: np.ndarray, names: Sequence[str], at: RowNamer) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise ValueError(
            f"{at(row)}, column {names[column]}: expected a finite number, got "
            f"{values[row, column]}; remove or repair that row"
        )


def _check_times(times: np.ndarray, at: RowNamer) -> None:
    _check_finite(times[:, None], ["t"], at)
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        before, after = (float(time) for time in times[late[0] : late[0] + 2])
        raise ValueError(
            f"{at(late[0])} has t = {before!r} and row {late[0] + 2} has t = {after!r}; expected "
            f"times that strictly increase: sort the rows, or remove those recorded twice"
        )


def _check_units(states: np.ndarray, space: StateSpace, at: RowNamer) -> None:
    centre = np.where(space.is_angle, 0.0, space.bounds.mean(axis=1))
    reach = np.where(space.is_angle, MAX_TURNS * TWO_PI, MAX_HALF_EXTENTS * space.extent / 2)
    far = np.argwhere(np.abs(states - centre) > reach)
    if not far.size:
        return
    row, column = far[0]
    problem = f"{at(row)}, column {space.names[column]}: {states[row, column]:.6g}"
    if space.is_angle[column]:
        raise ValueError(
            f"{problem} is an angle of more than {MAX_TURNS} turns. Degrees? Radians are "
            f"expected; if it is right, wrap it to [0, 2 pi)"
        )
    low, high = space.bounds[column]
    raise ValueError(
        f"{problem} is more than {MAX_HALF_EXTENTS} half-widths from the middle of the bounds "
        f"[{low:.6g}, {high:.6g}]. Another unit? If it is right, widen the MDP's bounds"
    )


def _check_arcs(states: np.ndarray, space: StateSpace, at: RowNamer) -> None:
    arcs = np.abs(space.difference(states[:-1], states[1:]))
    wide = np.argwhere((arcs > MAX_ARC) & space.is_angle)
    if wide.size:
        row, column = wide[0]
        raise ValueError(
            f"{at(row + 1)}, column {space.names[column]}: {arcs[row, column]:.3f} rad from the "
            f"row before, too close to pi to tell which way it turned (at most {MAX_ARC:.3f}); "
            f"record at a higher sampling rate. Degrees? Radians are expected"
        )


def _check_bounds(task: Task, space: StateSpace, goal_names: Sequence[str], where: str) -> None:
    low, high = space.bounds.T
    slack = START_TOLERANCE * space.extent
    for part, state in task._asdict().items():
        if part == "goal" and tuple(goal_names) != space.names:
            continue
        outside = ((state < low - slack) | (state > high + slack)) & ~space.is_angle
        for column in np.flatnonzero(outside):
            raise ValueError(
                f"{where}: {part} {space.names[column]} = {state[column]:.6g} is outside the "
                f"bounds [{low[column]:.6g}, {high[column]:.6g}] of the state space; correct it, "
                f"or widen the MDP's bounds"
            )


def _check_start(state: np.ndarray, task: Task, space: StateSpace, where: str) -> None:
    distance = space.relative_distance(state, task.start)
    if distance > START_TOLERANCE:
        first, start = (
            ", ".join(f"{name} = {x:.9g}" for name, x in zip(space.names, point, strict=True))
            for point in (state, task.start)
        )
        raise ValueError(
            f"{where}: the first state is {first}, but the task starts at {start}: {distance:.2g} "
            f"of the extent apart, expected at most {START_TOLERANCE:g}; correct either"
        )


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


def _read_trajectory(
    path: Path, space: StateSpace, action_names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    table = read_table(path, space.names, optional=("t", *action_names))
    states = table.columns(space.names)
    times = table.columns(["t"])[:, 0] if "t" in table.names else None
    check_states(states, times, space, str(path), line_of=table.line_of)
    missing = [name for name in action_names if name not in table.names]
    if len(missing) == len(action_names):
        return states, times, None
    if missing:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; expected all of the actions "
            f"{', '.join(action_names)}, or none"
        )
    actions = table.columns(action_names)
    _check_finite(actions, action_names, _row_namer(str(path), table.line_of))
    return states, times, actions


def _tasks_header(space: StateSpace, goal_names: Sequence[str]) -> list[str]:
    return ["demo", *(f"start_{name}" for name in space.names), *(f"goal_{n}" for n in goal_names)]


def _tasks_text(
    demonstrations: Sequence[Demonstration], space: StateSpace, goal_names: Sequence[str]
) -> str:
    tasks: dict[str, Task] = {}
    for item in demonstrations:
        name, task = item.name, item.task
        if name in ("", "tasks") or Path(name).name != name.strip() or not name.isprintable():
            raise ValueError(f"{name!r} cannot be the file name of a demonstration; rename it")
        cell = name.removeprefix("demo_") or name
        if cell in tasks:
            raise ValueError(f"more than one demonstration would be {cell!r} in tasks.csv: rename")
        _shaped(task.goal, (len(goal_names),), "a goal", name)
        _check_bounds(task, space, goal_names, name)
        _check_start(item.states[0], task, space, name)
        tasks[cell] = task
    for item in demonstrations:
        _find_task(item.name, tasks, item.name, "in tasks.csv")
    rows = [[cell, *(f"{x:.9g}" for x in np.concatenate(task))] for cell, task in tasks.items()]
    return csv_text([_tasks_header(space, goal_names), *rows])


def _trajectory_text(item: Demonstration, space: StateSpace, action_names: Sequence[str]) -> str:
    header, values = [*space.names, *action_names], item.states
    if action_names:
        if item.actions is None:
            raise ValueError(f"{item.name}: expected actions {', '.join(action_names)}, got none")
        actions = _shaped(item.actions, (None, len(action_names)), "actions", item.name)
        _check_finite(actions, action_names, _row_namer(item.name, None))
        values = np.hstack([values, np.pad(actions, [(0, len(values) - len(actions)), (0, 0)])])
    rows = [[f"{x:.9g}" for x in row] for row in values]
    if item.times is not None:
        header = ["t", *header]
        rows = [[repr(float(t)), *row] for t, row in zip(item.times, rows, strict=True)]
    return csv_text([header, *rows])
