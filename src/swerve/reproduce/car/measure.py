"""Measure which part of the track a swerving driver avoids (the paper, figure 4).

Human-like drivers pass an obstacle in the right lane; the hypotheses are 2 x 14 regions of the
track. Beta is estimated by maximum likelihood from drives on a free track. Nominal trajectories
enter every region of the right lane almost surely. So the order of the regions that a drive left
out depends on the cost of driving around each region, which `resolve` works out with the region in
force. A drive may ignore the constraint with probability TOLERANCE, since no region equals the
obstacle. The same ranking from samples at the paper's beta is measured for comparison.

Shapes: D drives, H hypotheses, L states of a drive.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.answer import Inference, infer
from swerve.base.progress import progress_bar
from swerve.constraints.boxes import Box
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrators.driver import drives
from swerve.evidence.evidence import Evidence
from swerve.fitting.beta import BetaFit, fit_beta
from swerve.monitoring.course import follow
from swerve.monitoring.foresight import Foresight
from swerve.monitoring.monitor import Monitor
from swerve.problem.problem import Problem
from swerve.reproduce.car import kept
from swerve.reproduce.car.kept import TASK
from swerve.reproduce.keeping import Keeping
from swerve.solvers.base import Nominal
from swerve.solvers.trained.soft_value import SoftValue
from swerve.systems.car import GOAL_LINE, NUM_ROWS, Car, car

OBSTACLE = Box(x=(-0.3, 0.2), y=(6.7, 7.4))
# index of the region in the right lane that holds the middle of the obstacle
TRUTH = NUM_ROWS + int(NUM_ROWS * sum(OBSTACLE.intervals["y"]) / 2.0 / GOAL_LINE)
NUM_FREE = 20  # drives on a free track, to estimate beta from
SEVEN = 7  # number of drives in the paper
NUM_SETS = 200  # random sets of seven drives
TOLERANCE = 0.05  # probability of ignoring the constraint: regions only approximate the obstacle
SURE = 0.5  # posterior above which a monitor believes in a region
FIRST_BETA = 0.45  # beta of the first samples: near the estimate, so that enough samples count
PAPER_BETA = 200.0  # beta in the paper
EXACT, NEXT, OTHER, TIED = "exact", "next to it", "other", "tied with others"


class Scale(NamedTuple):
    """Amount of work of a run.

    Attributes:
      dt: duration of a step of the model [s].
      num_drives: number of drives around the obstacle.
      num_trajectories: number of sampled trajectories.
      solver: solver of the nominal distribution.
      num_paper: number of trajectories brought to the paper's beta.
      num_rollouts: number of rollouts that foresight is learned from.
      num_updates: number of updates of foresight.
    """

    dt: float
    num_drives: int
    num_trajectories: int
    solver: SoftValue
    num_paper: int
    num_rollouts: int
    num_updates: int


FULL = Scale(
    dt=0.05,
    num_drives=70,
    num_trajectories=10_000,
    solver=SoftValue(num_steps=20_000_000),
    num_paper=200,
    num_rollouts=6_000,
    num_updates=10_000,
)
QUICK = Scale(
    dt=0.1,
    num_drives=14,
    num_trajectories=2_000,
    solver=SoftValue(num_steps=1_000_000, num_lanes=128, width=64),
    num_paper=16,
    num_rollouts=1_000,
    num_updates=2_000,
)


class Single(NamedTuple):
    """Ranking by one drive alone.

    Attributes:
      first: index of the region that comes first.
      tied: number of regions tied with the first, itself included.
      bounds: number of regions the drive leaves out for which the samples give only a bound.
      posterior: [H + 1] probabilities, the one of no constraint last.
    """

    first: int
    tied: int
    bounds: int
    posterior: np.ndarray


class Early(NamedTuple):
    """Place of the car from which a monitor believes in the truth to the end; NaN for never.

    Attributes:
      exact: y from which the true region has a posterior above SURE [m].
      near: y from which the true region and its neighbours together have more than SURE [m].
    """

    exact: float
    near: float


class Result(NamedTuple):
    """Measurements.

    Attributes:
      scale: amount of work.
      drives: [D] drives around the obstacle.
      fit: beta of the drives on a free track.
      evidence: evidence at this beta, resolved.
      singles: [D] ranking by each drive alone.
      early: [D] place from which a monitor knew, for each drive.
      seven: inference from the first seven drives together.
      seven_share: share of random sets of seven for which the truth comes first.
      paper: [D] ranking by each drive alone, from samples at the paper's beta.
      paper_evidence: evidence at the paper's beta.
      seconds: wall time of each piece of work, by its name.
    """

    scale: Scale
    drives: list[Demonstration]
    fit: BetaFit
    evidence: Evidence
    singles: list[Single]
    early: list[Early]
    seven: Inference
    seven_share: float
    paper: list[Single]
    paper_evidence: Evidence
    seconds: dict[str, float]


def reproduce(
    folder: Path, *, is_quick: bool = False, seed: int = 0, progress: bool = False
) -> Result:
    """Make drives, estimate beta, and infer from each drive, during it and after.

    Args:
      folder: folder that keeps slow results, so that a second run finds them.
      is_quick: whether to do a small amount of work.
      seed: seed of everything random.
      progress: whether to show progress bars.

    Raises:
      OSError: if a file cannot be written.
      ValueError: if the drives do not determine beta, or the folder was filled by another version
        or with other settings.
    """
    name, scale = ("quick", QUICK) if is_quick else ("full", FULL)
    keeping = Keeping.at(folder, name, scale, seed, progress)
    made = drives(Car(), OBSTACLE, scale.num_drives, seed=seed)
    free = drives(Car(), None, NUM_FREE, seed=1_000 + seed)
    fit, nominal, evidence = _fitted(keeping, scale, free)
    evidence = kept.resolved(keeping, nominal, evidence, made)
    foresight = kept.foresight(keeping, nominal, evidence, scale.num_rollouts, scale.num_updates)
    with progress_bar("monitoring", len(made), progress) as advance:
        early = []
        for drive in made:
            early.append(_early(evidence, foresight, drive))
            advance(1)
    paper_evidence = kept.evidence(keeping, "paper", nominal, scale.num_paper, PAPER_BETA)
    return Result(
        scale,
        made,
        fit,
        evidence,
        [_single(evidence, drive) for drive in made],
        early,
        infer(evidence, made[:SEVEN], tolerance=TOLERANCE),
        _seven_share(evidence, made, seed),
        [_single(paper_evidence, drive) for drive in made],
        paper_evidence,
        keeping.clock.seconds,
    )


def model(scale: Scale, beta: float) -> Problem:
    """Return the car's problem in steps of scale.dt, with the usual duration of an episode."""
    usual = Car()
    mdp = Car(dt=scale.dt, num_steps=round(usual.dt * usual.num_steps / scale.dt))
    return dataclasses.replace(car(beta), mdp=mdp)


