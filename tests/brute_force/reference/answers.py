"""What follows from weighted trajectories and demonstrations, by the formulas and nothing else.

    L_d(C) = eps + (1 - eps) 1[d avoids C] Z_0 / Z_C(task of d),    log L(C) = sum_d log L_d(C),
    P(c | demonstrations) ~ prior(c) L(c),    L(none) = 1,

where, for each task, C holds the constraints that count for the task.

Shapes: K tasks, N trajectories of one, H hypotheses, D demonstrations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from brute_force.reference.cases import Case
from brute_force.reference.paths import log_sum

TOLERANCES = 4000  # tried one after another, from 1e-6 to 1/2


@dataclass(frozen=True, eq=False)
class Weighted:
    """The trajectories of one task, all of them or a sample, with their weights.

    Attributes:
      log_weight: [N] nats.
      entered: [N, H] True where a trajectory enters a hypothesis.
      num: Z is the sum of the weights divided by this number: 1 for all trajectories, N for a
        sample.
      is_sample: whether a share below that of one effective trajectory tells that it is small, and
        no more.
    """

    log_weight: np.ndarray
    entered: np.ndarray
    num: int = 1
    is_sample: bool = False

    @property
    def log_partition(self) -> float:
        """Log Z_0, nats."""
        return log_sum(self.log_weight) - math.log(self.num)

    @property
    def effective(self) -> float:
        """(sum w)^2 / sum w^2."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return float(weight.sum() ** 2 / (weight**2).sum())

    def avoid_probability(self, together: Iterable[int]) -> float:
        """Return Z_C / Z_0 of a set of hypotheses."""
        enters = self.entered[:, list(together)].any(axis=1)
        return math.exp(log_sum(self.log_weight[~enters]) - log_sum(self.log_weight))

    def log_ratio(self, together: Iterable[int]) -> float:
        """Return log Z_C / Z_0, nats; -inf where nobody avoids the set."""
        enters = self.entered[:, list(together)].any(axis=1)
        share = log_sum(self.log_weight[~enters]) - log_sum(self.log_weight)
        return max(share, -math.log(self.effective)) if self.is_sample else min(share, 0.0)

    def log_ratio_in_turn(self, together: Iterable[int]) -> float:
        """Return log Z_C / Z_0 as the sum of log P(avoid c | avoid those before c), nats."""
        left, total = self, 0.0
        for c in together:
            if len(left.log_weight):
                total += left.log_ratio([c])
                stays = ~left.entered[:, c]
                left = replace(left, log_weight=left.log_weight[stays], entered=left.entered[stays])
        return total


