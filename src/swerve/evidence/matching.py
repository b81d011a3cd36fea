"""Match the task of a demonstration to the tasks of evidence.

Shapes: K tasks, D demonstrations, n states, g goal dimensions, P pairs of tasks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from swerve.base.phrases import told_apart
from swerve.base.space import Task
from swerve.problem.record import ProblemRecord

MATCH_TOLERANCE = 1e-3  # share of a state's extent: tasks that differ by less are the same task
SLACK = 1.01  # times MATCH_TOLERANCE: tasks are compared by their distance if one number is nearer
AT_ONCE = 100_000  # pairs of tasks compared together: bounds the memory


def nearest(problem: ProblemRecord, known: Task, tasks: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return the index [...] of the known task nearest to each task, and its distance [...].

    Args:
      problem: problem that the tasks belong to.
      known: starts [K, n] and goals [K, g].
      tasks: starts [..., n] and goals [..., g].

    Returns:
      Indices from 0 to K - 1, and distances in units of the states' extents.
    """
    each = Task(*(np.asarray(part, float)[..., None, :] for part in tasks))
    distance = _distance(problem, known, each)
    return distance.argmin(axis=-1), distance.min(axis=-1)


def find_each(problem: ProblemRecord, known: Task, tasks: Task) -> np.ndarray:
    """Return for each task the index [D] of the known task that is the same; -1 if none is.

    Where several known tasks are the same within MATCH_TOLERANCE, the nearest is taken, and of
    equally near ones the first. Only known tasks that agree in one number are compared.

    Args:
      problem: problem that the tasks belong to.
      known: starts [K, n] and goals [K, g].
      tasks: starts [D, n] and goals [D, g].
    """
    known, tasks = (Task(*(np.asarray(part, float) for part in task)) for task in (known, tasks))
    near = min(_near_in_each_number(problem, known, tasks), key=lambda near: near.num.sum())
    numbers = np.full(len(tasks.start), -1)
    block = np.cumsum(near.num) // AT_ONCE
    for rows in np.split(np.arange(len(numbers)), np.flatnonzero(np.diff(block)) + 1):
        row, number = near.pairs(rows)
        distance = _distance(problem, _rows(known, number), _rows(tasks, row))
        order = np.lexsort((number, distance, row))
        order = order[distance[order] <= MATCH_TOLERANCE]
        order = order[np.diff(row[order], prepend=-1) > 0]
        numbers[row[order]] = number[order]
    return numbers


def find_equal(known: Task, tasks: Task) -> np.ndarray:
    """Return for each task the index [D] of a known task of the very same numbers; -1 if none is.

    Samples depend on the numbers of their task, so that no other task has the same samples.

    Args:
      known: starts [K, n] and goals [K, g].
      tasks: starts [D, n] and goals [D, g].
    """
    of_known, of_tasks = (
        [row.tobytes() for row in np.hstack(each).astype(float)] for each in (known, tasks)
    )
    index = {numbers: k for k, numbers in enumerate(of_known)}
    return np.array([index.get(numbers, -1) for numbers in of_tasks], int)


def group_each(problem: ProblemRecord, tasks: Task) -> np.ndarray:
    """Return for each task the index [D] of an earlier task that is the same, or its own index.

    Returned indices are of tasks that are the same as none of these before them. Of several the
    nearest is taken, and of equally near ones the first.

    Args:
      problem: problem that the tasks belong to.
      tasks: starts [D, n] and goals [D, g].
    """
    tasks = Task(*(np.asarray(part, float) for part in tasks))
    near = min(_near_in_each_number(problem, tasks, tasks), key=lambda near: near.num.sum())
    place, is_known = np.argsort(near.order), np.zeros(len(near.order), bool)  # known: in the order
    numbers = np.arange(len(near.order))
    for row, (first, num) in enumerate(zip(near.first, near.num, strict=True)):
        known = np.sort(near.order[first : first + num][is_known[first : first + num]])
        distance = _distance(problem, _rows(tasks, known), _rows(tasks, row))
        if distance.min(initial=np.inf) <= MATCH_TOLERANCE:
            numbers[row] = known[distance.argmin()]
        else:
            is_known[place[row]] = True
    return numbers


