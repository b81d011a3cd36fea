"""Total rewards of demonstrations, their divergence, beta of maximum likelihood, and prefixes.

Shapes: M demonstrations, K tasks, N trajectories, H hypotheses, L states.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
from brute_force.reference.answers import Answer
from brute_force.reference.cases import Case
from brute_force.reference.paths import log_sum
from brute_force.reference.recordings import Recording


def earned(case: Case, recording: Recording) -> tuple[float, int]:
    """Return R of a demonstration, and its number of steps."""
    paths = case.paths[recording.task]
    if recording.way != "cut":
        return float(paths.reward[recording.path]), int(paths.length[recording.path])
    num, goal = len(recording.actions), case.goals[recording.task]
    state, total = recording.states[:1], 0.0
    for step in range(num):
        moved = case.world.moves(state, int(paths.actions[recording.path, step]), goal)
        total += float(moved.rewards[0])
        state = moved.states
        if step == num - 1:
            total += float(moved.terminal[0])
    return total, num


def divergence(case: Case, log_partition: np.ndarray) -> float:
    """Return sum p log p - mean [beta R + log m] + mean log Z_C [M], nats a demonstration."""
    offset = math.log(len(case.world.actions)) if case.measure == "uniform" else 0.0
    keys, terms = [], []
    for recording, value in zip(case.recordings, log_partition, strict=True):
        reward, num = earned(case, recording)
        terms.append(value - case.beta * reward + offset * num)
        actions = case.paths[recording.task].actions[recording.path, :num]
        taken = case.world.actions[actions]  # by their values: two actions may be the same
        keys.append((recording.task, taken.tobytes()))
    of_task, of_key = Counter(key[0] for key in keys), Counter(keys)
    shares = [math.log(of_key[key] / of_task[key[0]]) for key in keys]
    return float(np.mean(shares) + np.mean(terms))


class BetaLikelihood:
    """Log L(beta) of demonstrations in which only what is known was in force.

    Args:
      rewards: for each task of a demonstration, R of its trajectories [N].
      log_base: for each task, the trajectories' log-weights [N] at beta = 0, nats.
      counts: demonstrations of each task.
      total: sum of the rewards of the demonstrations.
    """

    def __init__(
        self, rewards: list[np.ndarray], log_base: list[np.ndarray], counts: list[int], total: float
    ) -> None:
        self._parts = list(zip(rewards, log_base, counts, strict=True))
        self._total = total

    def value(self, beta: float) -> float:
        """Return log L, nats, up to a constant."""
        spent = sum(num * log_sum(base + beta * reward) for reward, base, num in self._parts)
        return beta * self._total - spent

    def slope(self, beta: float) -> float:
        """Return d log L / d beta."""
        expected = 0.0
        for reward, base, num in self._parts:
            log_weight = base + beta * reward
            weight = np.exp(log_weight - log_weight.max())
            expected += num * float(weight @ reward / weight.sum())
        return self._total - expected

    def best(self, low: float, high: float) -> float:
        """Return where the slope is 0, between two betas of slopes of different sign."""
        return _halved(lambda beta: self.slope(beta) > 0.0, low, high)

    def fallen(self, best: float, end: float, drop: float) -> float:
        """Return where log L has fallen by `drop` between the best beta and an end."""
        level = self.value(best) - drop
        return _halved(lambda beta: self.value(beta) > level, best, end)


def _halved(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    for _ in range(80):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def ahead(case: Case, task: int, prefix: np.ndarray, step: int) -> np.ndarray:
    """Return log P_0(avoid c after a step | the actions so far) [H], nats.

    Args:
      case: the problem.
      task: number of the task.
      prefix: [step] actions so far, by number.
      step: steps taken.
    """
    paths, by = case.paths[task], case.entered_by[task]
    rows = (paths.actions[:, :step] == prefix[:step]).all(axis=1)
    log_weight, by = case.log_weights[task][rows], by[rows]
    was_entered = by <= step + 1
    later = np.where(was_entered, False, by < case.world.num_steps + 2)
    total = log_sum(log_weight)
    return np.array([log_sum(log_weight[~column]) - total for column in later.T])


def prefix_log_likelihood(answer: Answer, recording: Recording, step: int) -> np.ndarray:
    """Return log L_t(c) [H], nats, of the first `step` steps of a demonstration."""
    case, task = answer.case, recording.task
    prefix = case.paths[task].actions[recording.path]
    with np.errstate(invalid="ignore"):  # where nobody avoids a hypothesis
        value = ahead(case, task, prefix, step) - answer.log_ratio[task]
    value = np.where(case.is_counted[task], value, 0.0)
    entered = case.entered_by[task][recording.path] <= step + 1
    entered &= case.is_counted[task]
    eps = case.assumed.tolerance
    likelihood = eps + (1.0 - eps) * np.where(entered, 0.0, np.exp(value))
    out = np.isneginf(answer.log_ratio[task]) & case.is_counted[task]
    with np.errstate(divide="ignore"):
        return np.where(out, -np.inf, np.log(likelihood))
