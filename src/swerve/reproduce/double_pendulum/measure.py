"""Measure ranks and wall times for a double pendulum, in four dimensions: networks and tables.

Hypotheses are 10 x 10 cells of the two angles. Demonstrations are made by optimal control, with the
torques of the model, around one cell. Swerve and MLCI-Discrete (Stocking et al., 2021) infer from
the same demonstrations, as for the pendulum: how high do they rank the true cell, and how long do
they take? Entering is judged at the states alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from swerve.demonstrators.path_search import Search
from swerve.reproduce.keeping import Keeping
from swerve.reproduce.kept_demonstrations import kept_optima
from swerve.reproduce.ways import DISCRETE, SOFT_VALUE, Answer, Source, Way, best_tables, infer_from
from swerve.systems.double_pendulum import double_pendulum

TRUTH = 66  # theta_1 and theta_2 in [0.3, 0.6) rad
NAME = "both angles in [0.3, 0.6) rad"
SETTINGS = Search(goal_tolerance=1e3)  # any end: the reward already charges for missing the goal
MODEL = "double-pendulum?between_states=false"


class Scale(NamedTuple):
    """Amount of work of a run.

    Attributes:
      num_demonstrations: number of demonstrations to make.
      num_trajectories: number of trajectories of each task.
      ways: the ways to infer.
    """

    num_demonstrations: int
    num_trajectories: int
    ways: tuple[Way, ...]


HYPOTHESISED = "low=-1.5,-1.5,-2,-2&high=1.5,1.5,2,2"  # the part of the states that has hypotheses
WIDER = "low=-2.1,-2.1,-2,-2&high=2.1,2.1,2,2"  # the same with a margin of the angles
FULL = Scale(
    30,
    10_000,
    (
        Way(SOFT_VALUE, "soft-value", "smc"),
        Way(DISCRETE, "discrete?num_cells=12&hold=4", None),
        Way(DISCRETE, f"discrete?num_cells=14&hold=4&{WIDER}", None),
        Way(DISCRETE, f"discrete?num_cells=10&hold=10&{HYPOTHESISED}", None),
        Way(DISCRETE, f"discrete?num_cells=10&hold=4&{HYPOTHESISED}", None),
    ),
)
QUICK = Scale(
    5,
    1_000,
    (
        Way(SOFT_VALUE, "soft-value?num_steps=1500000", "smc"),
        Way(DISCRETE, f"discrete?num_cells=10&hold=4&{HYPOTHESISED}", None),
    ),
)


class Result(NamedTuple):
    """Measurements.

    Attributes:
      scale: amount of work.
      source: the demonstrations.
      answers: answer of each way; of the tables, only the best.
      seconds: wall time of each piece of work, by its name.
    """

    scale: Scale
    source: Source
    answers: list[Answer]
    seconds: dict[str, float]


def reproduce(
    folder: Path, *, is_quick: bool = False, seed: int = 0, progress: bool = False
) -> Result:
    """Make demonstrations, infer from them in every way, and rank the truth.

    Args:
      folder: folder that keeps slow results, so that a second run finds them.
      is_quick: whether to do a small amount of work.
      seed: seed of everything random.
      progress: whether to show progress bars.

    Raises:
      ImportError: if CasADi is not installed.
      OSError: if a file cannot be written.
      ValueError: if the folder was filled by another version or with other settings.
    """
    name, scale = ("quick", QUICK) if is_quick else ("full", FULL)
    keeping = Keeping.at(folder, name, scale, seed, progress)
    problem, num = double_pendulum(between_states=False), scale.num_demonstrations
    source = Source(NAME, kept_optima(keeping, "made", problem, TRUTH, num, SETTINGS), TRUTH)
    answers = []
    for way in scale.ways:
        num_each = scale.num_trajectories
        answers += infer_from(keeping, "double_pendulum", MODEL, way, num_each, [source])
    return Result(scale, source, best_tables(answers), keeping.clock.seconds)
