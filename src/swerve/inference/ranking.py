"""Which constraint do demonstrations obey: the ranking of hypotheses.

Demonstrations that all avoid c have, against no constraint at all, the log-likelihood ratio

    log L(c) = - sum_i log(Z_c / Z_0)(task_i) >= 0 nats;

one that enters c rules it out, unless demonstrations may ignore it now and then (see `likelihood`).
The most likely constraint is the one that no demonstration enters although the nominal distribution
would have entered it most often.

Shapes: D demonstrations, K tasks, H hypotheses.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swerve.base.arguments import instance
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import HypothesisSet
from swerve.inference import likelihood, posterior
from swerve.inference.judging import judge
from swerve.inference.posterior import CredibleSet, Posterior, Prior

if TYPE_CHECKING:
    from swerve.inference.greedy import Pick

SCORES = ("likelihood", "average")
TIE_ERRORS = 2.0  # standard errors within which two scores cannot be told apart
ROUNDING = 9  # digits of a score, beyond which two are the same
FEW_AVOID = 0.5  # nats: standard error of a ratio that less than four trajectories tell of
SETTLED = 0.09  # nats: standard error of a ratio worked out with a constraint in force
TABLE_ROWS = 10


@dataclass(frozen=True, eq=False)
class Inference:
    """A ranking of hypotheses.

    Attributes:
      evidence: what it rests on.
      demonstrations: the D demonstrations.
      task_of: [D] index of each demonstration's task in the evidence.
      entered: [D, H] True where a demonstration enters a hypothesis.
      score_name: "likelihood" or "average".
      is_counted: [K, H] False where a task says nothing of a hypothesis, too near its ends.
      tolerance: eps, the probability that a demonstration ignores the constraint.
      prior: [H + 1] probabilities before the demonstrations, that of no constraint first.
      judged: what demonstrations are held against: the hypotheses, less a margin for noise.
    """

    evidence: Evidence
    demonstrations: tuple[Demonstration, ...]
    task_of: np.ndarray
    entered: np.ndarray
    score_name: str
    is_counted: np.ndarray
    tolerance: float
    prior: np.ndarray
    judged: HypothesisSet

    def __repr__(self) -> str:
        """Return the answer in one line."""
        return f"<Inference: {self.headline}>"

    @cached_property
    def task_counts(self) -> np.ndarray:
        """[K] demonstrations of each task; all 1 where there are none (the prior ranking)."""
        if not self.demonstrations:
            return np.ones(self.evidence.num_tasks, int)
        return np.bincount(self.task_of, minlength=self.evidence.num_tasks)

    @cached_property
    def counts(self) -> likelihood.Counts:
        """[K, H] demonstrations that avoid a hypothesis and that enter it, where they count."""
        entering = np.zeros(self.is_counted.shape)
        np.add.at(entering, self.task_of, self.entered.astype(float))
        avoiding = self.task_counts[:, None] - entering
        return likelihood.Counts(avoiding * self.is_counted, entering * self.is_counted)

    @cached_property
    def is_used(self) -> np.ndarray:
        """[K, H] True where demonstrations of a task count for or against a hypothesis."""
        return (self.task_counts[:, None] > 0) & self.is_counted

    @cached_property
    def impossible(self) -> np.ndarray:
        """[H] True where exact evidence says that nobody who has one of the tasks can avoid it."""
        if not self.evidence.is_exact:
            return np.zeros(len(self.prior) - 1, bool)
        return np.asarray((np.isneginf(self.evidence.log_ratio) & self.is_used).any(axis=0))

    @cached_property
    def struck_out(self) -> np.ndarray:
        """[H] True where a demonstration enters the hypothesis, or nobody can avoid it.

        With a tolerance above 0 no demonstration rules anything out.
        """
        if self.tolerance > 0.0:
            return self.impossible
        return np.asarray((self.counts.entering > 0).any(axis=0)) | self.impossible

    @cached_property
    def log_likelihood(self) -> np.ndarray:
        """[H] log-likelihood ratio against no constraint [nats]; -inf where struck out."""
        value = likelihood.log_likelihood(self.finite_log_ratio, self.counts, self.tolerance)
        return np.where(self.struck_out, -np.inf, value)

    @cached_property
    def contributions(self) -> np.ndarray:
        """[D, H] what each demonstration adds to `log_likelihood` [nats]; -inf: rules out."""
        avoiding = likelihood.avoiding_term(self.finite_log_ratio, self.tolerance)[self.task_of]
        entering = math.log(self.tolerance) if self.tolerance > 0.0 else -np.inf
        added = np.where(self.entered, entering, avoiding)
        return np.where(self.is_counted[self.task_of], added, 0.0)

    @cached_property
    def finite_log_ratio(self) -> np.ndarray:
        """[K, H] log ratios, 0 where they are not used: there they may be infinite."""
        return np.where(self.is_used & ~self.impossible, self.evidence.log_ratio, 0.0)

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """[K, H] by how much `log_likelihood` falls as log Z_c / Z_0 of a task rises."""
        slope = likelihood.sensitivity(self.finite_log_ratio, self.tolerance)
        return np.where(self.struck_out, 0.0, self.counts.avoiding * slope)

    @cached_property
    def standard_error(self) -> np.ndarray:
        """[H] standard error of `log_likelihood` [nats]; tasks are sampled independently."""
        return np.sqrt((self.sensitivity**2 * self.evidence.standard_error**2).sum(axis=0))

    @cached_property
    def average_violation(self) -> np.ndarray:
        """[H] violation probability averaged over the demonstrations (the paper's score)."""
        num = self.task_counts[:, None] * self.is_counted
        return (num * self.evidence.violation_probability).sum(axis=0) / np.maximum(
            num.sum(axis=0), 1
        )

    @cached_property
    def is_lower_bound(self) -> np.ndarray:
        """[H] True where almost every nominal trajectory of a task enters: see `is_floored`."""
        floored = self.evidence.is_floored & self.is_used
        return np.asarray(floored.any(axis=0))

    @cached_property
    def is_open(self) -> np.ndarray:
        """[K, H] True where `resolve` can help: a ratio that matters is a bound, or few avoid.

        Not where that was tried, where a task starts inside a hypothesis, nor where log Z_0 itself
        is not well enough known: half of the error may be its.
        """
        evidence = self.evidence
        able = (self.task_counts > 0) & ~evidence.has_too_few
        able &= evidence.log_partition_error < SETTLED / math.sqrt(2.0)
        untried = np.isnan(evidence.summary.log_ratio_error)
        is_open = evidence.standard_error > FEW_AVOID
        is_open &= untried & able[:, None] & self.is_counted & ~self.struck_out
        for index in np.flatnonzero(is_open.any(axis=0)).tolist():
            constraint = evidence.problem.hypotheses.constraint(index)
            is_open[:, index] &= ~constraint.contains(evidence.tasks.start, evidence.problem.space)
        return is_open

    @property
    def score(self) -> np.ndarray:
        """[H] what the ranking is by; -inf where struck out."""
        if self.score_name == "likelihood":
            return self.log_likelihood
        return np.where(self.struck_out, -np.inf, self.average_violation)

    @cached_property
    def task_error(self) -> np.ndarray:
        """[K, H] what the demonstrations of each task add to the standard error of `score`."""
        if self.score_name == "likelihood":
            return self.sensitivity * self.evidence.standard_error
        num = self.task_counts[:, None] * self.is_counted
        share = num / np.maximum(num.sum(axis=0), 1)
        return np.asarray(share * np.sqrt(self.evidence.summary.avoid_variance))

    @cached_property
    def score_error(self) -> np.ndarray:
        """[H] standard error of `score`; tasks are sampled independently."""
        return np.linalg.norm(self.task_error, axis=0)

    @cached_property
    def ranking(self) -> np.ndarray:
        """Hypotheses that are left, best first; equal scores in order of index."""
        order = np.argsort(-self.score.round(ROUNDING), kind="stable")
        return order[: np.count_nonzero(~self.struck_out)]

    @cached_property
    def rank(self) -> np.ndarray:
        """Rank of each entry of `ranking`, from 1; ties share the rank of their first.

        Two are tied where their scores differ by at most twice the sum of their standard errors,
        which bounds the error of the difference however the samples are correlated, or by rounding.
        """
        score, error = self.score[self.ranking], self.score_error[self.ranking]
        rank = np.ones(len(score), int)
        first = 0
        for k in range(1, len(score)):
            rounding = 10.0**-ROUNDING * max(1.0, abs(score[first]))
            if score[first] - score[k] > TIE_ERRORS * (error[first] + error[k]) + rounding:
                first = k
            rank[k] = first + 1
        return rank

    @property
    def is_ruled_out(self) -> bool:
        """Whether everything that the prior allows is ruled out: there is no posterior then."""
        return not self.prior[0] and bool((self.struck_out | (self.prior[1:] == 0.0)).all())

    @cached_property
    def posterior(self) -> Posterior:
        """How probable no constraint and each hypothesis are, with their standard errors.

        Raises:
          ValueError: if everything that the prior allows is ruled out.
        """
        return posterior.of_inference(self)

    @property
    def log_bayes_factor(self) -> float:
        """Log-likelihood ratio of there being a constraint, whichever, against none [nats].

        0 without demonstrations.
        """
        if not self.demonstrations:
            return 0.0
        return posterior.log_bayes_factor(self.log_likelihood, self.prior)

    def credible_set(self, probability: float = 0.95) -> CredibleSet:
        """Return the fewest answers, no constraint among them or not, of at least a probability.

        Raises:
          ValueError: if it is not between 0 and 1.
        """
        return posterior.credible_set(self.posterior, probability)

    @cached_property
    def least_tolerance(self) -> float | None:
        """The least tolerance with which a hypothesis is more probable than no constraint, if any.

        None where one is already, or none would be up to the largest tolerance.
        """
        return posterior.least_tolerance(self)

    @property
    def leaders(self) -> np.ndarray:
        """The hypotheses that share the first rank."""
        return self.ranking[self.rank == 1]

    @property
    def headline(self) -> str:
        """The answer in a plain sentence."""
        from swerve.presentation import sentences as wording

        return wording.sentence(self)

    @property
    def belief(self) -> str:
        """The posterior in a plain sentence."""
        from swerve.presentation import sentences as wording

        return wording.belief(self)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against trusting the ranking, in plain words; empty if nothing does."""
        from swerve.trust import doubts as diagnosis

        return diagnosis.warnings(self)

    def verdict(self, task: int) -> str:
        """Return how far the samples of a task can be trusted, for example 'settled'."""
        from swerve.trust import verdicts as trust

        return trust.verdict(self, task)

    def verdicts(self) -> str:
        """Return how far the samples of all tasks can be trusted, in a few lines."""
        from swerve.trust import verdicts as trust

        return trust.summary(self)

    def task_name(self, task: int) -> str:
        """Return the names of the first demonstrations of a task, or its number."""
        from swerve.trust.verdicts import some_names

        names = self.demonstrations_of(task)
        return some_names(names) if names else f"task {task}"

    def demonstrations_of(self, task: int) -> list[str]:
        """Return the names of the demonstrations of a task."""
        pairs = zip(self.demonstrations, self.task_of, strict=True)
        return [demonstration.name for demonstration, k in pairs if k == task]

    def hypothesis_name(self, index: int) -> str:
        """Return what a hypothesis is called, for example 'theta [3.14, 3.77), omega [0, 1.2)'."""
        return self.evidence.problem.hypotheses.name(int(index))

    def table(self, num_rows: int = TABLE_ROWS) -> str:
        """Return the head of the ranking as text."""
        from swerve.presentation import text_tables as listing

        return listing.table(self, num_rows)

    def to_json(self) -> dict[str, Any]:
        """Return the ranking, the posterior and diagnostics of each task used, as JSON data."""
        from swerve.presentation import text_tables as listing

        return listing.to_json(self)

    def add(self, *demonstrations: Demonstration) -> Inference:
        """Return the inference from more finished demonstrations.

        Raises:
          ValueError: if one has no evidence for its task, or does not fit the problem.
        """
        if not demonstrations:
            return self
        task_of, entered = judge(demonstrations, self.evidence, self.judged)
        return dataclasses.replace(
            self,
            demonstrations=(*self.demonstrations, *demonstrations),
            task_of=np.concatenate([self.task_of, task_of]),
            entered=np.concatenate([self.entered, entered]),
        )

    def plot(self, path: str | Path | None = None) -> Any:
        """Draw the hypotheses shaded by score, nominal trajectories and demonstrations.

        Args:
          path: a file to write (its suffix tells the format), or None.

        Returns:
          The matplotlib Figure.
        """
        from swerve.presentation.plots import plot_inference

        return plot_inference(self, path)

    def report(self, path: str | Path, picks: Sequence[Pick] | None = None) -> None:
        """Write one self-contained HTML page with the picture, the table and the diagnostics.

        Args:
          path: the file.
          picks: what `swerve.greedy` picked, if that is to be reported as well.
        """
        from swerve.presentation.report import write_report

        write_report(self, path, picks)


def infer(
    evidence: Evidence,
    demonstrations: Sequence[Demonstration] = (),
    *,
    score: str = "likelihood",
    prior: Prior = None,
    tolerance: float = 0.0,
    margin: Mapping[str, float] | None = None,
    clearance: float | None = None,
) -> Inference:
    """Rank the hypotheses by how well they explain the demonstrations.

    Args:
      evidence: violation probabilities for the tasks of all demonstrations.
      demonstrations: finished ones; with none, the ranking is the prior one (Theorem 1: what the
        nominal distribution enters most often comes first) over all tasks of the evidence.
      score: "likelihood", or "average": the paper's average violation probability.
      prior: [H + 1] probabilities, that of no constraint first; or that of no constraint alone, the
        rest shared alike; 1/2 if None.
      tolerance: eps, the probability with which a demonstration ignores the constraint, so that one
        stray track does not veto the truth; 0 is the paper's.
      margin: for states measured with noise, how deep inside a hypothesis, in the state's unit, a
        demonstration must be to have entered it. Nominal trajectories are judged as they are, so
        what demonstrations graze seems more probable than it is: as small as the noise, then. A
        hypothesis that an end of a task grazes, lying in it but not as deep, is left out for it.
      clearance: leave a hypothesis out for tasks that start or end within this distance of it, in
        the units of the states that it names: nobody enters it there, constraint or not. Goals
        count where they are states.

    Returns:
      The ranking and the posterior.

    Raises:
      ValueError: if an argument is of the wrong kind or out of range, a demonstration has no
        evidence for its task, or it does not fit the problem.
    """
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    if score not in SCORES:
        raise ValueError(f"score: expected one of {', '.join(SCORES)}, got {score!r}")
    problem, hypotheses = evidence.problem, evidence.problem.hypotheses
    judged = hypotheses if margin is None else hypotheses.eroded(margin, problem.space)
    empty = Inference(
        evidence,
        demonstrations=(),
        task_of=np.zeros(0, int),
        entered=np.zeros((0, len(hypotheses)), bool),
        score_name=score,
        is_counted=likelihood.is_counted(problem, evidence.tasks, clearance, judged),
        tolerance=likelihood.checked_tolerance(tolerance),
        prior=posterior.checked_prior(prior, len(hypotheses)),
        judged=judged,
    )
    if isinstance(demonstrations, Demonstration):
        raise ValueError(f"expected a list of demonstrations, got {demonstrations.name} alone")
    return empty.add(*demonstrations)
