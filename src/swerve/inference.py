"""Which constraint do demonstrations obey: the ranking of hypotheses.

Demonstrations that all avoid c have, against no constraint at all, the log-likelihood ratio

    log L(c) = - sum_i log(Z_c / Z_0)(task_i) >= 0 nats;

one that enters c rules it out. The most likely constraint is the one that no demonstration enters
although the nominal distribution would have entered it most often.

Shapes: D demonstrations, K tasks, H hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swerve.arguments import instance
from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence
from swerve.hypotheses import unpack
from swerve.judging import judge

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
    """

    evidence: Evidence
    demonstrations: tuple[Demonstration, ...]
    task_of: np.ndarray
    entered: np.ndarray
    score_name: str

    @cached_property
    def task_counts(self) -> np.ndarray:
        """[K] demonstrations of each task; all 1 where there are none (the prior ranking)."""
        if not self.demonstrations:
            return np.ones(self.evidence.num_tasks, int)
        return np.bincount(self.task_of, minlength=self.evidence.num_tasks)

    @cached_property
    def impossible(self) -> np.ndarray:
        """[H] True where exact evidence says that nobody who has one of the tasks can avoid it."""
        log_ratio = self.evidence.summary.log_ratio[self.task_counts > 0]
        return np.asarray(self.evidence.is_exact & np.isneginf(log_ratio).any(axis=0))

    @cached_property
    def struck_out(self) -> np.ndarray:
        """[H] True where a demonstration enters the hypothesis, or nobody can avoid it."""
        return np.asarray(self.entered.any(axis=0)) | self.impossible

    @cached_property
    def log_likelihood(self) -> np.ndarray:
        """[H] log-likelihood ratio against no constraint [nats]; -inf where struck out."""
        value = -self.task_counts @ np.where(self.impossible, 0.0, self._finite_log_ratio)
        return np.where(self.struck_out, -np.inf, value)

    @property
    def _finite_log_ratio(self) -> np.ndarray:
        """[K, H] log ratios, 0 for tasks that are not used: theirs may be infinite."""
        return np.where(self.task_counts[:, None] > 0, self.evidence.log_ratio, 0.0)

    @cached_property
    def standard_error(self) -> np.ndarray:
        """[H] standard error of `log_likelihood` [nats]; tasks are sampled independently."""
        return np.sqrt(self.task_counts**2 @ self.evidence.standard_error**2)

    @cached_property
    def average_violation(self) -> np.ndarray:
        """[H] violation probability averaged over the demonstrations (the paper's score)."""
        return self.task_counts @ self.evidence.violation_probability / self.task_counts.sum()

    @cached_property
    def is_lower_bound(self) -> np.ndarray:
        """[H] True where almost every nominal trajectory of a task enters: see `is_floored`."""
        floored = self.evidence.is_floored & (self.task_counts > 0)[:, None]
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
        is_open &= untried & able[:, None] & ~self.struck_out
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
            return self.task_counts[:, None] * self.evidence.standard_error
        share = self.task_counts[:, None] / self.task_counts.sum()
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
    def leaders(self) -> np.ndarray:
        """The hypotheses that share the first rank."""
        return self.ranking[self.rank == 1]

    @property
    def headline(self) -> str:
        """The answer in a plain sentence."""
        from swerve import wording

        return wording.sentence(self)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against trusting the ranking, in plain words; empty if nothing does."""
        from swerve import diagnosis

        return diagnosis.warnings(self)

    def verdict(self, task: int) -> str:
        """Return how far the samples of a task can be trusted, for example 'settled'."""
        from swerve import trust

        return trust.verdict(self, task)

    def verdicts(self) -> str:
        """Return how far the samples of all tasks can be trusted, in a few lines."""
        from swerve import trust

        return trust.summary(self)

    def task_name(self, task: int) -> str:
        """Return the names of the first demonstrations of a task, or its number."""
        from swerve.trust import some_names

        names = self._demonstrations_of(task)
        return some_names(names) if names else f"task {task}"

    def _demonstrations_of(self, task: int) -> list[str]:
        pairs = zip(self.demonstrations, self.task_of, strict=True)
        return [demonstration.name for demonstration, k in pairs if k == task]

    def hypothesis_name(self, index: int) -> str:
        """Return what a hypothesis is called, for example 'theta [3.14, 3.77), omega [0, 1.2)'."""
        return self.evidence.problem.hypotheses.name(int(index))

    def table(self, num_rows: int = TABLE_ROWS) -> str:
        """Return the head of the ranking as text."""
        lines = [f"{'rank':>5} {'index':>6}  {'nats':>8} {'+-':>6}  {'violated':>8}  hypothesis"]
        for index, rank in list(zip(self.ranking, self.rank, strict=True))[:num_rows]:
            tied = "=" if np.count_nonzero(self.rank == rank) > 1 else " "
            least = "≥" if self.is_lower_bound[index] else " "
            lines.append(
                f"{rank:>4}{tied} {index:>6} {least}{self.log_likelihood[index]:>8.2f} "
                f"{self.standard_error[index]:>6.2f}  {self.average_violation[index]:>8.3f}  "
                f"{self.hypothesis_name(index)}"
            )
        if len(self.ranking) > num_rows:
            lines.append(f"      ... {len(self.ranking) - num_rows} more")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return the ranking, best first, and diagnostics of each task used, as JSON data."""
        tasks = self.task_of if self.demonstrations else range(self.evidence.num_tasks)
        return {
            "headline": self.headline,
            "problem": self.evidence.problem.summary,
            "score": self.score_name,
            "num_demonstrations": len(self.demonstrations),
            "ranking": [
                {
                    "index": int(index),
                    "name": self.hypothesis_name(index),
                    "log_likelihood": float(self.log_likelihood[index]),
                    "standard_error": float(self.standard_error[index]),
                    "is_lower_bound": bool(self.is_lower_bound[index]),
                    "average_violation": float(self.average_violation[index]),
                    "rank": int(rank),
                }
                for index, rank in zip(self.ranking, self.rank, strict=True)
            ],
            "struck_out": [
                {
                    "index": index,
                    "name": self.hypothesis_name(index),
                    "impossible": bool(self.impossible[index]),
                    "entered_by": [
                        self.demonstrations[d].name for d in np.flatnonzero(self.entered[:, index])
                    ],
                }
                for index in np.flatnonzero(self.struck_out).tolist()
            ],
            "warnings": list(self.warnings),
            "diagnostics": [self._task_diagnostics(int(k)) for k in dict.fromkeys(tasks)],
        }

    def _task_diagnostics(self, task: int) -> dict[str, Any]:
        evidence = self.evidence
        return {
            "task": int(task),
            "demonstrations": self._demonstrations_of(task),
            "start": evidence.tasks.start[task].tolist(),
            "goal": evidence.tasks.goal[task].tolist(),
            "solver": evidence.solver,
            "method": evidence.method,
            "num_trajectories": evidence.num_trajectories,
            "effective_sample_size": float(evidence.effective_sample_size[task]),
            "log_partition": float(evidence.log_partition[task]),
            "kl": float(evidence.kl[task]),
            "island_spread": float(evidence.island_spread[task]),
            "distinct_share": float(evidence.distinct_share[task]),
            "verdict": self.verdict(task),
        }

    def plot(self, path: str | Path | None = None) -> Any:
        """Draw the hypotheses shaded by score, nominal trajectories and demonstrations.

        Args:
          path: a file to write (its suffix tells the format), or None.

        Returns:
          The matplotlib Figure.
        """
        from swerve.plots import plot_inference

        return plot_inference(self, path)

    def report(self, path: str | Path) -> None:
        """Write one self-contained HTML page with the picture, the table and the diagnostics."""
        from swerve.report import write_report

        write_report(self, path)


