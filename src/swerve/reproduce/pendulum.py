"""The rank of a pendulum's true constraint against the number of demonstrations (figures 2, 3).

Demonstrations are made by optimal control, with any torque, around C1 (cell 55, near where the
pendulum hangs) and C2 (cell 85, where it falls); those of a folder come beside them. Every way to
infer is asked of the same ones, by a model whose torques reach to 10 and to 1, entering judged at
the states alone, as the paper does:

    soft value + SMC    neural soft values, the paper's method as this project does it,
    grid                soft values on a grid, exact up to what sampling leaves open,
    PPO                 one policy for all tasks, plain samples, the paper's average score,
    MLCI-Discrete       tables of cells, the best of several by the rank of the truth.

All that takes long is kept in a folder, so that what was interrupted goes on.

Shapes: D demonstrations, H hypotheses.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swerve import store
from swerve.constraints import violates
from swerve.demonstrations import Demonstration, read_demonstrations, write_demonstrations
from swerve.demonstrators.optimal_control import optimal_control
from swerve.inference import Inference, infer
from swerve.reproduce.ranks import NOISE, Curve, Judged, curve, judged
from swerve.settings import Settings
from swerve.solvers.tabular import TableNominal
from swerve.space import Task
from swerve.systems.pendulum import pendulum
from swerve.tasks import draw_tasks
from swerve.work import Work

CONSTRAINTS = {"C1": 55, "C2": 85}
REAL = "real"  # name of the demonstrations of a folder
REAL_TRUTH = CONSTRAINTS["C1"]
SIZES = (1, 2, 3, 5, 8, 10, 15, 20, 30, 40, 50, 65)
LEAST_SURVIVAL = 1e-4  # one trajectory of 10,000
FOLLOWED = (55, 17, 87, 7)  # cells whose nats are told, the four of METHOD
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


class Scale(NamedTuple):
    """How much is done.

    Attributes:
      max_torques: of the models.
      num_demonstrations: made for each constraint.
      num_trajectories: of each task.
      ways: to infer.
    """

    max_torques: tuple[float, ...]
    num_demonstrations: int
    num_trajectories: int
    ways: tuple[Way, ...]


FULL = Scale(
    (10.0, 1.0),
    65,
    10_000,
    (
        Way(SOFT_VALUE, "distilled", "smc"),
        Way(GRID, "grid", "smc"),
        Way(PPO, "ppo", "plain", "average"),
        Way(DISCRETE, "discrete?num_cells=60&hold=6", None),
        Way(DISCRETE, "discrete?num_cells=120&hold=3", None),
        Way(DISCRETE, "discrete?num_cells=120&hold=6", None),
    ),
)
QUICK = Scale(
    (10.0,),
    8,
    2_000,
    (
        Way(SOFT_VALUE, "soft-value?num_steps=2000000", "smc"),
        Way(GRID, "grid?num_points=121", "smc"),
        Way(PPO, "ppo?num_steps=2000000", "plain", "average"),
        Way(DISCRETE, "discrete?num_cells=60&hold=6", None),
    ),
)


class Answer(NamedTuple):
    """What one way says of one set of demonstrations.

    Attributes:
      source: "C1", "C2" or "real".
      max_torque: of the model.
      way: to infer.
      curve: rank of the truth.
      result: of all demonstrations together.
      violation: [D, H] probability of entering each cell in the task of each.
    """

    source: str
    max_torque: float
    way: Way
    curve: Curve
    result: Inference
    violation: np.ndarray


class Exact(NamedTuple):
    """What a folder holds of exact answers.

    Attributes:
      max_torque: of the model.
      violation: [D, H] probability of entering each cell in the task of each demonstration.
      nats: [H] log-likelihood ratio of all demonstrations together, those that enter included.
      curve: rank of the truth.
    """

    max_torque: float
    violation: np.ndarray
    nats: np.ndarray
    curve: Curve


class Result(NamedTuple):
    """What was measured.

    Attributes:
      scale: how much was done.
      demonstrations: by source.
      answers: of every source, torque and way.
      exact: of the folder, where it has them.
      seconds: how long what took: "torque 10: soft value + SMC, learn" and so on.
    """

    scale: Scale
    demonstrations: dict[str, list[Demonstration]]
    answers: list[Answer]
    exact: list[Exact]
    seconds: dict[str, float]


def reproduce(
    folder: Path,
    data: Path | None = None,
    *,
    is_quick: bool = False,
    seed: int = 0,
    progress: bool = False,
) -> Result:
    """Make demonstrations, infer from them in every way, and rank.

    Args:
      folder: where all that takes long is kept, and found again.
      data: folder of demo_*.csv and tasks.csv of a pendulum that avoided cell 55, and perhaps
        exact_violation_torque10.csv; None for none.
      is_quick: whether to do little of it.
      seed: of everything random.
      progress: whether to show progress bars.

    Raises:
      ImportError: if CasADi is not installed.
      OSError: if a file is missing or cannot be written.
      ValueError: if a file cannot be understood, or the demonstrations enter cell 55.
    """
    scale = QUICK if is_quick else FULL
    folder = folder / ("quick" if is_quick else "full")
    clock = Clock(folder / "seconds.json")
    sets = {
        name: _made(folder / name, name, scale.num_demonstrations, seed, progress, clock)
        for name in CONSTRAINTS
    }
    if data is not None:
        sets[REAL] = _read(data, scale.num_demonstrations if is_quick else None)
        _check_real(sets[REAL])
    answers = []
    for max_torque in scale.max_torques:
        text = f"pendulum?between_states=false&max_torque={max_torque:g}"
        for way in scale.ways:
            settings = Settings(
                way.solver, seed, way.method, scale.num_trajectories if way.method else None
            )
            work = Work(text, folder / f"torque_{max_torque:g}", settings, progress=progress)
            answers += _answers(work, max_torque, way, sets, clock, seed)
    answers = _best_tables(answers)
    exact = [] if data is None else _exact(data, answers, seed)
    return Result(scale, sets, answers, exact, clock.seconds)


class Clock:
    """How long what took, also in parts; kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seconds: dict[str, float] = store.read_json(path) if path.exists() else {}

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add what the block takes to what is called so."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
            store.write_json(self._path, self.seconds)


