"""Sample tasks that can be begun, and check tasks.

A task is a start state and a goal. A task can be begun if its start lies outside the known
constraints and the episode does not end there at once.

Shapes: K tasks, n state dimensions, g goal dimensions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from swerve.base.arguments import instance, real_numbers, seed_number
from swerve.base.forked import check_process
from swerve.base.space import Task
from swerve.constraints.base import Constraint
from swerve.demonstrations.checks import check_bounds
from swerve.problem.problem import Problem

NUM_CANDIDATES = 20  # tasks sampled per task asked for: some start in a constraint


def can_begin(
    problem: Problem, state: Float[Array, " n"], goal: Float[Array, " g"]
) -> Bool[Array, ""]:
    """Return whether an episode can begin in a state: not ended, and outside known constraints."""
    allowed = ~problem.mdp.terminated(state, goal)
    for constraint in problem.known:
        allowed = allowed & ~constraint.contains(state, problem.mdp.space)
    return allowed


def draw_tasks(
    problem: Problem, num_tasks: int, *, avoid: Sequence[Constraint] = (), seed: int = 0
) -> Task:
    """Sample tasks of the MDP whose starts, and goals that are states, lie outside constraints.

    Args:
      problem: its MDP samples the tasks, and the tasks avoid its known constraints.
      num_tasks: K.
      avoid: further constraints that starts and goals must lie outside.
      seed: seed of the sampling.

    Returns:
      Starts [K, n] and goals [K, g].

    Raises:
      ValueError: if the MDP samples too few such tasks.
    """
    check_process()
    mdp, forbidden = problem.mdp, (*problem.known, *avoid)
    keys = jax.random.split(jax.random.key(seed_number(seed)), NUM_CANDIDATES * (num_tasks + 5))
    candidates = jax.vmap(mdp.sample_task)(keys)
    allowed = np.array(jax.vmap(lambda start, goal: can_begin(problem, start, goal))(*candidates))
    start, goal = np.asarray(candidates.start, np.float64), np.asarray(candidates.goal, np.float64)
    for constraint in forbidden:
        allowed &= ~constraint.contains(start, mdp.space)
        if mdp.goal_names == mdp.state_names:
            allowed &= ~constraint.contains(goal, mdp.space)
    chosen = np.flatnonzero(allowed)[:num_tasks]
    if len(chosen) < num_tasks:
        raise ValueError(
            f"only {len(chosen)} of {len(start)} tasks sampled from {type(mdp).__name__} start and "
            f"end outside {'; '.join(c.name for c in forbidden) or 'where episodes are over'}, "
            f"{num_tasks} were asked for: give tasks of your own"
        )
    return Task(start[chosen], goal[chosen])


def named_tasks(
    problem: Problem,
    constraint: Constraint,
    tasks: Task | Sequence[Task],
    names: Sequence[str] | None,
) -> tuple[Task, list[str]]:
    """Return tasks, checked to start outside a constraint, as one batch, and their names.

    Args:
      problem: problem that the tasks belong to.
      constraint: constraint that must not be entered.
      tasks: one task, a list of tasks, or a `Task` of arrays with a leading axis.
      names: names of the demonstrations; demo_000 and so on if None.

    Raises:
      ValueError: if an argument is of the wrong kind, the constraint does not fit the MDP, a task
        does not fit the problem or starts inside the constraint, or the numbers of names and tasks
        differ.
    """
    instance(problem, Problem, "problem", "make one with swerve.Problem")
    instance(constraint, Constraint, "constraint", "take one of problem.hypotheses.constraint(k)")
    constraint.check(problem.mdp.space, problem.mdp.action_names)
    batch = checked_tasks(problem, tasks)
    num = len(batch.start)
    labels = [f"demo_{k:03d}" for k in range(num)] if names is None else list(names)
    if len(labels) != num:
        raise ValueError(f"names: expected {num}, one a task, got {len(labels)}")
    for k in np.flatnonzero(constraint.contains(batch.start, problem.mdp.space)):
        raise ValueError(
            f"{labels[k]}: task {k} starts at {batch.start[k].tolist()}, inside {constraint.name}, "
            "which its demonstration must not enter: choose another start"
        )
    return batch, labels


def checked_tasks(problem: Problem, tasks: Task | Iterable[Task]) -> Task:
    """Return tasks as one batch, starts [K, n] and goals [K, g], float64.

    Raises:
      ValueError: if shapes are wrong, numbers are not finite, a start or goal lies outside the
        bounds, or no trajectory can begin at a start.
    """
    check_process()
    mdp = problem.mdp
    if not isinstance(tasks, Iterable):
        raise ValueError(f"tasks: expected swerve.Task(start, goal), got {tasks!r}")
    batch = tasks if isinstance(tasks, Task) else Task.stack(list(tasks))
    # -0 becomes 0: tasks that are equal are sampled from equal random numbers
    start = np.atleast_2d(real_numbers(batch.start, "tasks: start")) + 0.0
    goal = real_numbers(batch.goal, "tasks: goal").reshape(len(start), -1) + 0.0
    for label, values, names in (
        ("start", start, mdp.state_names),
        ("goal", goal, mdp.goal_names),
    ):
        if values.shape[1] != len(names):
            raise ValueError(
                f"tasks: expected a {label} of {len(names)} numbers ({', '.join(names)}), "
                f"got {values.shape[1]}"
            )
        if not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise ValueError(f"tasks: {label} of task {bad} is not finite: {values[bad].tolist()}")
    for k in range(len(start)):
        check_bounds(Task(start[k], goal[k]), mdp.space, mdp.goal_names, f"tasks: task {k}")
    allowed = jax.vmap(lambda start, goal: can_begin(problem, start, goal))(
        jnp.asarray(start, jnp.float32), jnp.asarray(goal, jnp.float32)
    )
    for k in np.flatnonzero(~np.asarray(allowed)):
        inside = [c.name for c in problem.known if c.contains(start[k], mdp.space)]
        where = (
            f"inside the known constraint {inside[0]}" if inside else "where the episode is over"
        )
        raise ValueError(f"tasks: task {k} starts at {start[k].tolist()}, {where} already")
    return Task(start, goal)


def checked_task(problem: Problem, task: Task) -> Task:
    """Return a single task, start [n] and goal [g], float64.

    Raises:
      ValueError: as from `checked_tasks`, or if there are several tasks.
    """
    start, goal = checked_tasks(problem, task)
    if len(start) != 1:
        raise ValueError(f"task: expected a single one, got {len(start)}")
    return Task(start[0], goal[0])