def infer(
    evidence: Evidence,
    demonstrations: Sequence[Demonstration] = (),
    *,
    score: str = "likelihood",
) -> Inference:
    """Rank the hypotheses by how well they explain the demonstrations.

    Args:
      evidence: violation probabilities for the tasks of all demonstrations.
      demonstrations: finished ones; with none, the ranking is the prior one (Theorem 1: what the
        nominal distribution enters most often comes first) over all tasks of the evidence.
      score: "likelihood", or "average": the paper's average violation probability.

    Returns:
      The ranking.

    Raises:
      ValueError: if an argument is of the wrong kind, a demonstration has no evidence for its task,
        or it does not fit the problem.
    """
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    if score not in SCORES:
        raise ValueError(f"score: expected one of {', '.join(SCORES)}, got {score!r}")
    if isinstance(demonstrations, Demonstration):
        raise ValueError(f"expected a list of demonstrations, got {demonstrations.name} alone")
    demonstrations = tuple(demonstrations)
    judged = [judge(item, evidence) for item in demonstrations]
    num_hypotheses = len(evidence.problem.hypotheses)
    entered = np.zeros((0, num_hypotheses), bool)
    if judged:
        entered = unpack(np.stack([bits for _, bits in judged]), num_hypotheses)
    task_of = np.array([task for task, _ in judged], int)
    return Inference(evidence, demonstrations, task_of, entered, score)
