"""Find the best pair of constraints among all pairs.

    log L(a, b) = sum_d log(eps + (1 - eps) 1[d avoids a, b] Z_0 / Z_ab(task of d)),
    Z_ab / Z_0 = 1 - P(enter a) - P(enter b) + P(enter a and b) >= 1 - P(enter a) - P(enter b).

Greedy selection may miss this pair: two constraints together can explain demonstrations that
neither constraint explains alone. P(enter a and b) of all pairs is one matrix product per task.
Before any product, the inequality rules out pairs that cannot be the best. After each task, it
rules out more pairs.

Shapes: K tasks, D demonstrations, N trajectories, H hypotheses, of these R as rows and C as
columns.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swerve.evidence import estimators
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import estimated
from swerve.hypotheses.bits import select
from swerve.inference import likelihood
from swerve.inference.conditional import conditional
from swerve.inference.greedy import TIED, InForce, greedy
from swerve.inference.ranking import Ranking, check_ranking

if TYPE_CHECKING:
    from swerve.evidence.exact import ExactNominal

BLOCK = 256  # rows and columns of a matrix product: bounds the memory


class Pair(NamedTuple):
    """Two constraints in force together.

    Attributes:
      hypotheses: indices of the two hypotheses, the lower index first.
      log_likelihood: log-likelihood ratio of both against no constraint, nats; a lower bound where
        hardly any sample avoids both.
      standard_error: standard error of `log_likelihood`, nats; 0 where answers are exact.
      log_partition: [K] log Z with both constraints in force, nats.
    """

    hypotheses: tuple[int, int]
    log_likelihood: float
    standard_error: float
    log_partition: np.ndarray


def best_pair(inference: Ranking, nominal: ExactNominal | None = None) -> Pair:
    """Return the two hypotheses that together explain the demonstrations best.

    With a tolerance, a single hypothesis may explain more than any pair: compare the pair with the
    largest `inference.log_likelihood`.

    Every pair is tried, or ruled out by a bound. The work grows with the square of the number of
    hypotheses that explain anything. An exact solver solves once for each such hypothesis.

    Args:
      inference: inference from `infer`; its tolerance, margin and clearance hold for the pair. The
        trajectories of sampled evidence are weighed for every pair; a ratio from `resolve` bounds
        the ratio of the hypothesis's pairs.
      nominal: if the evidence is exact, the nominal distribution that the evidence came from.

    Raises:
      ValueError: if there is no demonstration, fewer than two hypotheses are left, no two of them
        can be avoided together, or the evidence is exact and its nominal distribution is not given.
    """
    check_ranking(inference)
    conditional(inference, nominal)  # checks that the nominal distribution fits the evidence
    left = np.flatnonzero(~inference.struck_out)
    if len(left) < 2:
        raise ValueError(
            f"inference: expected two hypotheses that demonstrations leave, got {len(left)}"
        )
    ordered = left[np.argsort(-inference.log_likelihood[left], kind="stable")]
    if nominal is not None:
        return _exactly(inference, nominal, ordered)
    picks = greedy(inference, threshold=0.0, most=2)
    known = None
    if len(picks) == 2:
        first, second = sorted(pick.hypothesis for pick in picks)
        known = _of_samples(inference, (first, second))
    return _of_samples(inference, _search(_Samples(inference, ordered), known))


def _of_samples(inference: Ranking, pair: tuple[int, int]) -> Pair:
    """Return a pair with its log-likelihood by the samples."""
    evidence, indices = inference.evidence, np.array(pair)
    ratios = [
        _ratio_of_samples(evidence, k, indices[inference.is_counted[k, indices]])
        for k in range(evidence.num_tasks)
    ]
    log_share, error = np.array(ratios).T
    enters = inference.entered[:, indices] & inference.is_counted[inference.task_of][:, indices]
    avoids = ~enters.any(axis=1)
    num = np.bincount(inference.task_of[avoids], minlength=evidence.num_tasks)
    value = num @ likelihood.avoiding_term(log_share, inference.tolerance)
    if inference.tolerance > 0.0:
        value += np.count_nonzero(~avoids) * math.log(inference.tolerance)
    slope = likelihood.sensitivity(log_share, inference.tolerance)
    error = np.where(num > 0, error, 0.0)  # unused ratios may have no error
    spread = float(estimators.joint_error(num * slope * error, evidence.sample_of))
    return Pair(pair, float(value), spread, evidence.log_partition + log_share)


def _ratio_of_samples(evidence: Evidence, task: int, counted: np.ndarray) -> tuple[float, float]:
    """Return log Z_C / Z_0 of a task and its standard error, nats, with hypotheses C in force.

    Hardly any trajectory avoids a hypothesis that was resolved, so trajectories cannot tell how
    many of these avoid another hypothesis as well. Z_C is at most the Z_c of each, so the lowest
    ratio is taken.

    Args:
      evidence: sampled evidence.
      task: number of the task.
      counted: [C] indices of the hypotheses that count for the task.
    """
    if not len(counted):
        return 0.0, 0.0
    if evidence.is_resolved[task, counted].any():
        least = counted[evidence.log_ratio[task, counted].argmin()]
        return float(evidence.log_ratio[task, least]), float(evidence.standard_error[task, least])
    entered = select(evidence.samples.violations[task], counted).any(axis=1)
    bits, are_independent = entered.astype(np.uint8)[:, None], bool(evidence.are_independent[task])
    estimate = estimated(evidence.log_weight[task], bits, 1, are_independent)
    ratio = estimators.log_ratio(estimate, evidence.resolution[task])
    return float(ratio.value[0]), float(ratio.standard_error[0])


def _exactly(inference: Ranking, nominal: ExactNominal, ordered: np.ndarray) -> Pair:
    """Return the best pair by solving once with each hypothesis in force."""
    best: Pair | None = None
    for place, index in enumerate(ordered[:-1].tolist()):
        evidence, others = inference.evidence, ordered[place + 1 :]
        in_force, ratios = InForce(inference), conditional(inference, nominal)
        alone = np.where(inference.is_counted[:, index], evidence.log_ratio[:, index], 0.0)
        in_force.add(index, evidence.log_partition + alone)
        ratios.add(index)
        value = inference.log_likelihood[index] + in_force.gains(ratios.log_ratio)[others]
        value = np.where(np.isfinite(value), value, -np.inf)
        least = -math.inf
        if best is not None:
            least = best.log_likelihood + TIED * max(1.0, abs(best.log_likelihood))
        if not value.max() > least:
            continue
        other = int(others[np.flatnonzero(value >= value.max() - TIED * abs(value.max()))[0]])
        ratio = np.where(inference.is_counted[:, other], ratios.log_ratio[:, other], 0.0)
        pair = (min(index, other), max(index, other))
        best = Pair(pair, float(value.max()), 0.0, in_force.log_partition + ratio)
    if best is None:
        raise ValueError(
            "inference: there is no pair of hypotheses that a trajectory of every task can avoid"
        )
    return best


class _Samples:
    """Log-likelihood ratios of pairs of hypotheses by samples, task by task.

    Args:
      inference: inference with sampled evidence.
      ordered: [M] the hypotheses; the methods' rows and columns are places in this array.
    """

    def __init__(self, inference: Ranking, ordered: np.ndarray) -> None:
        evidence = inference.evidence
        self.tasks = np.flatnonzero(inference.task_counts).tolist()
        self.ordered = ordered
        self._tolerance, self._task_counts = inference.tolerance, inference.task_counts
        self._is_counted = inference.is_counted[:, ordered]
        violation = evidence.violation_probability[:, ordered]
        self._entered = np.where(self._is_counted, violation, 0.0)
        self._alone = np.where(self._is_counted, evidence.log_ratio[:, ordered], 0.0)
        self._is_resolved = self._is_counted & evidence.is_resolved[:, ordered]
        self._bits = evidence.samples.violations
        self._weight = [estimators.normalise(row) for row in evidence.log_weight]
        self._least = evidence.resolution
        enters = inference.entered[:, ordered] & self._is_counted[inference.task_of]
        self._avoids = [~enters[inference.task_of == k] for k in range(evidence.num_tasks)]

    def most(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return an upper bound [R] of each row's log-likelihood with any column, nats.

        The number of demonstrations that avoid both hypotheses is at most the number that avoid the
        row's hypothesis.
        """
        bound = np.zeros(len(rows))
        for k in self.tasks:
            share = 1.0 - self._entered[k, rows] - self._entered[k, columns].max()
            alone = np.minimum(self._alone[k, rows], self._alone[k, columns].min())
            log_share = np.minimum(np.log(np.maximum(share, self._least[k])), alone)
            num_avoiding = np.count_nonzero(self._avoids[k][:, rows], axis=0)
            bound += self._value(k, log_share, num_avoiding)
        return bound

    def bound(self, k: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return an upper bound [R, C] of the log-likelihood of pairs by one task, nats."""
        entered = self._entered[k]
        log_share = self._log_share(k, rows, columns, 1.0 - entered[rows, None] - entered[columns])
        return self._value(k, log_share, self._num_avoiding(k, rows, columns))

    def value(self, k: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the log-likelihood [R, C] of pairs by one task, nats."""
        entered, weight = self._entered[k], self._weight[k][:, None]
        both = (self._unpacked(k, rows) * weight).T @ self._unpacked(k, columns)
        share = 1.0 - entered[rows, None] - entered[columns] + both
        log_share = self._log_share(k, rows, columns, share)
        return self._value(k, log_share, self._num_avoiding(k, rows, columns))

    def _log_share(
        self, k: int, rows: np.ndarray, columns: np.ndarray, share: np.ndarray
    ) -> np.ndarray:
        """Return log Z_ab / Z_0 [R, C] from the shares of trajectories; see `_ratio_of_samples`."""
        lower = np.minimum(self._alone[k, rows, None], self._alone[k, columns])
        resolved = self._is_resolved[k, rows, None] | self._is_resolved[k, columns]
        return np.where(resolved, lower, np.log(np.maximum(share, self._least[k])))

    def _unpacked(self, k: int, places: np.ndarray) -> np.ndarray:
        """Return [N, R] 1 where a trajectory enters a hypothesis that counts for the task."""
        places = np.where(self._is_counted[k, places], places, -1)
        bits = select(self._bits[k], self.ordered[places])
        return np.where(places >= 0, bits, 0).astype(np.float64)

    def _num_avoiding(self, k: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        avoids = self._avoids[k].astype(np.float64)
        return avoids[:, rows].T @ avoids[:, columns]

    def _value(self, k: int, log_share: np.ndarray, num_avoiding: np.ndarray) -> np.ndarray:
        """Return the log-likelihood of pairs by one task, nats."""
        value = num_avoiding * likelihood.avoiding_term(log_share, self._tolerance)
        if self._tolerance > 0.0:
            value += (self._task_counts[k] - num_avoiding) * math.log(self._tolerance)
        return value


def _search(samples: _Samples, known: Pair | None) -> tuple[int, int]:
    """Return the best pair; the known pair if no other pair is better."""
    best = -math.inf if known is None else known.log_likelihood
    pair = None if known is None else known.hypotheses
    places = np.arange(len(samples.ordered))
    for first in range(0, len(places), BLOCK):
        for second in range(first, len(places), BLOCK):
            rows, columns = places[first : first + BLOCK], places[second : second + BLOCK]
            least = best + TIED * max(1.0, abs(best)) if pair else -math.inf
            rows = rows[samples.most(rows, columns) > least]
            if not len(rows):
                continue
            columns = columns[samples.most(columns, rows) > least]
            rows, columns, value = _values(samples, rows, columns, least)
            if value.size and value.max() > least:
                row, column = np.unravel_index(int(value.argmax()), value.shape)
                indices = samples.ordered[[rows[row], columns[column]]]
                best, pair = float(value.max()), (int(indices.min()), int(indices.max()))
    assert pair is not None
    return pair


def _values(
    samples: _Samples, rows: np.ndarray, columns: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows and columns of pairs better than `least`, and their values [R, C].

    The values start as upper bounds. Task after task replaces its bound by its value, and rows and
    columns without a pair above `least` are left out. Values are -inf where the column is not after
    the row.
    """
    value = np.where(rows[:, None] < columns, 0.0, -np.inf)
    for k in samples.tasks:
        value = value + samples.bound(k, rows, columns)
    for k in samples.tasks:
        some, others = (value > least).any(axis=1), (value > least).any(axis=0)
        rows, columns, value = rows[some], columns[others], value[np.ix_(some, others)]
        if not value.size:
            break
        value = value + samples.value(k, rows, columns) - samples.bound(k, rows, columns)
    return rows, columns, value