@dataclass(frozen=True, eq=False)
class Answer:
    """What the demonstrations of a case say, given the trajectories of each task.

    Attributes:
      case: the problem.
      tasks: the trajectories.
      in_turn: whether constraints come into force one after another; with a sample, each ratio has
        the bound of the trajectories that are left.
    """

    case: Case
    tasks: list[Weighted]
    in_turn: bool = False

    @property
    def num_hypotheses(self) -> int:
        """H."""
        return len(self.case.layout.regions)

    @property
    def prior(self) -> np.ndarray:
        """[H + 1] P(no constraint) first."""
        return self.case.assumed.full_prior(self.num_hypotheses)

    @cached_property
    def log_ratio(self) -> np.ndarray:
        """[K, H] log Z_c / Z_0, nats."""
        each = range(self.num_hypotheses)
        return np.array([[task.log_ratio([c]) for c in each] for task in self.tasks])

    @cached_property
    def avoid_probability(self) -> np.ndarray:
        """[K, H] Z_c / Z_0."""
        each = range(self.num_hypotheses)
        return np.array([[task.avoid_probability([c]) for c in each] for task in self.tasks])

    @cached_property
    def counts(self) -> np.ndarray:
        """[K] demonstrations of each task; 1 each where there are none at all."""
        if not self.case.recordings:
            return np.ones(len(self.tasks), int)
        return np.bincount(self.case.task_of, minlength=len(self.tasks))

    @cached_property
    def impossible(self) -> np.ndarray:
        """[H] True where nobody can avoid a hypothesis in a task that counts."""
        used = (self.counts > 0)[:, None] & self.case.is_counted
        return np.any(np.isneginf(self.log_ratio) & used, axis=0)

    @cached_property
    def enters(self) -> np.ndarray:
        """[D, H] True where a demonstration enters a hypothesis that counts for its task."""
        return self.case.judged & self.case.is_counted[self.case.task_of]

    @cached_property
    def struck_out(self) -> np.ndarray:
        """[H] True where a hypothesis is ruled out."""
        if self.case.assumed.tolerance > 0.0:
            return self.impossible
        return np.logical_or(self.impossible, self.enters.any(axis=0))

    def counting(self, task: int, together: Iterable[int]) -> tuple[int, ...]:
        """Return those of a set of hypotheses that count for a task."""
        return tuple(c for c in together if self.case.is_counted[task, c])

    @cached_property
    def _shares(self) -> dict[tuple[int, tuple[int, ...]], float]:
        return {}

    def log_share(self, task: int, counted: tuple[int, ...]) -> float:
        """Return log Z_C / Z_0 of a task, nats."""
        key = task, counted
        if key not in self._shares:
            weighted = self.tasks[task]
            log_ratio = weighted.log_ratio_in_turn if self.in_turn else weighted.log_ratio
            self._shares[key] = log_ratio(counted) if counted else 0.0
        return self._shares[key]

    def log_likelihood_of(self, together: Iterable[int]) -> float:
        """Return log L(C), nats; -inf where nobody avoids C in a task of a demonstration."""
        eps, chosen, total = self.case.assumed.tolerance, list(together), 0.0
        counted = [self.counting(k, chosen) for k in range(len(self.tasks))]
        for k in set(self.case.task_of.tolist()):
            if self.log_share(k, counted[k]) == -math.inf:
                return -math.inf
        for d, k in enumerate(self.case.task_of.tolist()):
            ratio = 0.0
            if not self.enters[d, list(counted[k])].any():
                ratio = math.exp(-self.log_share(k, counted[k]))
            likelihood = eps + (1.0 - eps) * ratio
            total += math.log(likelihood) if likelihood > 0.0 else -math.inf
        return total

    @cached_property
    def log_likelihood(self) -> np.ndarray:
        """[H] nats; -inf where struck out."""
        if not self.case.recordings:
            eps = self.case.assumed.tolerance
            with np.errstate(divide="ignore"):
                terms = np.log(eps + (1.0 - eps) / np.exp(self.log_ratio))
            value = np.where(self.case.is_counted, terms, 0.0).sum(axis=0)
        else:
            each = range(self.num_hypotheses)
            value = np.array([self.log_likelihood_of([c]) for c in each])
        return np.where(self.struck_out, -np.inf, value)

    @cached_property
    def score(self) -> np.ndarray:
        """[H] what hypotheses are ranked by; -inf where struck out."""
        if self.case.assumed.score == "likelihood":
            return self.log_likelihood
        return np.where(self.struck_out, -np.inf, self.average_violation)

    @property
    def average_violation(self) -> np.ndarray:
        """[H] violation probability averaged over the demonstrations that count."""
        num = self.counts[:, None] * self.case.is_counted
        total = (num * (1.0 - self.avoid_probability)).sum(axis=0)
        return total / np.maximum(num.sum(axis=0), 1)

    @cached_property
    def posterior(self) -> np.ndarray | None:
        """[H + 1] P(no constraint) first; None where everything that has a prior is ruled out."""
        if not self.case.recordings:
            return self.prior
        value = np.r_[0.0, self.log_likelihood]
        joint = self.prior * np.exp(value - value[self.prior > 0.0].max(initial=-700.0))
        return joint / joint.sum() if joint.sum() > 0.0 else None

    @property
    def log_bayes_factor(self) -> float:
        """Log-likelihood ratio of some hypothesis against none, nats."""
        if not self.case.recordings:
            return 0.0
        return _log_mean(self.log_likelihood, self.prior[1:])

    def gains(self, picked: list[int]) -> np.ndarray:
        """Return log L(C + c) - log L(C) [H], nats; -inf for what cannot be picked."""
        before = self.log_likelihood_of(picked)
        gain = np.full(self.num_hypotheses, -np.inf)
        allowed = self.prior[1:] > 0.0
        for c in np.flatnonzero(~self.struck_out & (allowed | ~allowed.any())).tolist():
            if c not in picked:
                gain[c] = self.log_likelihood_of([*picked, c]) - before
        return gain

    def log_odds(self, picked: list[int], odds: float | None) -> float:
        """Return the log posterior odds of one more constraint against no further one.

        Args:
          picked: the constraints in force.
          odds: prior odds; None for those of the prior.
        """
        prior = self.prior[1:].copy()
        prior[picked] = 0.0
        none = float(self.prior[0])
        with np.errstate(divide="ignore"):
            before = np.log(1.0 - none) - np.log(none) if odds is None else math.log(odds)
        return _log_mean(self.gains(picked), prior) + float(before)

    def least_tolerance(self) -> float | None:
        """Return the least tolerance for which a hypothesis beats no constraint; None without."""
        able = np.flatnonzero(~self.impossible & (self.prior[1:] > 0.0))
        left = able[~self.struck_out[able]]
        with np.errstate(divide="ignore", invalid="ignore"):
            odds = np.log(self.prior[1:]) - np.log(self.prior[0])
        if (self.log_likelihood[left] + odds[left] > 0.0).any():
            return None
        eps = np.exp(np.linspace(math.log(1e-6), math.log(0.5), TOLERANCES))
        beats, task_of = np.zeros(TOLERANCES, bool), self.case.task_of
        for c in able.tolist():
            ratio = np.where(self.enters[:, c], 0.0, np.exp(-self.log_ratio[task_of, c]))
            ratio = np.where(self.case.is_counted[task_of, c], ratio, 1.0)
            value = np.log(eps[:, None] + (1.0 - eps[:, None]) * ratio).sum(axis=1)
            beats |= value + odds[c] > 0.0
        return float(eps[beats.argmax()]) if beats.any() else None


def _log_mean(values: np.ndarray, weights: np.ndarray) -> float:
    """Return log of the weighted mean of exp(values); -inf for no weight."""
    used = weights > 0.0
    if not used.any():
        return -math.inf
    return log_sum(values[used] + np.log(weights[used])) - math.log(weights.sum())


def answer(case: Case) -> Answer:
    """Return the exact answer of a case."""
    pairs = zip(case.log_weights, case.entered, strict=True)
    return Answer(case, [Weighted(*pair) for pair in pairs])


def with_recordings(case: Case, rows: list[int]) -> Case:
    """Return a case with some of its demonstrations."""
    return replace(
        case,
        recordings=tuple(case.recordings[row] for row in rows),
        judged=case.judged[rows],
    )
