"""Ways to infer, each asked of the same demonstrations."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.inference.ranking import Inference, infer
from swerve.reproduce.keeping import Keeping
from swerve.reproduce.ranks import Curve, curve, judged, noise_of
from swerve.solvers.exact.tabular import TableNominal
from swerve.work.settings import Settings
from swerve.work.work import Work

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
      learn_seconds: wall time before any demonstration.
      task_seconds: wall time for the task of each demonstration, on average.
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
    """Return what one way says of several sets of demonstrations.

    Args:
      keeping: where the folder of the model is.
      place: name of that folder, by which times are called too.
      model: the problem, as the command line names it.
      way: to infer.
      num_trajectories: of each task.
      sources: the sets.
    """
    asked = way.settings(num_trajectories, keeping.seed)
    work = Work(model, keeping.folder / place, asked, progress=keeping.progress)
    clock, label = keeping.clock, f"{place.replace('_', ' ')}: {way.label}"
    learn = f"{label}, learn"
    with clock.timing(learn):
        nominal = work.nominal()
    found = []
    for source in sources:
        moved = source.demonstrations
        if isinstance(nominal, TableNominal):  # to the centres of its cells, as its authors do
            moved = [nominal.snapped(one) for one in moved]
        draw = f"{label}, sample {source.name}"
        tasks = Task.stack([one.task for one in moved])
        with clock.timing(draw, _mark(tasks)):
            evidence = work.evidence(tasks)
        result = infer(evidence, moved, score=way.score)
        said = judged(result, noise_of(num_trajectories))
        drawn = curve(said, source.truth, sizes_of(len(moved)), seed=keeping.seed)
        seconds = clock.seconds[learn], clock.seconds[draw] / len(moved)
        found.append(Answer(source.name, model, way, drawn, result, *seconds))
    return found


def sizes_of(num: int) -> list[int]:
    """Return the numbers of demonstrations to ask of, out of so many."""
    return [size for size in SIZES if size <= num]


def best_tables(answers: list[Answer]) -> list[Answer]:
    """Return answers with, of several tables for the same, the one of the least average rank."""
    best: dict[tuple[Any, ...], Answer] = {}
    for answer in answers:
        key = (answer.source, answer.model, answer.way.name)
        if key not in best or _average(answer) < _average(best[key]):
            best[key] = answer
    return list(best.values())


def answers_of(answers: Sequence[Answer], source: str, model: str) -> list[Answer]:
    """Return the answers about some demonstrations by one model."""
    return [one for one in answers if one.source == source and one.model == model]


def _mark(tasks: Task) -> str:
    """Return what tells tasks from others."""
    return f"{zlib.crc32(tasks.start.tobytes() + tasks.goal.tobytes()):08x}"


def _average(answer: Answer) -> float:
    return float(answer.curve.rank.mean())