def verdict(index: int) -> str:
    """Return whether a region is the true one, next to it, or another."""
    (lane, row), (true_lane, true_row) = divmod(index, NUM_ROWS), divmod(TRUTH, NUM_ROWS)
    return (EXACT, NEXT, OTHER)[min(abs(lane - true_lane) + abs(row - true_row), 2)]


def _fitted(
    keeping: Keeping, scale: Scale, free: list[Demonstration]
) -> tuple[BetaFit, Nominal, Evidence]:
    """Return beta by maximum likelihood, and the nominal and the evidence at this beta."""
    num, solver = scale.num_trajectories, scale.solver
    first = kept.nominal(keeping, "first", model(scale, FIRST_BETA), solver)
    fit = fit_beta(first.problem, kept.evidence(keeping, "first", first, num), free)
    if fit.at_boundary:
        raise ValueError(f"the drives on a free track do not determine beta: {fit}")
    beta = float(f"{fit.beta:.2g}")
    nominal = kept.nominal(keeping, "fitted", model(scale, beta), solver)
    return fit, nominal, kept.evidence(keeping, "fitted", nominal, num)


def _single(evidence: Evidence, drive: Demonstration) -> Single:
    """Return the ranking by one drive alone."""
    result = infer(evidence, [drive], tolerance=TOLERANCE)
    belief, bounds = result.posterior, result.is_lower_bound & ~result.entered[0]
    return Single(
        int(result.ranking[0]),
        len(result.leaders),
        int(bounds.sum()),
        np.append(belief.hypotheses, belief.none),
    )


def _early(evidence: Evidence, foresight: Foresight, drive: Demonstration) -> Early:
    """Return the places of the car from which a monitor believes in the truth to the end."""
    course = follow(Monitor(evidence, TASK, foresight, tolerance=TOLERANCE), drive)
    found = [verdict(index) for index in range(course.hypotheses.shape[1])]
    y = np.append(drive.states[:, 1], drive.states[-1, 1])
    exact, near = (
        course.hypotheses[:, [one in right for one in found]].sum(axis=1) > SURE
        for right in ((EXACT,), (EXACT, NEXT))
    )
    return Early(_from(y, exact), _from(y, near))


def _from(y: np.ndarray, holds: np.ndarray) -> float:
    """Return the y from which a condition holds to the end; NaN if it fails at the end."""
    if not holds[-1]:
        return math.nan
    wrong = np.flatnonzero(~holds)
    return float(y[wrong[-1] + 1]) if len(wrong) else float(y[0])


def _seven_share(evidence: Evidence, made: list[Demonstration], seed: int) -> float:
    """Return the share of random sets of seven for which the truth comes first."""
    generator = np.random.default_rng(seed)
    contributions = infer(evidence, made, tolerance=TOLERANCE).contributions
    num = min(SEVEN, len(made))
    sets = [generator.choice(len(made), num, replace=False) for _ in range(NUM_SETS)]
    return float(np.mean([_leads(contributions[chosen].sum(axis=0)) for chosen in sets]))


def _leads(score: np.ndarray) -> bool:
    """Return whether the true region has a larger score [H] than every other."""
    return bool(score[TRUTH] > np.delete(score, TRUTH).max())
