"""Work out total rewards of demonstrations, and their divergence from a constrained distribution.

    R(xi) = sum_t r(s_t, a_t, s_{t+1}) + r_T(s_L)

Both read the steps of the model that a demonstration took (see `steps`), at whatever rate it was
recorded.

Shapes: M demonstrations, L steps of one, m action dimensions.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections import Counter
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from swerve.base.forked import check_process
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.matching import group_each
from swerve.fitting.steps import LEAST_PADDED, Steps, at_states, steps_taken
from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem, padded
from swerve.systems.tabular import TabularMDP

SAME_ACTION = 1e-6  # of the largest action: what single precision and nine digits leave of it


def total_rewards(problem: Problem, demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Return the total rewards R_i [M] of demonstrations, for the steps of the model.

    Raises:
      ValueError: as from `steps_taken`, or if a total reward is not finite.
    """
    check_process()
    return np.array(
        [total_reward(problem, item, steps_taken(problem, item)) for item in demonstrations]
    )


def total_reward(problem: Problem, demonstration: Demonstration, steps: Steps) -> float:
    """Return R(xi) of a demonstration that took these steps.

    Raises:
      ValueError: if the total reward is not finite.
    """
    mdp, goal = problem.mdp, jnp.asarray(demonstration.task.goal, jnp.float32)
    if isinstance(mdp, TabularMDP):
        number = mdp.transitions.number(steps.states)
        end = np.asarray(at_states(mdp, goal)[0], float)[number[-1]]
        rewards = mdp.rewards[number[:-1], mdp.action_index(steps.actions)]
    else:
        states, actions, following = (
            jnp.asarray(padded(part, LEAST_PADDED), jnp.float32)
            for part in (steps.states[:-1], steps.actions, steps.states[1:])
        )
        each = _rewards(problem, states, actions, following, goal)
        rewards, ends = (np.asarray(part)[: len(steps.actions)] for part in each)
        end = float(ends[-1])
    earned = float(np.asarray(rewards, float).sum() + end)
    if not math.isfinite(earned):
        raise ValueError(
            f"{demonstration.name}: expected a finite total reward, got {earned}: correct the "
            "demonstration, or the rewards of the MDP"
        )
    return earned


@of_problem
def _rewards(
    problem: Problem,
    states: Float[Array, "L n"],
    actions: Float[Array, "L m"],
    following: Float[Array, "L n"],
    goal: Float[Array, " g"],
) -> tuple[Array, Array]:
    """Return r [L] of steps, and r_T [L] of the states that the steps lead to."""
    rewards = jax.vmap(problem.mdp.reward, (0, 0, 0, None))(states, actions, following, goal)
    return rewards, jax.vmap(problem.mdp.terminal_reward, (0, None))(following, goal)


def divergence(
    problem: Problem, demonstrations: Sequence[Demonstration], log_partition: np.ndarray
) -> float:
    """Return KL(demonstrations || pi_C) in nats per demonstration.

        KL = sum p log p - mean [beta R + log m] + mean log Z_C,

    where p is the frequency of a distinct demonstration among the demonstrations of its task. The
    dynamics are deterministic, so demonstrations of a task are the same if their actions are.

    Args:
      problem: dynamics and reward.
      demonstrations: demonstrations with actions, recorded at any rate; of a tabular MDP, states
        may be enough.
      log_partition: [M] log Z_C of the task of each demonstration, nats.

    Raises:
      ValueError: if there is not one finite log Z_C a demonstration; or a demonstration lacks
        actions, takes more steps than the horizon, has a step that the MDP does not allow, or has a
        total reward that is not finite.
    """
    check_process()
    if isinstance(demonstrations, Demonstration) or not len(demonstrations):
        raise ValueError("demonstrations: expected a list of at least one")
    log_partition = np.asarray(log_partition, float)
    if log_partition.shape != (len(demonstrations),):
        raise ValueError(
            f"log_partition: expected one number for each of {len(demonstrations)} demonstrations, "
            f"log Z_C of its task, got shape {log_partition.shape}"
        )
    if not np.isfinite(log_partition).all():
        raise ValueError(f"log_partition: expected finite numbers, got {log_partition.tolist()}")
    taken = [steps_taken(problem, item) for item in demonstrations]
    log_measure = -math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
    terms = [
        value - problem.beta * total_reward(problem, item, steps) - log_measure * len(steps.actions)
        for item, steps, value in zip(demonstrations, taken, log_partition, strict=True)
    ]
    tasks = Task.stack([item.task for item in demonstrations])
    task_of = group_each(problem.record, tasks).tolist()
    path_of = _path_of(task_of, [steps.actions for steps in taken])
    of_task, of_path = Counter(task_of), Counter(path_of)
    log_share = [
        math.log(of_path[path] / of_task[task]) for path, task in zip(path_of, task_of, strict=True)
    ]
    return float(np.mean(log_share) + np.mean(terms))


def _path_of(task_of: list[int], actions: list[np.ndarray]) -> list[tuple[int, int, int]]:
    """Return what names the trajectory of each demonstration [M]: task, length, and a number.

    Only trajectories whose sums of weighted actions agree are compared: no weight is above 1, so
    the sums of the same actions differ by at most the slack of all actions together.
    """
    known: dict[tuple[int, int], list[tuple[float, int, np.ndarray]]] = {}
    names = []
    for task, taken in zip(task_of, actions, strict=True):
        alike = known.setdefault((task, len(taken)), [])  # in the order of their sums
        slack = SAME_ACTION * np.abs(taken).max(initial=0.0)
        total = float(np.cos(np.arange(taken.size)) @ taken.ravel())
        reach = taken.size * slack
        last = bisect_right(alike, (total + reach, len(alike)))
        near = alike[bisect_left(alike, (total - reach,)) : last]
        apart = [(np.abs(other - taken).max(initial=0.0), number) for _, number, other in near]
        distance, number = min(apart, default=(math.inf, -1))
        if distance > slack:
            number = len(alike)
            insort(alike, (total, number, taken))
        names.append((task, len(taken), number))
    return names
