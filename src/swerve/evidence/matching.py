"""Match the task of a demonstration to the tasks of evidence.

Shapes: K tasks, D demonstrations, n states, g goal dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swerve.base.space import Task
from swerve.problem.record import ProblemRecord

MATCH_TOLERANCE = 1e-3  # share of a state's extent: tasks that differ by less are the same task


def nearest(problem: ProblemRecord, known: Task, tasks: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return the index [...] of the known task nearest to each task, and its distance [...].

    Args:
      problem: problem that the tasks belong to.
      known: starts [K, n] and goals [K, g].
      tasks: starts [..., n] and goals [..., g].

    Returns:
      Indices from 0 to K - 1, and distances in units of the states' extents.
    """
    start, goal = (np.asarray(part, float)[..., None, :] for part in tasks)
    distance = np.maximum(
        problem.space.relative_distance(known.start, start),
        _goal_distance(problem, known.goal, goal),
    )
    return distance.argmin(axis=-1), distance.min(axis=-1)


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
    numbers, distance = nearest(problem, known, tasks)
    unknown = np.flatnonzero(distance > MATCH_TOLERANCE)
    if len(unknown):
        first = int(unknown[0])
        raise _no_evidence(
            known, Task(*(part[first] for part in tasks)), int(numbers[first]), names[first]
        )
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
    start, goal = (part[nearest_one] for part in known)
    return ValueError(
        f"{name}: no evidence for start {_numbers(task.start)} and goal {_numbers(task.goal)}; the "
        f"nearest of {len(known.start)} tasks is start {_numbers(start)}, goal {_numbers(goal)}. "
        "Sample this task too: swerve.sample(nominal, tasks)"
    )


def _goal_distance(problem: ProblemRecord, goals: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return the distance [..., K] of goals [K, g] from goals [..., 1, g], in states' extents."""
    if problem.goal_names == problem.space.names:
        return problem.space.relative_distance(goals, goal)
    if not goals.shape[-1]:
        return np.zeros((*goal.shape[:-2], len(goals)))
    return (np.abs(goals - goal) / np.maximum(1.0, np.abs(goal))).max(axis=-1)


def _numbers(values: Any) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in np.asarray(values)) + ")"
