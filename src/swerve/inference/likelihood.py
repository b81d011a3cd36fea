"""Compute how likely demonstrations are under each hypothesis, against no constraint.

A demonstration d of task k ignores the constraint with probability eps (the tolerance):

    L_d(c) = eps + (1 - eps) 1[d avoids c] Z_0 / Z_c(task_k),    log L(c) = sum_d log L_d(c).

With eps = 0 (the paper) a demonstration that enters c rules c out. A task tells nothing about a
hypothesis beside its start or goal: no demonstration of the task enters that hypothesis, whether
the constraint holds or not.

Shapes: K tasks, D demonstrations, H hypotheses.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swerve.base.arguments import number_or_nan
from swerve.constraints.edges import fine

if TYPE_CHECKING:
    from swerve.base.space import Task
    from swerve.hypotheses.base import HypothesisSet
    from swerve.problem.record import ProblemRecord

MAX_TOLERANCE = 0.5  # probability: above, a constraint would be ignored more often than obeyed
NUM_TOLERANCES = 61  # tolerances tried first, with evenly spaced logs
LEAST_TOLERANCE = 1e-6  # probability: the smallest tolerance tried
SAME_TOLERANCE = 1e-3  # difference of logs: precision of the least tolerance


class Counts(NamedTuple):
    """The numbers of demonstrations of each task that speak for and against each hypothesis.

    Attributes:
      avoiding: [K, H] demonstrations that avoid the hypothesis.
      entering: [K, H] demonstrations that enter the hypothesis.
    """

    avoiding: np.ndarray
    entering: np.ndarray


def log_likelihood(log_ratio: np.ndarray, counts: Counts, tolerance: float) -> np.ndarray:
    """Return log L [..., H], nats; -inf where a hypothesis is ruled out.

    Args:
      log_ratio: [..., K, H] log Z_c / Z_0, nats; finite where the counts are not 0.
      counts: counts of the demonstrations.
      tolerance: eps.
    """
    value = (counts.avoiding * avoiding_term(log_ratio, tolerance)).sum(axis=-2)
    entering = counts.entering.sum(axis=0)
    if tolerance == 0.0:
        return np.where(entering > 0, -np.inf, value)
    return value + entering * math.log(tolerance)


def avoiding_term(log_ratio: np.ndarray, tolerance: float) -> np.ndarray:
    """Return log L_d of a demonstration that avoids c, nats, for every log Z_c / Z_0 [...]."""
    if tolerance == 0.0:
        return -log_ratio
    return np.logaddexp(math.log(tolerance), math.log1p(-tolerance) - log_ratio)


def sensitivity(log_ratio: np.ndarray, tolerance: float) -> np.ndarray:
    """Return -d `avoiding_term` / d log Z_c / Z_0 [...], from 0 to 1."""
    if tolerance == 0.0:
        return np.ones_like(log_ratio)
    return np.exp(math.log1p(-tolerance) - log_ratio - avoiding_term(log_ratio, tolerance))


def checked_tolerance(tolerance: float) -> float:
    """Return the tolerance eps after checking it.

    Raises:
      ValueError: if eps is not from 0 to MAX_TOLERANCE: demonstrations that ignore a constraint
        more often than not tell almost nothing about the constraint.
    """
    expected = (
        f"the probability that a demonstration ignores the constraint, from 0 to {MAX_TOLERANCE}"
    )
    value = number_or_nan(tolerance)
    if not 0.0 <= value <= MAX_TOLERANCE:
        raise ValueError(f"tolerance: expected {expected}, got {tolerance!r}")
    return value


def is_counted(
    problem: ProblemRecord, tasks: Task, clearance: float | None, judged: HypothesisSet
) -> np.ndarray:
    """Return [K, H] True where demonstrations of a task count for or against a hypothesis.

    Demonstrations do not count where an end of the task lies within the clearance of the
    hypothesis. With a margin, they also do not count where an end lies in the hypothesis but less
    deep than the margin: every nominal trajectory enters the hypothesis there, and a demonstration
    that goes no deeper would be taken for strong evidence of the constraint.

    Args:
      problem: problem with the hypotheses.
      tasks: K tasks; a goal is an end of its task only where goals are states.
      clearance: the distance, in the units of the states that a hypothesis names, or None.
      judged: the hypotheses less the margin; the hypotheses themselves without a margin.

    Raises:
      ValueError: if the clearance is negative or not a number, or a hypothesis has no distance.
    """
    space, hypotheses = problem.space, problem.hypotheses
    counted = np.ones((len(tasks.start), len(hypotheses)), bool)
    if clearance is None and judged is hypotheses:
        return counted
    ends = [np.asarray(tasks.start, float)]
    if problem.goal_names == space.names:
        ends.append(np.asarray(tasks.goal, float))
    if clearance is not None:
        if not 0.0 <= number_or_nan(clearance) < math.inf:
            raise ValueError(f"clearance: expected a distance >= 0, got {clearance!r}")
        columns = [space.column(name) for name in hypotheses.state_names]
        clear = float(clearance) + fine(space.resolution[columns].max(initial=0.0), clearance)
        for end in ends:
            counted &= hypotheses.distance(end, space) > clear
    if judged is not hypotheses:
        for index in range(len(hypotheses)):
            whole, eroded = hypotheses.constraint(index), judged.constraint(index)
            for end in ends:
                counted[:, index] &= ~(whole.contains(end, space) & ~eroded.contains(end, space))
    return counted


def least_tolerance(log_ratio: np.ndarray, counts: Counts, log_prior: np.ndarray) -> float | None:
    """Return the least eps for which a hypothesis is more probable than no constraint.

    Return None if there is no such eps up to MAX_TOLERANCE.

    Args:
      log_ratio: [K, H] log Z_c / Z_0, nats; finite where the counts are not 0.
      counts: counts of the demonstrations.
      log_prior: [H] log prior(c) / P(none), nats.
    """

    def is_enough(log_tolerance: float) -> bool:
        value = log_likelihood(log_ratio, counts, math.exp(log_tolerance))
        return bool((value + log_prior > 0.0).any())

    tried = np.linspace(math.log(LEAST_TOLERANCE), math.log(MAX_TOLERANCE), NUM_TOLERANCES)
    enough = next((k for k, value in enumerate(tried.tolist()) if is_enough(value)), None)
    if enough is None:
        return None
    low, high = tried[max(enough - 1, 0)], tried[enough]
    while high - low > SAME_TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return math.exp(high)
