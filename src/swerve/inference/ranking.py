"""Rank the hypotheses by how well each explains the demonstrations.

The most likely constraint is the hypothesis that no demonstration enters, although trajectories of
the nominal distribution enter it most often (see `scores`). A ranking holds numbers;
`swerve.answer` adds words, tables and pictures.

Shapes: D demonstrations, K tasks, H hypotheses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from swerve.base.arguments import instance
from swerve.base.phrases import some_names
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.inference import likelihood, posterior
from swerve.inference.judging import judge
from swerve.inference.posterior import CredibleSet, Posterior, Prior
from swerve.inference.scores import Scores

SCORES = ("likelihood", "average")
TIE_ERRORS = 2.0  # standard errors within which two scores cannot be told apart
ROUNDING = 9  # decimal digits: two scores that agree to these digits are equal


@dataclass(frozen=True, eq=False)
class Ranking(Scores):
    """The hypotheses in order of their score, and the posterior."""

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        demonstrations: Sequence[Demonstration] = (),
        *,
        score: str = "likelihood",
        prior: Prior = None,
        tolerance: float = 0.0,
        margin: Mapping[str, float] | None = None,
        clearance: float | None = None,
    ) -> Self:
        """Rank the hypotheses; the arguments and errors are those of `swerve.infer`."""
        remedy = "make some with swerve.sample or swerve.Evidence.load"
        instance(evidence, Evidence, "evidence", remedy)
        if score not in SCORES:
            raise ValueError(f"score: expected one of {', '.join(SCORES)}, got {score!r}")
        problem, hypotheses = evidence.problem, evidence.problem.hypotheses
        judged = hypotheses if margin is None else hypotheses.eroded(margin, problem.space)
        empty = cls(
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

    def add(self, *demonstrations: Demonstration) -> Self:
        """Return the ranking with these finished demonstrations added.

        Raises:
          ValueError: if a demonstration has no evidence for its task, or does not fit the problem.
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

    @cached_property
    def ranking(self) -> np.ndarray:
        """Hypotheses that are not struck out, best first; equal scores in order of index."""
        order = np.argsort(-self.score.round(ROUNDING), kind="stable")
        return order[: np.count_nonzero(~self.struck_out)]

    @cached_property
    def rank(self) -> np.ndarray:
        """Rank of each entry of `ranking`, from 1; tied entries share the rank of the first.

        Two hypotheses are tied where their scores differ by rounding alone, or by at most twice the
        sum of their standard errors. That sum bounds the error of the difference, however the
        samples are correlated.
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
    def leaders(self) -> np.ndarray:
        """The hypotheses that share the first rank."""
        return self.ranking[self.rank == 1]

    @property
    def is_ruled_out(self) -> bool:
        """Whether every answer that the prior allows is ruled out: then there is no posterior.

        Demonstrations alone rule out: before there are any, the posterior is the prior.
        """
        if self.prior[0] or not self.demonstrations:
            return False
        return bool((self.struck_out | (self.prior[1:] == 0.0)).all())

    @cached_property
    def posterior(self) -> Posterior:
        """The probabilities of no constraint and of each hypothesis, with standard errors.

        Raises:
          ValueError: if every answer that the prior allows is ruled out.
        """
        return posterior.of_scores(self)

    @property
    def log_bayes_factor(self) -> float:
        """Log-likelihood ratio of some constraint (any hypothesis) against no constraint [nats].

        The ratio is 0 without demonstrations.
        """
        if not self.demonstrations:
            return 0.0
        return posterior.log_bayes_factor(self.log_likelihood, self.prior)

    def credible_set(self, probability: float = 0.95) -> CredibleSet:
        """Return the fewest answers whose probabilities sum to at least a given probability.

        Raises:
          ValueError: if the probability is not between 0 and 1.
        """
        return posterior.credible_set(self.posterior, probability)

    @cached_property
    def least_tolerance(self) -> float | None:
        """The least tolerance for which a hypothesis is more probable than no constraint.

        None if a hypothesis is more probable already, or if none would be up to the largest
        tolerance.
        """
        return posterior.least_tolerance(self)

    def demonstrations_of(self, task: int) -> list[str]:
        """Return the names of the demonstrations of a task."""
        return list(self._names_of_task.get(task, ()))

    @cached_property
    def _names_of_task(self) -> dict[int, list[str]]:
        """The names of the demonstrations of each task that has any."""
        names: dict[int, list[str]] = {}
        for task, demonstration in zip(self.task_of.tolist(), self.demonstrations, strict=True):
            names.setdefault(task, []).append(demonstration.name)
        return names

    def task_name(self, task: int) -> str:
        """Return the names of a task's first demonstrations; the task's number if it has none."""
        names = self.demonstrations_of(task)
        return some_names(names) if names else f"task {task}"

    def hypothesis_name(self, index: int) -> str:
        """Return the name of a hypothesis, for example 'theta [3.14, 3.77), omega [0, 1.2)'."""
        return self.evidence.problem.hypotheses.name(int(index))


def check_ranking(value: Any) -> None:
    """Raise ValueError where an argument called `inference` is not what `swerve.infer` returns."""
    if not isinstance(value, Ranking):
        raise ValueError(
            f"inference: expected a swerve.Inference, got {value!r}: make one with swerve.infer"
        )
