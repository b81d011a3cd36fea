"""Estimate how far a policy is from pi_0 on a few tasks, while the policy is trained.

    KL(pi || pi_0) = log Z_0 - E_pi[l],    ESS = (sum w)^2 / sum w^2,

where log Z_0 is estimated from the same few trajectories. The KL serves as an alarm: it is too
small where the policy misses modes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.space import Task
from swerve.evidence import estimators
from swerve.evidence.samples import log_weights
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_tasks, draw_tasks
from swerve.simulation.trajectory import Policy, rollout

NUM_TASKS = 8  # tasks of a probe, at most
NUM_TRAJECTORIES = 128  # trajectories a task: few, since a probe follows every chunk of training


class Reading(NamedTuple):
    """Result of a probe, over the tasks in which any trajectory is allowed.

    Attributes:
      kl: median KL, nats; infinite where every trajectory enters a known constraint.
      worst_kl: largest KL, nats.
      effective_share: median ESS, as a share of the trajectories.
    """

    kl: float
    worst_kl: float
    effective_share: float

    def __str__(self) -> str:
        """Return for example 'KL 0.84 nats  ESS 35 %'."""
        if np.isinf(self.kl):
            return "every probe enters a known constraint"
        return f"KL {self.kl:.2f} nats  ESS {100 * self.effective_share:.0f} %"


class Progress(NamedTuple):
    """How training went up to the end of a chunk.

    Attributes:
      seconds: time of training so far, without compiling and probes.
      num_steps: environment steps so far.
      kl: median KL over the tasks tried, nats.
      worst_kl: largest KL, nats.
      effective_share: median ESS, as a share of the trajectories.
      residual: median |beta r + log m - log pi + V(s') - V(s)| in the lanes, nats; 0 for pi_0 and
        its soft value. For a look-ahead policy this is |(B V)(s) - V(s)|.
    """

    seconds: float
    num_steps: float
    kl: float
    worst_kl: float
    effective_share: float
    residual: float

    def __str__(self) -> str:
        """Return for example 'KL 0.84 nats  ESS 35 %  residual 0.12 nats'."""
        reading = Reading(self.kl, self.worst_kl, self.effective_share)
        return f"{reading}  residual {self.residual:.2g} nats"


def check_history(history: np.ndarray) -> None:
    """Raise ValueError unless an array [C, 6] that others may have written has rows of `Progress`.

    A KL may be infinite, and nothing is NaN.
    """
    num_columns = len(Progress._fields)
    if history.ndim != 2 or not len(history) or history.shape[1] != num_columns:
        raise ValueError(
            f"array 'history' has shape {history.shape}, expected rows of {num_columns} numbers"
        )
    if history.dtype.kind != "f" or np.isnan(history).any():
        raise ValueError("array 'history': expected real numbers, none of them NaN")


class Probe:
    """A few tasks on which policies are tried.

    Args:
      problem: problem that is learned.
      tasks: tasks as for `sample`; the first NUM_TASKS are used. Sampled from the MDP if None.

    Raises:
      ValueError: if a task does not fit the problem.
    """

    def __init__(self, problem: Problem, tasks: Task | None) -> None:
        tasks = draw_tasks(problem, NUM_TASKS) if tasks is None else checked_tasks(problem, tasks)
        self.problem = problem
        self.tasks = Task(*(np.asarray(x[:NUM_TASKS], np.float32) for x in tasks))

    def read(self, policies: Sequence[tuple[Policy, float]]) -> Reading:
        """Return the worst of each number over the readings of policies, each at its beta."""
        readings = [self._read(policy, beta) for policy, beta in policies]
        kl, worst, share = zip(*readings, strict=True)
        return Reading(max(kl), max(worst), min(share))

    def _read(self, policy: Policy, beta: float) -> Reading:
        """Roll out a policy, always with the same random numbers, and weigh its trajectories."""
        start, goal = (jnp.repeat(jnp.asarray(x.T), NUM_TRAJECTORIES, axis=1) for x in self.tasks)
        sampled = rollout(self.problem, policy, start, goal, jax.random.key(0), start.shape[1])
        record = dataclasses.replace(self.problem.record, beta=beta)
        log_weight = log_weights(record, sampled).reshape(-1, NUM_TRAJECTORIES)
        rows = log_weight[np.isfinite(log_weight).any(axis=1)]
        if not len(rows):
            return Reading(np.inf, np.inf, 0.0)
        kl = [estimators.kl_divergence(row, estimators.log_partition(row)) for row in rows]
        share = [estimators.effective_sample_size(row) / NUM_TRAJECTORIES for row in rows]
        return Reading(float(np.median(kl)), max(kl), float(np.median(share)))
