"""Ways to infer, each asked of the same demonstrations.

Shapes: D demonstrations, H hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from swerve.demonstrations import Demonstration
from swerve.inference import Inference, infer
from swerve.reproduce.clock import Clock
from swerve.reproduce.ranks import Curve, curve, judged
from swerve.settings import Settings
from swerve.solvers.tabular import TableNominal
from swerve.space import Task
from swerve.work import Work

SIZES = (1, 2, 3, 5, 8, 10, 15, 20, 30, 40, 50, 65)
SOFT_VALUE, GRID, PPO, DISCRETE = "soft value + SMC", "grid", "PPO", "MLCI-Discrete"


class Way(NamedTuple):
    """A way to infer.

    Attributes:
      name: what it is called.
      solver: as the command line names it.
      method: of sampling.
      score: of several demonstrations.
    """

    name: str
    solver: str
    method: str | None
    score: str = "likelihood"

    @property
    def label(self) -> str:
        """What its times are called: of tables there are several."""
        return self.solver if self.name == DISCRETE else self.name

    def settings(self, num_trajectories: int, seed: int) -> Settings:
        """Return how to learn and sample; of exact answers there are no trajectories."""
        num = None if self.method is None else num_trajectories
        return Settings(self.solver, seed, self.method, num)


class Source(NamedTuple):
    """Demonstrations.

    Attributes:
      name: what they are called.
      demonstrations: of whoever avoids the truth.
      truth: index of a hypothesis.
    """

    name: str
    demonstrations: list[Demonstration]
    truth: int


class Answer(NamedTuple):
    """What one way says of one set of demonstrations.

    Attributes:
      source: the name of the demonstrations.
      model: the problem, as the command line names it.
      way: to infer.
      curve: rank of the truth.
      result: of all demonstrations together.
      violation: [D, H] probability of entering each cell in the task of each.
    """

    source: str
    model: str
    way: Way
    curve: Curve
    result: Inference
    violation: np.ndarray


def infer_from(
    work: Work, way: Way, label: str, sources: Sequence[Source], clock: Clock, seed: int
) -> list[Answer]:
    """Return what one way says of several sets of demonstrations.

    Args:
      work: the model, with the settings of the way.
      way: to infer.
      label: what its times are called.
      sources: the sets.
      clock: of what takes long.
      seed: of subsets.
    """
    with clock.timing(f"{label}, learn"):
        nominal = work.nominal()
    found = []
    for source in sources:
        moved = source.demonstrations
        if isinstance(nominal, TableNominal):  # to the centres of its cells, as its authors do
            moved = [nominal.snapped(one) for one in moved]
        with clock.timing(f"{label}, sample {source.name}"):
            evidence = work.evidence(Task.stack([one.task for one in moved]))
        result = infer(evidence, moved, score=way.score)
        sizes = [size for size in SIZES if size <= len(moved)]
        drawn = curve(judged(result), source.truth, sizes, seed=seed)
        violation = evidence.violation_probability[result.task_of]
        found.append(Answer(source.name, work.problem_text, way, drawn, result, violation))
    return found


def best_tables(answers: list[Answer]) -> list[Answer]:
    """Return answers with, of several tables for the same, the one of the least average rank."""
    best: dict[tuple[Any, ...], Answer] = {}
    for answer in answers:
        key = (answer.source, answer.model, answer.way.name)
        if key not in best or _average(answer) < _average(best[key]):
            best[key] = answer
    return list(best.values())


def answers_of(
    answers: Sequence[Answer], source: str, model: str, way: str | None = None
) -> list[Answer]:
    """Return the answers about some demonstrations by one model, in one way or all."""
    return [
        one
        for one in answers
        if one.source == source and one.model == model and way in (None, one.way.name)
    ]


def _average(answer: Answer) -> float:
    return float(answer.curve.rank.mean())
