"""Measure the rank of a pendulum's true constraint against the number of demonstrations.

This is the result of figures 2 and 3 of the paper. Demonstrations are made by optimal control, with
any torque, around C1 (cell 55, near where the pendulum hangs) and C2 (cell 85, where it falls);
demonstrations in a given folder are a third set. Every way infers from the same sets, with torques
of the model up to 10 and up to 1. Entering is judged at the states alone, as in the paper:

    soft value + SMC    neural soft values, the paper's method as this project does it, by a policy
                        distilled from them, or by looking ahead where torques reach only to 1,
    grid                soft values on a grid, exact but for sampling error,
    PPO                 one policy for all tasks, plain samples, the paper's average score,
    MLCI-Discrete       tables of cells, the best of several by the rank of the truth.

Slow results are kept in a folder, so that an interrupted run continues.

Shapes: D demonstrations, H hypotheses.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.constraints.base import violates
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.tables import file_content
from swerve.demonstrators.path_search import Search
from swerve.hypotheses.bits import unpack
from swerve.reproduce.keeping import Keeping
from swerve.reproduce.kept_demonstrations import kept_optima, read_folder
from swerve.reproduce.ranks import Curve, Judged, curve, noise_of
from swerve.reproduce.ways import (
    DISCRETE,
    GRID,
    PPO,
    SOFT_VALUE,
    Answer,
    Source,
    Way,
    best_tables,
    infer_from,
    sizes_of,
)
from swerve.systems.pendulum import pendulum

CONSTRAINTS = {"C1": 55, "C2": 85}
REAL = "real"  # name of the demonstrations in a folder
NUM_CELLS = 100  # hypotheses
REAL_TRUTH = CONSTRAINTS["C1"]
SETTINGS = Search(limits=(-np.inf, np.inf), goal_tolerance=0.05)  # rad and rad/s, Euclidean
LEAST_SURVIVAL = 1e-4  # least probability of avoiding a cell: one trajectory of 10,000
FOLLOWED = (55, 17, 87, 7)  # cells in the table of nats: the truth and three that rank next to it


class Scale(NamedTuple):
    """Amount of work of a run.

    Attributes:
      ways: the ways to infer, by the model's largest torque.
      num_demonstrations: number of demonstrations to make for each constraint.
      num_trajectories: number of trajectories of each task.
    """

    ways: dict[float, tuple[Way, ...]]
    num_demonstrations: int
    num_trajectories: int


COMPARED = (
    Way(GRID, "grid", "smc"),
    Way(PPO, "ppo", "plain", "average"),
    Way(DISCRETE, "discrete?num_cells=60&hold=6", None),
    Way(DISCRETE, "discrete?num_cells=120&hold=3", None),
    Way(DISCRETE, "discrete?num_cells=120&hold=6", None),
)
FULL = Scale(
    {
        10.0: (Way(SOFT_VALUE, "distilled", "smc"), *COMPARED),
        1.0: (Way(SOFT_VALUE, "soft-value", "smc"), *COMPARED),  # swinging up needs looking ahead
    },
    65,
    10_000,
)
QUICK = Scale(
    {
        10.0: (
            Way(SOFT_VALUE, "soft-value?num_steps=1200000&num_lanes=256&width=96", "smc"),
            Way(GRID, "grid?num_points=121", "smc"),
            Way(PPO, "ppo?num_steps=3000000", "plain", "average"),
            Way(DISCRETE, "discrete?num_cells=60&hold=6", None),
        )
    },
    6,
    1_500,
)


class Exact(NamedTuple):
    """Exact answers from the violation probabilities in a folder.

    Attributes:
      max_torque: largest torque of the model.
      violation: [D, H] probability of entering each cell in the task of each demonstration.
      nats: [H] log-likelihood ratio of all demonstrations, also of those that enter the cell.
      curve: rank of the truth.
    """

    max_torque: float
    violation: np.ndarray
    nats: np.ndarray
    curve: Curve


class Result(NamedTuple):
    """Measurements.

    Attributes:
      scale: amount of work.
      sources: the sets of demonstrations.
      answers: answer for each set, torque and way; of the tables, only the best.
      exact: exact answers for each torque, where the folder holds them.
      seconds: wall time by name: "torque 10: soft value + SMC, learn" and so on.
    """

    scale: Scale
    sources: list[Source]
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
    """Make demonstrations, infer from them in every way, and rank the truth.

    Args:
      folder: folder that keeps slow results, so that a second run finds them.
      data: folder of demo_*.csv and tasks.csv of a pendulum that avoided cell 55, and perhaps
        exact_violation_torque10.csv; None to leave this set out.
      is_quick: whether to do a small amount of work.
      seed: seed of everything random.
      progress: whether to show progress bars.

    Raises:
      ImportError: if CasADi is not installed.
      OSError: if a file is missing or cannot be written.
      ValueError: if a file cannot be understood, the demonstrations enter cell 55, or the folder
        was filled by another version or with other settings.
    """
    name, scale = ("quick", QUICK) if is_quick else ("full", FULL)
    keeping = Keeping.at(folder, name, scale, seed, progress)
    problem, num = pendulum(between_states=False), scale.num_demonstrations
    theirs = None if data is None else _read(data, num if is_quick else None)
    exact = {} if data is None or theirs is None else _exact_violation(data, scale, theirs)
    sources = [
        Source(name, kept_optima(keeping, name, problem, truth, num, SETTINGS), truth)
        for name, truth in CONSTRAINTS.items()
    ]
    sources += [] if theirs is None else [theirs]
    answers = []
    for max_torque, ways in scale.ways.items():
        for way in ways:
            place, num_each = f"torque_{max_torque:g}", scale.num_trajectories
            answers += infer_from(keeping, place, model(max_torque), way, num_each, sources)
    answers = best_tables(answers)
    compared = [
        _exact(max_torque, violation, theirs, scale.num_trajectories, seed)
        for max_torque, violation in exact.items()
        if theirs is not None
    ]
    return Result(scale, sources, answers, compared, keeping.clock.seconds)


def model(max_torque: float) -> str:
    """Return the problem with torques to max_torque, as the command line names it."""
    return f"pendulum?between_states=false&max_torque={max_torque:g}"


def _read(folder: Path, most: int | None) -> Source:
    """Return the demonstrations of a folder, after a check that they avoid cell 55."""
    problem = pendulum(between_states=False)
    cell, made = problem.hypotheses.constraint(REAL_TRUTH), read_folder(folder, problem, most)
    for one in made:
        if violates(cell, one.states, problem.mdp.space, False):
            raise ValueError(
                f"{one.name} enters cell {REAL_TRUTH}, {cell.name}: expected demonstrations that "
                "avoid it"
            )
    return Source(REAL, made, REAL_TRUTH)


def _exact_violation(data: Path, scale: Scale, theirs: Source) -> dict[float, np.ndarray]:
    """Return, for each torque, the exact probabilities [D, H] that a folder holds."""
    paths = {
        max_torque: data / f"exact_violation_torque{max_torque:g}.csv" for max_torque in scale.ways
    }
    return {
        max_torque: read_violation(path, theirs.demonstrations)
        for max_torque, path in paths.items()
        if path.exists()
    }


def _exact(
    max_torque: float, violation: np.ndarray, theirs: Source, num_trajectories: int, seed: int
) -> Exact:
    """Return the exact answers from exact violation probabilities [D, H]."""
    problem, made = pendulum(between_states=False), theirs.demonstrations
    bits = [
        problem.hypotheses.violations(one.states[None], problem.mdp.space, False) for one in made
    ]
    entered = unpack(np.concatenate(bits), NUM_CELLS)
    survival = np.maximum(
        1.0 - np.where(violation < noise_of(num_trajectories), 0.0, violation), LEAST_SURVIVAL
    )
    scores = Judged(-np.log(survival), entered)
    ranks = curve(scores, REAL_TRUTH, sizes_of(len(made)), seed=seed)
    return Exact(max_torque, violation, scores.score.sum(axis=0), ranks)


def read_violation(path: Path, demonstrations: list[Demonstration]) -> np.ndarray:
    """Return exact violation probabilities [D, H] in the order of the demonstrations.

    Raises:
      ValueError: if a demonstration has no row of numbers from 0 to 1 for each of the 100 cells.
    """
    lines = file_content(path).decode().splitlines()
    rows = {row[0]: row[1:] for row in (line.strip().split(",") for line in lines)}
    found = []
    for one in demonstrations:
        name = one.name.removeprefix("demo_")
        try:
            values = np.array(rows.get(name, []), float)
        except ValueError:
            values = np.array([])
        if values.shape != (NUM_CELLS,) or not ((values >= 0.0) & (values <= 1.0)).all():
            raise ValueError(
                f"{path}: expected a row {name} with a probability for each of the {NUM_CELLS} "
                f"cells, got {'none' if name not in rows else ','.join(rows[name])[:60]}"
            )
        found.append(values)
    return np.array(found)