class _Near(NamedTuple):
    """Known tasks that agree with tasks in one number: those of task d are neighbours in order.

    Attributes:
      order: [K] indices of the known tasks, in the order of the number.
      first: [D] place in `order` of the first known task that agrees with each task.
      num: [D] number of known tasks that agree with each task.
    """

    order: np.ndarray
    first: np.ndarray
    num: np.ndarray

    def pairs(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all pairs of some tasks and the known tasks that agree: their indices [P]."""
        num = self.num[rows]
        place = np.arange(num.sum()) + np.repeat(self.first[rows] - (np.cumsum(num) - num), num)
        return np.repeat(rows, num), self.order[place]


def _near_in_each_number(problem: ProblemRecord, known: Task, tasks: Task) -> Iterator[_Near]:
    """Yield, for each number of a task, the known tasks that agree with tasks in this number.

    Two angles agree only if their cosines and sines do: neither changes faster than the angle.
    """
    for part in ("start", "goal"):
        of_known, of_tasks = getattr(known, part), getattr(tasks, part)
        is_state = part == "start" or problem.goal_names == problem.space.names
        for i in range(of_known.shape[1]):
            one, other = of_known[:, i], of_tasks[:, i]
            if not is_state:
                yield _near(one, other, np.maximum(1.0, np.abs(other)))
            elif problem.space.is_angle[i]:
                for function in (np.cos, np.sin):
                    yield _near(function(one), function(other), problem.space.unit[i])
            else:
                yield _near(one, other, problem.space.unit[i])


def _near(known: np.ndarray, number: np.ndarray, unit: float | np.ndarray) -> _Near:
    """Return the known tasks [K] whose number is within the tolerance of each task's number [D]."""
    order = np.argsort(known, kind="stable")
    reach = SLACK * (MATCH_TOLERANCE * unit + np.spacing(np.abs(number)))
    first = np.searchsorted(known[order], number - reach, "left")
    return _Near(order, first, np.searchsorted(known[order], number + reach, "right") - first)


def match_each(
    problem: ProblemRecord, known: Task, tasks: Task, names: Sequence[str]
) -> np.ndarray:
    """Return for each task the index [D] of the known task that is the same.

    Args:
      problem: problem that the tasks belong to.
      known: starts [K, n] and goals [K, g].
      tasks: starts [D, n] and goals [D, g].
      names: [D] name of each task, for the error.

    Raises:
      ValueError: if a task is not known; the message names the nearest known task.
    """
    numbers = find_each(problem, known, tasks)
    for row in np.flatnonzero(numbers < 0)[:1]:
        match(problem, known, _rows(tasks, row), names[int(row)])
    return numbers


def match(problem: ProblemRecord, known: Task, task: Task, name: str) -> int:
    """Return the index of the known task with the same start and goal.

    Two tasks are the same within MATCH_TOLERANCE of each state's extent.

    Args:
      problem: problem that the tasks belong to.
      known: starts [K, n] and goals [K, g].
      task: start [n] and goal [g].
      name: name of the task, for the error.

    Raises:
      ValueError: if no known task is the same; the message names the nearest known task.
    """
    number, distance = nearest(problem, known, task)
    if distance > MATCH_TOLERANCE:
        raise _no_evidence(known, task, int(number), name)
    return int(number)


def _no_evidence(known: Task, task: Task, nearest_one: int, name: str) -> ValueError:
    """Return an error that says that a task has no evidence, and names the nearest known task."""
    (start, known_start), (goal, known_goal) = (
        _numbers(asked, part[nearest_one]) for asked, part in zip(task, known, strict=True)
    )
    return ValueError(
        f"{name}: no evidence for start {start} and goal {goal}; the nearest of "
        f"{len(known.start)} tasks is start {known_start}, goal {known_goal}. Sample this task "
        "too: swerve.sample(nominal, tasks)"
    )


def _distance(problem: ProblemRecord, known: Task, tasks: Task) -> np.ndarray:
    """Return the distance [...] of known tasks [...] from tasks [...], in the states' extents."""
    of_start = problem.space.relative_distance(known.start, tasks.start)
    if problem.goal_names == problem.space.names:
        return np.maximum(of_start, problem.space.relative_distance(known.goal, tasks.goal))
    if not known.goal.shape[-1]:
        return of_start
    apart = np.abs(known.goal - tasks.goal) / np.maximum(1.0, np.abs(tasks.goal))
    return np.maximum(of_start, apart.max(axis=-1))


def _rows(task: Task, rows: int | np.ndarray) -> Task:
    """Return one task or some tasks of many."""
    return Task(*(part[rows] for part in task))


def _numbers(values: np.ndarray, others: np.ndarray) -> tuple[str, str]:
    """Return two points as texts, with enough digits to tell their numbers apart."""
    pairs = [told_apart(*pair, 4) for pair in zip(values, others, strict=True)]
    one, other = zip(*pairs, strict=True) if pairs else ((), ())
    return f"({', '.join(one)})", f"({', '.join(other)})"