def truth_of(source: str) -> int:
    """Return the index of the cell that demonstrations avoid."""
    return CONSTRAINTS.get(source, REAL_TRUTH)


def _made(
    folder: Path, name: str, num: int, seed: int, progress: bool, clock: Clock
) -> list[Demonstration]:
    """Return demonstrations by optimal control with any torque, made unless they are there."""
    problem = pendulum(between_states=False)
    if not folder.exists():
        cell = problem.hypotheses.constraint(CONSTRAINTS[name])
        tasks = draw_tasks(problem, num, avoid=[cell], seed=1_000 * seed + CONSTRAINTS[name])
        limits, labels = (-np.inf, np.inf), [f"demo_{k:03d}" for k in range(num)]
        with clock.timing(f"{name}: demonstrations"):
            optima = optimal_control(
                problem, cell, tasks, names=labels, limits=limits, seed=seed, progress=progress
            )
        partial = folder.with_name(f"{name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        made = [optimum.demonstration for optimum in optima]
        write_demonstrations(partial, made, problem.mdp.space, action_names=("torque",))
        partial.replace(folder)
    return _read(folder, None)


def _read(folder: Path, most: int | None) -> list[Demonstration]:
    files = sorted(folder.glob("demo_*.csv"))[:most]
    if not files:
        raise FileNotFoundError(f"{folder}: expected demo_*.csv and tasks.csv, found none")
    return read_demonstrations(files, pendulum().mdp.space, tasks=folder / "tasks.csv")


def _check_real(demonstrations: list[Demonstration]) -> None:
    """Raise ValueError where a demonstration enters the cell that it is to avoid."""
    problem = pendulum(between_states=False)
    cell = problem.hypotheses.constraint(REAL_TRUTH)
    for one in demonstrations:
        if violates(cell, one.states, problem.mdp.space, False):
            raise ValueError(
                f"{one.name} enters cell {REAL_TRUTH}, {cell.name}: expected demonstrations that "
                "avoid it"
            )


def _answers(
    work: Work,
    max_torque: float,
    way: Way,
    sets: dict[str, list[Demonstration]],
    clock: Clock,
    seed: int,
) -> list[Answer]:
    """Return what one way says of every set of demonstrations, by a model of one torque."""
    label = f"torque {max_torque:g}: {way.name}"
    with clock.timing(f"{label}, learn"):
        nominal = work.nominal()
    found = []
    for source, demonstrations in sets.items():
        moved = demonstrations
        if isinstance(nominal, TableNominal):  # to the centres of its cells, as its authors do
            moved = [nominal.snapped(one) for one in demonstrations]
        with clock.timing(f"{label}, sample {source}"):
            evidence = work.evidence(Task.stack([one.task for one in moved]))
        result = infer(evidence, moved, score=way.score)
        sizes = [size for size in SIZES if size <= len(moved)]
        drawn = curve(judged(result), truth_of(source), sizes, seed=seed)
        violation = evidence.violation_probability[result.task_of]
        found.append(Answer(source, max_torque, way, drawn, result, violation))
    return found


def _best_tables(answers: list[Answer]) -> list[Answer]:
    """Return answers with, of several tables for the same, the one of the least average rank."""
    best: dict[tuple[Any, ...], Answer] = {}
    for answer in answers:
        key = (answer.source, answer.max_torque, answer.way.name)
        if key not in best or _average(answer) < _average(best[key]):
            best[key] = answer
    return list(best.values())


def _average(answer: Answer) -> float:
    return float(answer.curve.rank.mean())


def _exact(data: Path, answers: list[Answer], seed: int) -> list[Exact]:
    """Return the exact probabilities that a folder holds, with the curve by them."""
    found = []
    for answer in answers:
        path = data / f"exact_violation_torque{answer.max_torque:g}.csv"
        if answer.source == REAL and answer.way.name == GRID and path.exists():
            violation = read_violation(path, list(answer.result.demonstrations))
            survival = np.maximum(1.0 - np.where(violation < NOISE, 0.0, violation), LEAST_SURVIVAL)
            said = Judged(-np.log(survival), answer.result.entered)
            drawn = curve(said, REAL_TRUTH, answer.curve.sizes, seed=seed)
            found.append(Exact(answer.max_torque, violation, said.score.sum(axis=0), drawn))
    return found


def read_violation(path: Path, demonstrations: list[Demonstration]) -> np.ndarray:
    """Return exact violation probabilities [D, H] in the order of the demonstrations."""
    with path.open() as file:
        rows = {row[0]: row[1:] for row in (line.strip().split(",") for line in file)}
    names = [demonstration.name.removeprefix("demo_") for demonstration in demonstrations]
    return np.array([rows[name] for name in names], float)
