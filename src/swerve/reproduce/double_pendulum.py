"""A constraint on a double pendulum, in four dimensions: networks against tables of cells.

Hypotheses are 10 x 10 cells of the two angles. Demonstrations are made by optimal control, with the
torques of the model, around one of them. Swerve and MLCI-Discrete (Stocking et al., 2021) are asked
of the same ones, as for the pendulum: how often do they find it, and how long does it take them?
Entering is judged at the states alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from swerve.demonstrators.optimal_control import Settings
from swerve.reproduce.keeping import Keeping
from swerve.reproduce.made import kept_optima
from swerve.reproduce.ways import (
    DISCRETE,
    SOFT_VALUE,
    Answer,
    Source,
    Way,
    best_tables,
    infer_from,
)
from swerve.systems.double_pendulum import double_pendulum

TRUTH = 66  # theta_1 and theta_2 in [0.3, 0.6) rad
NAME = "both angles in [0.3, 0.6) rad"
SOUGHT = Settings(goal_tolerance=1e3)  # how near is near enough is for the reward to say
MODEL = "double-pendulum?between_states=false"


class Scale(NamedTuple):
    """How much is done.

    Attributes:
      num_demonstrations: made.
      num_trajectories: of each task.
      ways: to infer.
    """

    num_demonstrations: int
    num_trajectories: int
    ways: tuple[Way, ...]


FULL = Scale(
    30,
    10_000,
    (
        Way(SOFT_VALUE, "soft-value", "smc"),
        Way(DISCRETE, "discrete?num_cells=12&hold=4", None),
        Way(DISCRETE, "discrete?num_cells=16&hold=4", None),
        Way(DISCRETE, "discrete?num_cells=20&hold=4", None),
    ),
)
QUICK = Scale(
    5,
    1_000,
    (
        Way(SOFT_VALUE, "soft-value?num_steps=1500000", "smc"),
        Way(DISCRETE, "discrete?num_cells=12&hold=4", None),
    ),
)


class Result(NamedTuple):
    """What was measured.

    Attributes:
      scale: how much was done.
      source: the demonstrations.
      answers: of every way, the best table alone.
      seconds: how long what took.
    """

    scale: Scale
    source: Source
    answers: list[Answer]
    seconds: dict[str, float]


def reproduce(
    folder: Path, *, is_quick: bool = False, seed: int = 0, progress: bool = False
) -> Result:
    """Make demonstrations, infer from them in every way, and rank.

    Args:
      folder: where all that takes long is kept, and found again.
      is_quick: whether to do little of it.
      seed: of everything random.
      progress: whether to show progress bars.

    Raises:
      ImportError: if CasADi is not installed.
      OSError: if a file cannot be written.
    """
    scale = QUICK if is_quick else FULL
    keeping = Keeping.at(folder, is_quick, seed, progress)
    problem, num = double_pendulum(between_states=False), scale.num_demonstrations
    source = Source(NAME, kept_optima(keeping, "made", problem, TRUTH, num, SOUGHT), TRUTH)
    answers = []
    for way in scale.ways:
        num = scale.num_trajectories
        answers += infer_from(keeping, "double_pendulum", MODEL, way, num, [source])
    return Result(scale, source, best_tables(answers), keeping.clock.seconds)
