"""Probes: how far a policy is from pi_0 on a few tasks, while it is trained.

    KL(pi || pi_0) = log Z_0 - E_pi[l],    ESS = (sum w)^2 / sum w^2,

log Z_0 by the same few trajectories: an alarm, too small where modes are missed.
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

NUM_TASKS = 8
NUM_TRAJECTORIES = 128  # a task


class Reading(NamedTuple):
    """What a probe says, over the tasks in which any trajectory is allowed.

    Attributes:
      kl: median KL, nats; infinite where every trajectory enters a known constraint.
      worst_kl: the largest.
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


class Probe:
    """A few tasks on which policies are tried.

    Args:
      problem: what is learned.
      tasks: as for `sample`, the first of them being taken; drawn if None.

    Raises:
      ValueError: if a task is not one of the problem.
    """

    def __init__(self, problem: Problem, tasks: Task | None) -> None:
        tasks = draw_tasks(problem, NUM_TASKS) if tasks is None else checked_tasks(problem, tasks)
        self.problem = problem
        self.tasks = Task(*(np.asarray(x[:NUM_TASKS], np.float32) for x in tasks))

    def read(self, policies: Sequence[tuple[Policy, float]]) -> Reading:
        """Return how far policies are from pi_0 at the beta of each: the worst of each figure."""
        readings = [self._read(policy, beta) for policy, beta in policies]
        kl, worst, share = zip(*readings, strict=True)
        return Reading(max(kl), max(worst), min(share))

    def _read(self, policy: Policy, beta: float) -> Reading:
        """Roll out a policy; always with the same numbers."""
        start, goal = (jnp.repeat(jnp.asarray(x.T), NUM_TRAJECTORIES, axis=1) for x in self.tasks)
        drawn = rollout(self.problem, policy, start, goal, jax.random.key(0), start.shape[1])
        record = dataclasses.replace(self.problem.record, beta=beta)
        log_weight = log_weights(record, drawn).reshape(-1, NUM_TRAJECTORIES)
        rows = log_weight[np.isfinite(log_weight).any(axis=1)]
        if not len(rows):
            return Reading(np.inf, np.inf, 0.0)
        kl = [estimators.kl_divergence(row, estimators.log_partition(row)) for row in rows]
        share = [estimators.effective_sample_size(row) / NUM_TRAJECTORIES for row in rows]
        return Reading(float(np.median(kl)), max(kl), float(np.median(share)))
