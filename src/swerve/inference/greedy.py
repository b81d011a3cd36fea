"""Pick several constraints, one after another (Scobee & Sastry, 2019, Algorithm 2).

A demonstration ignores the constraints C in force with probability eps. The log-likelihood of the
demonstrations is (see `likelihood`)

    log L(C) = sum_d log(eps + (1 - eps) 1[d avoids C] Z_0 / Z_C(task of d)),

where, for each task, C holds the constraints that count for the task. The next pick is the
hypothesis c of the largest gain log L(C + c) - log L(C). With eps = 0 the gain is

    - sum_d log P(avoid c | avoid C)    over the c that no demonstration enters,

which is D times the decrease of KL(demonstrations || pi_C), see `fitting.rewards.divergence`.
The posterior odds of one more constraint, whichever it is, against no further constraint are

    o sum_c prior(c) L(C + c) / L(C) / sum_c prior(c),    c not picked,

with prior odds o. L(C + c) is 0 where a demonstration rules c out, and where no trajectory of a
task avoids both C and c. Picking ends when these odds fall below 1, or instead when the gain falls
below a threshold. For the first pick the odds are (1 - P(none)) / P(none) of the posterior, so that
a constraint is picked if and only if P(none) is at most 1/2.

Shapes: K tasks, H hypotheses, D demonstrations, M hypotheses asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from swerve.base.arguments import number_or_nan, positive_number, whole_number
from swerve.base.groups import sums_of_groups
from swerve.evidence.estimators import LogRatio, joint_error
from swerve.inference import likelihood, posterior
from swerve.inference.conditional import Conditional, conditional
from swerve.inference.ranking import Ranking, check_ranking

if TYPE_CHECKING:
    from swerve.evidence.exact import ExactNominal

TIED = 1e-9  # relative difference: closer gains are ties, and the lowest index is picked
NEAR = 1e-6  # relative difference: closer gains are estimated again with all digits


class Pick(NamedTuple):
    """One picked constraint.

    Attributes:
      hypothesis: index of the hypothesis.
      gain: nats per demonstration by which the pick raises the log-likelihood, given the earlier
        picks; a lower bound where hardly any sample that avoids the earlier picks also avoids this
        pick.
      standard_error: standard error of the gain, nats, with the earlier picks taken as known; by
        the spread over islands where trajectories share ancestors; 0 where answers are exact;
        infinite where no samples of a task are left, or all samples left are of one island.
      log_partition: [K] log Z_C with this pick and all earlier picks in force, nats.
      total_gain: gain of all demonstrations together, nats.
      log_odds: log posterior odds, nats, of one more constraint (any hypothesis) against no further
        constraint, at the time of the pick.
    """

    hypothesis: int
    gain: float
    standard_error: float
    log_partition: np.ndarray
    total_gain: float
    log_odds: float


class Picks(list[Pick]):
    """The picks of greedy selection in order, and why it ended.

    Attributes:
      ended: why picking ended: "most" (as many as asked for), "odds" (one more constraint is less
        probable than no further constraint), "threshold" (no hypothesis gains enough), or
        "exhausted" (no hypothesis that is left gains anything).
      following: the pick that would have been next; None after "most" and "exhausted".
      threshold: least gain of a pick that was asked for [nats per demonstration], or None.
      effective_samples: effective sample size by which picking ended: of trajectories that avoid
        the picks, the least of any task; infinite where answers are exact.
    """

    def __init__(
        self,
        picks: Iterable[Pick],
        ended: Literal["most", "odds", "threshold", "exhausted"],
        following: Pick | None,
        threshold: float | None,
        effective_samples: float,
    ) -> None:
        super().__init__(picks)
        self.ended, self.following, self.threshold = ended, following, threshold
        self.effective_samples = effective_samples


def greedy(
    inference: Ranking,
    nominal: ExactNominal | None = None,
    *,
    threshold: float | None = None,
    odds: float | None = None,
    most: int | None = None,
) -> Picks:
    """Pick constraints one after another, as long as each pick explains enough.

    What is enough is told by the posterior odds of one more constraint, whichever it is, against no
    further constraint, by a least gain in nats, or by both.

    Args:
      inference: inference from `infer`; its tolerance, margin, clearance and prior hold for every
        pick. The trajectories of its evidence are reweighed for the picks in force. Ratios from
        `resolve` count for the first pick; later picks use the trajectories alone. A hypothesis of
        prior 0 is not picked, unless P(none) is 1 and there is a threshold without odds.
      nominal: if the evidence is exact, the nominal distribution that the evidence came from. It is
        solved again with the picks in force.
      threshold: least gain of a pick [nats per demonstration]. With a threshold the odds end
        picking only if they are given too.
      odds: prior odds of one more constraint against no further constraint, at every pick; picking
        ends when the posterior odds are below 1. If None, the odds of the inference's prior,
        (1 - P(none)) / P(none), so that the first pick agrees with the inference's posterior.
      most: largest number of picks; no limit if None.

    Returns:
      The picks, in order, and why picking ended. `inference.warnings` has those about the samples.

    Raises:
      ValueError: if there is no demonstration, the threshold is no number >= 0, the odds are not
        above 0, or the evidence is exact and the nominal distribution is not given.
    """
    check_ranking(inference)
    threshold = checked_threshold(threshold)
    log_prior_odds = _log_prior_odds(inference, odds)
    is_by_odds = threshold is None or odds is not None
    most = None if most is None else whole_number(most, "most", 1)
    ratios, picks = conditional(inference, nominal), list[Pick]()
    for pick in _candidates(inference, ratios, log_prior_odds):
        if threshold is not None and pick.gain < threshold:
            return Picks(picks, "threshold", pick, threshold, ratios.effective_samples)
        if is_by_odds and pick.log_odds < 0.0:
            return Picks(picks, "odds", pick, threshold, ratios.effective_samples)
        picks.append(pick)
        if len(picks) == most:
            return Picks(picks, "most", None, threshold, ratios.effective_samples)
    return Picks(picks, "exhausted", None, threshold, ratios.effective_samples)


def _candidates(inference: Ranking, ratios: Conditional, log_prior_odds: float) -> Iterator[Pick]:
    """Yield the hypothesis of the largest gain, with those before it in force, until none gains."""
    in_force = InForce(inference)
    while (pick := _best(inference, in_force, ratios, log_prior_odds)) is not None:
        yield pick
        in_force.add(pick.hypothesis, pick.log_partition)
        ratios.add(pick.hypothesis)


def checked_threshold(threshold: float | None) -> float | None:
    """Return the least gain of a pick [nats per demonstration] after checking it; None for none.

    Raises:
      ValueError: if the threshold is no number >= 0.
    """
    expected = "a number >= 0 (nats a demonstration)"
    if threshold is not None and not 0.0 <= number_or_nan(threshold) < math.inf:
        raise ValueError(f"threshold: expected {expected}, got {threshold}")
    return threshold


def _log_prior_odds(inference: Ranking, odds: float | None) -> float:
    """Return the log prior odds of one more constraint against no further constraint."""
    if odds is not None:
        return math.log(positive_number(odds, "odds"))
    none = float(inference.prior[0])
    with np.errstate(divide="ignore"):
        return float(np.log(1.0 - none) - np.log(none))


def _best(
    inference: Ranking, in_force: InForce, ratios: Conditional, log_prior_odds: float
) -> Pick | None:
    """Return the hypothesis of the largest gain among those left; None if no gain is above 0."""
    num = in_force.num_demonstrations
    total_gain = in_force.gains(ratios.log_ratio)
    near = in_force.near_best(total_gain)
    if not len(near):
        return None
    refined = ratios.refined(near)
    total_gain[near] = in_force.gains(refined.value, near)
    best = float(total_gain[near].max()) / num
    if best < TIED:
        return None
    is_best = total_gain[near] / num >= best - TIED * max(1.0, best)
    place = int(np.flatnonzero(is_best)[0])
    index, gain = int(near[place]), float(total_gain[near[place]])
    log_ratio = LogRatio(refined.value[:, place], refined.standard_error[:, place])
    return Pick(
        hypothesis=index,
        gain=gain / num,
        standard_error=in_force.gain_error(index, log_ratio) / num,
        log_partition=in_force.log_partition
        + np.where(inference.is_counted[:, index], log_ratio.value, 0.0),
        total_gain=gain,
        log_odds=in_force.log_odds(total_gain, log_prior_odds),
    )


class InForce:
    """Constraints in force, and the gain of one more constraint.

    Attributes:
      left: [H] True for hypotheses that may be picked.
      log_partition: [K] log Z_C, nats.
      num_demonstrations: D.
    """

    def __init__(self, inference: Ranking) -> None:
        self._inference = inference
        self._is_picked = np.zeros(len(inference.struck_out), bool)
        self._is_obeyed = np.ones(len(inference.demonstrations), bool)
        self._counts = inference.counts
        allowed = inference.prior[1:] > 0.0
        self.left = ~inference.struck_out & (allowed | ~allowed.any())
        self.log_partition = inference.evidence.log_partition
        self.num_demonstrations = len(inference.demonstrations)

    def add(self, index: int, log_partition: np.ndarray) -> None:
        """Put one more hypothesis in force, given log Z_C [K] with this hypothesis, nats."""
        inference = self._inference
        self.left[index], self._is_picked[index] = False, True
        self.log_partition = log_partition
        enters = inference.entered[:, index] & inference.is_counted[inference.task_of, index]
        if (enters & self._is_obeyed).any():
            self._is_obeyed &= ~enters
            self._counts = self._counts_of_obeyed()

    @property
    def _log_share(self) -> np.ndarray:
        """[K] log Z_C / Z_0, nats; 0 where no demonstration avoids C, since the log may be -inf."""
        share = self.log_partition - self._inference.evidence.log_partition
        task_of = self._inference.task_of[self._is_obeyed]
        return np.where(np.bincount(task_of, minlength=len(share)) > 0, share, 0.0)

    def _counts_of_obeyed(self) -> likelihood.Counts:
        """Count the demonstrations that avoid C and avoid or enter each hypothesis."""
        inference = self._inference
        task_of, entered = inference.task_of[self._is_obeyed], inference.entered[self._is_obeyed]
        num = np.bincount(task_of, minlength=len(inference.is_counted))[:, None]
        entering = sums_of_groups(entered, task_of, len(num))
        is_counted = inference.is_counted
        return likelihood.Counts((num - entering) * is_counted, entering * is_counted)

    def gains(self, log_ratio: np.ndarray, indices: np.ndarray | None = None) -> np.ndarray:
        """Return log L(C + c) - log L(C) [M], nats; -inf where no trajectory avoids C and c.

        A demonstration that already enters C adds no gain. A demonstration that avoids C and c adds
        more gain, the fewer of the trajectories that avoid C also avoid c. The likelihood of a
        demonstration that avoids C and enters c falls to eps.

        Args:
          log_ratio: [K, M] log P(avoid c | avoid C), nats.
          indices: [M] the hypotheses of these ratios; all hypotheses if None.
        """
        tolerance = self._inference.tolerance
        counts, is_used = self._counts, self._inference.is_used
        if indices is not None:
            counts = likelihood.Counts(*(values[:, indices] for values in counts))
            is_used = is_used[:, indices]
        impossible = (np.isneginf(log_ratio) & is_used).any(axis=0)
        before = likelihood.avoiding_term(self._log_share, tolerance)[:, None]
        is_needed = (counts.avoiding > 0) & ~impossible
        log_ratio = np.where(is_needed, log_ratio, 0.0)  # unused ratios may be infinite
        after = likelihood.avoiding_term(self._log_share[:, None] + log_ratio, tolerance)
        gain = counts.avoiding * (after - before)
        if tolerance > 0.0:
            gain = gain + counts.entering * (math.log(tolerance) - before)
        return np.where(impossible, -np.inf, gain.sum(axis=0))

    def gain_error(self, index: int, log_ratio: LogRatio) -> float:
        """Return the standard error of the gain of one more hypothesis, given its log ratios."""
        num, sample_of = self._counts.avoiding[:, index], self._inference.evidence.sample_of
        used = num > 0  # unused ratios and errors may be infinite
        value = self._log_share[used] + log_ratio.value[used]
        slope = likelihood.sensitivity(value, self._inference.tolerance)
        error = num[used] * slope * log_ratio.standard_error[used]
        return float(joint_error(error, sample_of[used]))

    def near_best(self, total_gain: np.ndarray) -> np.ndarray:
        """Return the hypotheses [M] whose gain is near the largest; none if no gain is above 0."""
        gain = np.where(self.left, total_gain, -np.inf)
        gain = gain / self.num_demonstrations
        best = float(gain.max())
        if best < 0.5 * TIED:
            return np.zeros(0, int)
        return np.flatnonzero(gain >= best - max(NEAR * best, 2.0 * TIED))

    def log_odds(self, total_gain: np.ndarray, log_prior_odds: float) -> float:
        """Return the log posterior odds of one more pick against no further pick, nats."""
        prior = np.where(np.r_[False, self._is_picked], 0.0, self._inference.prior)
        gain = np.where(self.left, total_gain, -np.inf)
        return posterior.log_bayes_factor(gain, prior) + log_prior_odds
