"""Check the samples of each task: effective sample size, islands, explorers, policy, soft value.

Samples are not to be trusted where the effective sample size is below max(100, 2 % of N) (see
`estimators.least_effective`), where independent parts of the samples differ in log Z_0 by more than
HIGH_SPREAD, or where the samples miss more than HIGH_MISSED of pi_0 (see `sampling.missed`). Errors
may be larger than stated where the samples miss less, where the policy is far from pi_0, or where
the solver's own log Z_0 differs from that of its samples.

Shapes: K tasks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swerve.base.solver_kinds import kind_stored
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import RESAMPLED
from swerve.inference.ranking import Ranking

HIGH_KL = {  # nats, by method: above this KL between policy and pi_0, errors may be understated
    "smc": math.inf,
    "tempered": math.inf,
    "importance": 0.5,
    "plain": 0.1,
}
HIGH_SPREAD = 1.0  # nats, standard deviation of log Z_0 over islands: above, the islands disagree
HIGH_MISSED = 0.1  # share of pi_0 that the samples miss: above, no estimate is to be trusted
NUM_ERRORS = 3.0  # standard errors by which the solver's log Z_0 and the samples' may differ


class Checks(NamedTuple):
    """Tasks in use that fail a check; where effective samples are too few, no other check is made.

    Attributes:
      too_few: [K] True where the effective sample size is too small.
      apart: [K] True where independent parts of the samples disagree on log Z_0.
      missing: [K] True where exploring found a part of pi_0 that the samples miss.
      far: [K] True where the policy of a task is too far from pi_0.
      closed: [K] True where by the solver's soft value nobody gets out of the start.
      value_gap: [K] unexplained gap between log Z_0 of the solver and of its samples, nats.
    """

    too_few: np.ndarray
    apart: np.ndarray
    missing: np.ndarray
    far: np.ndarray
    closed: np.ndarray
    value_gap: np.ndarray


def sample_checks(inference: Ranking) -> Checks:
    """Return which tasks fail which check; the evidence was sampled."""
    evidence, is_used = inference.evidence, inference.task_counts > 0
    is_checked = is_used & ~evidence.has_too_few
    return Checks(
        too_few=is_used & evidence.has_too_few,
        apart=is_checked & (evidence.island_spread > HIGH_SPREAD),
        missing=is_checked & evidence.is_missing,
        far=is_checked & (evidence.kl > HIGH_KL[evidence.method]),
        closed=is_checked & np.isneginf(evidence.soft_value),
        value_gap=np.where(is_checked, _value_gap(evidence), 0.0),
    )


def _value_gap(evidence: Evidence) -> np.ndarray:
    """Return [K] the unexplained gap between log Z_0 of the solver and of its samples, nats.

    Importance weights explain a gap of -log(ESS / N), for example where only the share ESS / N of
    the trajectories survives a wall. Resampled trajectories of a grid do not explain this gap,
    since their ESS counts ancestors. The gap is 0 where the solver has no soft value or closes the
    start in.
    """
    kind = kind_stored(evidence.solver)
    share = evidence.effective_sample_size / evidence.num_trajectories
    error = np.sqrt(np.maximum(1.0 / share - 1.0, 0.0) / evidence.num_trajectories)  # in log Z_0
    if evidence.method in RESAMPLED and kind.computes_value:
        share, error = np.ones_like(share), evidence.log_partition_error
    explained = NUM_ERRORS * error - np.log(share)
    allowed = kind.value_gap or 0.0
    has_value = np.isfinite(evidence.soft_value)
    value = np.where(has_value, evidence.soft_value, evidence.log_partition)
    gap = np.abs(value - evidence.log_partition) - explained - allowed
    return np.where(has_value & (gap > 0.0), gap, 0.0)
