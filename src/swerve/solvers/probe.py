"""Probes: how far a policy is from pi_0 on a few tasks, while it is trained.

    KL(pi || pi_0) = log Z_0 - E_pi[l],    ESS = (sum w)^2 / sum w^2,

log Z_0 by the same few trajectories: an alarm, too small where modes are missed.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve import estimators
from swerve.problem import Problem
from swerve.samples import log_weights
from swerve.space import Task
from swerve.tasks import draw_tasks
from swerve.trajectory import Policy, rollout

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
      tasks: starts [K, n] and goals [K, g], of which the first are taken; drawn if None.
    """

    def __init__(self, problem: Problem, tasks: Task | None) -> None:
        if tasks is None:
            tasks = draw_tasks(problem, NUM_TASKS)
        self.problem = problem
        self.tasks = Task(*(np.asarray(x[:NUM_TASKS], np.float32) for x in tasks))

    def read(self, policy: Policy) -> Reading:
        """Roll out a policy and say how far it is from pi_0; always with the same numbers."""
        start, goal = (jnp.repeat(jnp.asarray(x.T), NUM_TRAJECTORIES, axis=1) for x in self.tasks)
        drawn = rollout(self.problem, policy, start, goal, jax.random.key(0), start.shape[1])
        log_weight = log_weights(self.problem.record, drawn).reshape(-1, NUM_TRAJECTORIES)
        rows = log_weight[np.isfinite(log_weight).any(axis=1)]
        if not len(rows):
            return Reading(np.inf, np.inf, 0.0)
        kl = [estimators.kl_divergence(row, estimators.log_partition(row)) for row in rows]
        share = [estimators.effective_sample_size(row) / NUM_TRAJECTORIES for row in rows]
        return Reading(float(np.median(kl)), max(kl), float(np.median(share)))
