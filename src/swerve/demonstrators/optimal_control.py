"""Demonstrations by constrained optimal control, as the paper made them (section IV).

    max  sum_t r(s_t, a_t, s_{t+1}) + r_T(s_T)    such that the path avoids c

over continuous actions, by direct transcription (see `transcription`). `path_search` finds local
optima from several guesses; the best one that avoids c, between states too, and reaches the goal
becomes the demonstration.

Shapes: T steps, K tasks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swerve.base.arguments import seed_number
from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.constraints.base import Constraint
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrators.path_search import (
    EARLY,
    GOAL_TOLERANCE,
    NUM_GUESSES,
    UNLIKE,
    PathSearch,
    Search,
)
from swerve.problem.problem import Problem
from swerve.problem.tasks import named_tasks

SPARE = 2  # tasks to sample for each optimum wanted, since some tasks cannot be done
SAME = 1e-5  # relative difference of rewards below which two local optima count as one


class NoPathError(ValueError):
    """No path was found that avoids the constraint and reaches its goal."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """A demonstration that is a local optimum.

    Attributes:
      demonstration: the best path that was found, with its actions.
      reward: the reward of the demonstration.
      rewards: rewards of all local optima found that reach the goal, the best first. There may be
        more: a guess is dropped where even its solution without obstacles is no better.
      num_guesses: number of guesses that were tried.
      endings: how often each status of the solver, or each fault of its solution, occurred.
    """

    demonstration: Demonstration
    reward: float
    rewards: tuple[float, ...]
    num_guesses: int
    endings: dict[str, int]


def optimal_control(
    problem: Problem,
    constraint: Constraint,
    tasks: Task | Sequence[Task],
    *,
    names: Sequence[str] | None = None,
    limits: tuple[float, float] | None = None,
    num_steps: int | None = None,
    num_guesses: int = NUM_GUESSES,
    goal_tolerance: float = GOAL_TOLERANCE,
    seed: int = 0,
    progress: bool = False,
) -> list[Optimum]:
    """Make a demonstration of each task that is a local optimum under a constraint.

    Args:
      problem: the model; its hypotheses do not matter. Its known constraints are avoided too.
      constraint: c, to avoid: made of boxes, balls, half-spaces and polygons, or of actions
        (`ActionBox`, `StateAction`).
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      names: names of the demonstrations; demo_000 and so on if None.
      limits: least and largest action, which may be infinite; if None, the range of the
        discretised actions.
      num_steps: T; the problem's horizon if None. Give it where episodes end early.
      num_guesses: number of paths to begin with; more paths find better optima.
      goal_tolerance: how far from its goal a demonstration may end, where the names of goals are
        names of states, such as a position [Euclidean, in the states' units].
      seed: seed of the guesses.
      progress: whether to show a progress bar.

    Returns:
      K optima. Their demonstrations enter neither the constraint nor a known constraint, at a state
      or between two states.

    Raises:
      ImportError: if CasADi is not installed.
      NoPathError: if no path is found that avoids these constraints and reaches the goal.
      ValueError: if a start lies inside the constraint, or an argument is of the wrong kind or
        range.
    """
    seed = seed_number(seed)
    batch, labels = named_tasks(problem, constraint, tasks, names)
    settings = Search(limits, num_steps, num_guesses, goal_tolerance)
    search = PathSearch(problem, constraint, settings)
    found = []
    with progress_bar("demonstrating", len(labels), progress) as advance:
        for k, (label, *task) in enumerate(zip(labels, *batch, strict=True)):
            found.append(_best(search, Task(*task), label, np.random.default_rng([seed, k])))
            advance(1)
    return found


def first_optima(
    problem: Problem,
    constraint: Constraint,
    tasks: Task,
    num: int,
    settings: Search,
    *,
    seed: int = 0,
    progress: bool = False,
) -> list[Optimum]:
    """Return optima, as `optimal_control` does, of the first tasks that can be done.

    Args:
      problem: the model.
      constraint: c, to avoid.
      tasks: [K] tasks, some of which may be impossible.
      num: number of optima; their names are demo_000 and so on.
      settings: settings of the search.
      seed: seed of the guesses.
      progress: whether to show a progress bar.

    Raises:
      NoPathError: if fewer than `num` tasks can be done.
    """
    batch, _ = named_tasks(problem, constraint, tasks, None)
    search = PathSearch(problem, constraint, settings)
    found: list[Optimum] = []
    reason = "all of them could"
    with progress_bar("demonstrating", num, progress) as advance:
        for k, task in enumerate(zip(*batch, strict=True)):
            label, generator = f"demo_{len(found):03d}", np.random.default_rng([seed, k])
            try:
                found.append(_best(search, Task(*task), label, generator))
            except NoPathError as error:
                reason = str(error)
                continue
            advance(1)
            if len(found) == num:
                return found
    raise NoPathError(
        f"only {len(found)} of {len(batch.start)} tasks can be done, {num} were asked for; the "
        f"last that could not: {reason}"
    )


def _best(search: PathSearch, task: Task, name: str, generator: np.random.Generator) -> Optimum:
    """Return the best local optimum that reaches the goal of a task.

    Raises:
      NoPathError: if there is none.
    """
    found, endings = search.find(task, generator)
    tried = ", ".join(f"{count} {how}" for how, count in endings.most_common())
    where = f"{name}: from start {task.start.tolist()} to goal {task.goal.tolist()}"
    if not found:
        avoided = ", ".join(constraint.name for constraint in search.avoided)
        raise NoPathError(
            f"{where} no path was found that avoids {avoided}, from {search.num_guesses} guesses "
            f"({tried}): {_remedy(endings, search.num_steps)}"
        )
    missed = [search.missed(task, solution.path) for solution in found]
    near = [one for one, miss in zip(found, missed, strict=True) if miss <= search.goal_tolerance]
    if not near:
        raise NoPathError(
            f"{where} the nearest path that was found ends {min(missed):.3g} from the goal, "
            f"more than goal_tolerance = {search.goal_tolerance:g} ({tried}): choose another "
            "task, wider limits of actions or a larger goal_tolerance"
        )
    best = max(near, key=lambda solution: solution.reward)
    times = np.arange(search.num_steps + 1) * search.mdp.dt
    states, actions = best.path
    demonstration = Demonstration(name, states, task, times=times, actions=actions)
    rewards = tuple(_distinct(sorted((solution.reward for solution in near), reverse=True)))
    return Optimum(demonstration, best.reward, rewards, search.num_guesses, dict(endings))


def _remedy(endings: Counter[str], num_steps: int) -> str:
    """Return the advice of an error message, by how the solver ended."""
    if EARLY in endings:
        return f"choose fewer num_steps than {num_steps}: the episode is over before"
    if UNLIKE in endings:
        return "write dynamics with arithmetic, jnp.where and loops of a fixed length"
    return "choose another task, wider limits of actions, other num_steps or more num_guesses"


def _distinct(rewards: list[float]) -> list[float]:
    """Return rewards, in descending order, without those nearly equal to one before them."""
    kept: list[float] = []
    for reward in rewards:
        if not kept or kept[-1] - reward > SAME * (1.0 + abs(reward)):
            kept.append(reward)
    return kept
