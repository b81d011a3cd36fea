"""Ways to infer, each applied to the same demonstrations."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from swerve.answer import Inference, infer
from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.reproduce.keeping import Keeping
from swerve.reproduce.ranks import Curve, curve, judged, noise_of
from swerve.solvers.exact.tabular import TableNominal
from swerve.work.settings import Settings
from swerve.work.work import Work

# numbers of demonstrations in a curve
SIZES = (1, 2, 3, 5, 8, 10, 15, 20, 30, 40, 50, 65)
SOFT_VALUE, GRID, PPO, DISCRETE = "soft value + SMC", "grid", "PPO", "MLCI-Discrete"


class Way(NamedTuple):
    """A way to infer.

    Attributes:
      name: name of the way in figures and tables.
      solver: solver, as the command line names it.
      method: method of sampling; None for exact answers.
      score: score of several demonstrations, "likelihood" or the paper's "average".
    """

    name: str
    solver: str
    method: str | None
    score: str = "likelihood"

    @property
    def label(self) -> str:
        """Name of the way in tables of times; the solver for MLCI-Discrete, which has several."""
        return self.solver if self.name == DISCRETE else self.name

    def settings(self, num_trajectories: int, seed: int) -> Settings:
        """Return the settings to learn and sample with; exact answers need no trajectories."""
        num = None if self.method is None else num_trajectories
        return Settings(self.solver, seed, self.method, num)


class Source(NamedTuple):
    """A set of demonstrations that avoid one hypothesis.

    Attributes:
      name: name of the set.
      demonstrations: the demonstrations.
      truth: index of the hypothesis.
    """

    name: str
    demonstrations: list[Demonstration]
    truth: int


class Answer(NamedTuple):
    """Answer of one way for one set of demonstrations.

    Attributes:
      source: name of the set.
      model: the problem, as the command line names it.
      way: the way to infer.
      curve: rank of the truth against the number of demonstrations.
      result: inference from all demonstrations together.
      learn_seconds: wall time of learning.
      task_seconds: mean wall time of sampling for the task of one demonstration.
    """

    source: str
    model: str
    way: Way
    curve: Curve
    result: Inference
    learn_seconds: float
    task_seconds: float


def infer_from(
    keeping: Keeping,
    place: str,
    model: str,
    way: Way,
    num_trajectories: int,
    sources: Sequence[Source],
) -> list[Answer]:
    """Return the answers of one way for several sets of demonstrations.

    Args:
      keeping: parent folder and settings.
      place: name of the folder of the model; also the first part of names of times.
      model: the problem, as the command line names it.
      way: the way to infer.
      num_trajectories: number of trajectories of each task.
      sources: the sets.
    """
    settings = way.settings(num_trajectories, keeping.seed)
    work = Work(model, keeping.folder / place, settings, progress=keeping.progress)
    clock, label = keeping.clock, f"{place.replace('_', ' ')}: {way.label}"
    learn = f"{label}, learn"
    with clock.timing(learn):
        nominal = work.nominal()
    found = []
    for source in sources:
        moved = source.demonstrations
        if isinstance(nominal, TableNominal):  # to the centres of cells, as the method's authors do
            moved = [nominal.snapped(one) for one in moved]
        timed = f"{label}, sample {source.name}"
        tasks = Task.stack([one.task for one in moved])
        with clock.timing(timed, _mark(tasks)):
            evidence = work.evidence(tasks)
        result = infer(evidence, moved, score=way.score)
        scores = judged(result, noise_of(num_trajectories))
        ranks = curve(scores, source.truth, sizes_of(len(moved)), seed=keeping.seed)
        seconds = clock.seconds[learn], clock.seconds[timed] / len(moved)
        found.append(Answer(source.name, model, way, ranks, result, *seconds))
    return found


def sizes_of(num: int) -> list[int]:
    """Return the numbers of demonstrations in a curve, out of `num`."""
    return [size for size in SIZES if size <= num]


def best_tables(answers: list[Answer]) -> list[Answer]:
    """Return the answers with the best table alone: the one of the least average rank."""
    best: dict[tuple[Any, ...], Answer] = {}
    for answer in answers:
        key = (answer.source, answer.model, answer.way.name)
        if key not in best or _average(answer) < _average(best[key]):
            best[key] = answer
    return list(best.values())


def answers_of(answers: Sequence[Answer], source: str, model: str) -> list[Answer]:
    """Return the answers for one set of demonstrations by one model."""
    return [one for one in answers if one.source == source and one.model == model]


def _mark(tasks: Task) -> str:
    """Return a mark that differs for other tasks."""
    return f"{zlib.crc32(tasks.start.tobytes() + tasks.goal.tobytes()):08x}"


def _average(answer: Answer) -> float:
    """Return the rank of the truth, averaged over the curve."""
    return float(answer.curve.rank.mean())
