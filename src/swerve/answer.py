"""Infer which constraint demonstrations obey, and report the answer.

An `Inference` is a ranking (numbers, see `inference.ranking`) that can say, list, draw and report
itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.inference.posterior import Prior
from swerve.inference.ranking import Ranking

if TYPE_CHECKING:
    from swerve.inference.greedy import Pick

TABLE_ROWS = 10  # hypotheses in a table, by default


@dataclass(frozen=True, eq=False, repr=False)
class Inference(Ranking):
    """A ranking of hypotheses that can say, list, draw and report itself.

    Attributes:
      evidence: violation probabilities of the hypotheses, task by task.
      demonstrations: the D demonstrations.
      task_of: [D] index of each demonstration's task in the evidence.
      entered: [D, H] True where a demonstration enters a hypothesis.
      score_name: "likelihood" or "average".
      is_counted: [K, H] False where a task tells nothing about a hypothesis near its start or goal.
      tolerance: eps, the probability that a demonstration ignores the constraint.
      prior: [H + 1] probabilities before the demonstrations, P(no constraint) first.
      judged: regions that demonstrations must not enter: the hypotheses, less a margin for noise.
    """

    def __repr__(self) -> str:
        """Return the answer in one line."""
        return f"<Inference: {self.headline}>"

    @property
    def headline(self) -> str:
        """The answer in a plain sentence."""
        from swerve.presentation import sentences

        return sentences.sentence(self)

    @property
    def belief(self) -> str:
        """The posterior in a plain sentence."""
        from swerve.presentation import sentences

        return sentences.belief(self)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Reasons not to trust the ranking, in plain words; empty if there are none."""
        from swerve.trust import doubts

        return doubts.warnings(self)

    def verdict(self, task: int) -> str:
        """Return how far the samples of a task can be trusted, for example 'settled'."""
        from swerve.trust import verdicts

        return verdicts.verdict(self, task)

    def verdicts(self) -> str:
        """Return how far the samples of all tasks can be trusted, in a few lines."""
        from swerve.trust import verdicts

        return verdicts.summary(self)

    def table(self, num_rows: int = TABLE_ROWS) -> str:
        """Return the head of the ranking as text."""
        from swerve.presentation import text_tables

        return text_tables.table(self, num_rows)

    def to_json(self) -> dict[str, Any]:
        """Return the ranking, the posterior and diagnostics of each task used, as JSON data."""
        from swerve.presentation import text_tables

        return text_tables.to_json(self, self.warnings)

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
          picks: picks of `swerve.greedy`, to be reported as well; None for no picks.
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
      demonstrations: finished demonstrations. Without any, the result is the prior ranking over all
        tasks of the evidence (Theorem 1: the hypothesis that the nominal distribution enters most
        often comes first).
      score: "likelihood", or "average": the paper's average violation probability.
      prior: [H + 1] probabilities, P(no constraint) first; or P(no constraint) alone, and the
        hypotheses share the rest equally; P(no constraint) = 1/2 if None.
      tolerance: eps, the probability with which a demonstration ignores the constraint, so that one
        stray demonstration does not rule out the true constraint; 0 as in the paper.
      margin: for states measured with noise, how deep inside a hypothesis, in the state's unit, a
        demonstration must be to have entered the hypothesis. Nominal trajectories are judged
        without a margin, so a hypothesis that demonstrations graze seems more probable than it is:
        choose a margin as small as the noise. Where an end of a task lies in a hypothesis, but less
        deep than the margin, the hypothesis is left out for the task.
      clearance: leave a hypothesis out for tasks that start or end within this distance of the
        hypothesis, in the units of the states that it names: demonstrations of these tasks avoid
        the hypothesis with or without a constraint. Goals count where they are states.

    Returns:
      The ranking and the posterior.

    Raises:
      ValueError: if an argument is of the wrong kind or out of range, a demonstration has no
        evidence for its task, or a demonstration does not fit the problem.
    """
    return Inference.of(
        evidence,
        demonstrations,
        score=score,
        prior=prior,
        tolerance=tolerance,
        margin=margin,
        clearance=clearance,
    )
