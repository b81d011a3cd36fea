"""Which part of the track a swerving driver avoids (the paper, figure 4).

Human-like drivers pass an obstacle in the right lane; the hypotheses are 2 x 14 regions of the
track. Beta is that of drives with nothing in the way, by maximum likelihood. Nominal drivers enter
every region of the right lane almost surely: what comes first among those that somebody left out
rests on what driving around each would cost, which is worked out with the region in force
(`resolving`). A drive may ignore the constraint with probability TOLERANCE, since no region is the
obstacle exactly. What samples say that are brought to the paper's beta comes beside it.

Shapes: D drives, H hypotheses, L states of a drive.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.constraints.boxes import Box
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrators.driver import START, drives
from swerve.evidence.evidence import Evidence
from swerve.fitting.beta import BetaFit, fit_beta
from swerve.inference.ranking import Inference, infer
from swerve.monitoring.course import follow
from swerve.monitoring.foresee import foresee
from swerve.monitoring.foresight import Foresight
from swerve.monitoring.monitor import Monitor
from swerve.problem.problem import Problem
from swerve.reproduce.keeping import Keeping
from swerve.sampling.resolve import resolve
from swerve.sampling.sample import sample
from swerve.solvers.learn import Nominal, learn, load_nominal, save_nominal
from swerve.solvers.trained.soft_value import SoftValue
from swerve.systems.car import GOAL_LINE, NUM_ROWS, Car, car

OBSTACLE = Box(x=(-0.3, 0.2), y=(6.7, 7.4))
# the region that holds the middle of the obstacle, in the right lane
TRUTH = NUM_ROWS + int(NUM_ROWS * sum(OBSTACLE.intervals["y"]) / 2.0 / GOAL_LINE)
NUM_FREE = 20  # drives with nothing in the way
SEVEN = 7  # drives in the paper
NUM_SETS = 200  # random sets of seven
TOLERANCE = 0.05
SURE = 0.5  # posterior of what a monitor believes in
FIRST_BETA = 0.45  # at which that of the drives is looked for, from nearby
PAPER_BETA = 200.0
TASK = Task(np.array(START), np.zeros(0))
EXACT, NEXT, OTHER, TIED = "exact", "next to it", "other", "tied with others"


class Scale(NamedTuple):
    """How much is done.

    Attributes:
      dt: duration of a step of the model [s].
      num_drives: around the obstacle.
      num_trajectories: sampled.
      solver: of the nominal distribution.
      num_paper: trajectories brought to the paper's beta.
      num_rollouts: that foresight is learned from.
      num_updates: of it.
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
    """What one drive alone tells.

    Attributes:
      first: the region that comes first.
      tied: regions that cannot be told from it, itself included.
      bounds: regions that it leaves out and of which the samples give a bound alone.
      posterior: [H + 1] probabilities, that of no constraint last.
    """

    first: int
    tied: int
    bounds: int
    posterior: np.ndarray


class Early(NamedTuple):
    """From where on a monitor believes in it for good; NaN where it never does.

    Attributes:
      exact: y from which the true region has a posterior above SURE [m].
      near: y from which it and those next to it have one together [m].
    """

    exact: float
    near: float


class Result(NamedTuple):
    """What was measured.

    Attributes:
      scale: how much was done.
      drives: around the obstacle.
      fit: beta of drives with nothing in the way.
      evidence: at that beta, resolved.
      singles: what each drive alone tells.
      early: when a monitor knew, for each drive.
      seven: of the first seven drives together.
      seven_share: share of random sets of seven for which the truth comes first.
      paper: what each drive alone tells by samples of the paper's beta.
      paper_evidence: those samples, with the verdict on them.
      seconds: how long what took.
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
    """Have drivers drive, fit beta, and infer from each drive, while it lasts and after.

    Args:
      folder: where all that takes long is kept, and found again.
      is_quick: whether to do little of it.
      seed: of everything random.
      progress: whether to show progress bars.

    Raises:
      OSError: if a file cannot be written.
      ValueError: if beta cannot be told from the drives, or what is kept was made by another
        version or with other settings.
    """
    name, scale = ("quick", QUICK) if is_quick else ("full", FULL)
    keeping = Keeping.at(folder, name, scale, seed, progress)
    made = drives(Car(), OBSTACLE, scale.num_drives, seed=seed)
    free = drives(Car(), None, NUM_FREE, seed=1_000 + seed)
    fit, nominal, evidence = _fitted(keeping, scale, free)
    evidence = _resolved(keeping, nominal, evidence, made)
    foresight = _foresight(keeping, nominal, evidence, scale)
    with progress_bar("monitoring", len(made), progress) as advance:
        early = []
        for drive in made:
            early.append(_early(evidence, foresight, drive))
            advance(1)
    paper_evidence = _evidence(keeping, "paper", nominal, scale.num_paper, PAPER_BETA)
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
    """Return the car in steps of scale.dt, in as much time as always."""
    usual = Car()
    mdp = Car(dt=scale.dt, num_steps=round(usual.dt * usual.num_steps / scale.dt))
    return dataclasses.replace(car(beta), mdp=mdp)


def verdict(index: int) -> str:
    """Return whether a region is the true one, next to it, or another."""
    (lane, row), (true_lane, true_row) = divmod(index, NUM_ROWS), divmod(TRUTH, NUM_ROWS)
    return (EXACT, NEXT, OTHER)[min(abs(lane - true_lane) + abs(row - true_row), 2)]


def _nominal(keeping: Keeping, name: str, problem: Problem, solver: SoftValue) -> Nominal:
    """Return what is learned of a problem."""
    path, checkpoint = (keeping.folder / f"{name}.{kind}" for kind in ("nominal", "checkpoint"))
    if not path.exists():
        how = {"seed": keeping.seed, "progress": keeping.progress, "checkpoint": checkpoint}
        with keeping.clock.timing(f"{name}: learn"):
            nominal = learn(problem, solver, tasks=Task.stack([TASK]), **how)
        save_nominal(path, nominal)
        checkpoint.unlink(missing_ok=True)
    return load_nominal(path, problem)


def _evidence(
    keeping: Keeping, name: str, nominal: Nominal, num: int, beta: float | None = None
) -> Evidence:
    """Return evidence of the one task, by way of others of another beta if one is given."""
    path = keeping.folder / f"{name}.evidence"
    if not path.exists():
        how = {"beta": beta, "seed": keeping.seed, "progress": keeping.progress}
        with keeping.clock.timing(f"{name}: sample"):
            evidence = sample(nominal, TASK, num, **how)
        evidence.save(path)
    wanted = nominal.problem if beta is None else dataclasses.replace(nominal.problem, beta=beta)
    return _loaded(path, wanted)


def _loaded(path: Path, problem: Problem) -> Evidence:
    """Return stored evidence of a problem.

    Raises:
      ValueError: if it is of another.
    """
    evidence = Evidence.load(path)
    if evidence.problem.fingerprint != problem.record.fingerprint:
        raise ValueError(
            f"{path}: expected evidence of {problem.record.summary}, got that of "
            f"{evidence.problem.summary}: remove it"
        )
    return evidence


def _fitted(
    keeping: Keeping, scale: Scale, free: list[Demonstration]
) -> tuple[BetaFit, Nominal, Evidence]:
    """Return beta by maximum likelihood, and what is learned and sampled of it."""
    num, solver = scale.num_trajectories, scale.solver
    first = _nominal(keeping, "first", model(scale, FIRST_BETA), solver)
    fit = fit_beta(first.problem, _evidence(keeping, "first", first, num), free)
    if fit.at_boundary:
        raise ValueError(f"the drives tell no beta: {fit}")
    beta = float(f"{fit.beta:.2g}")
    nominal = _nominal(keeping, "fitted", model(scale, beta), solver)
    return fit, nominal, _evidence(keeping, "fitted", nominal, num)


def _resolved(
    keeping: Keeping, nominal: Nominal, evidence: Evidence, made: list[Demonstration]
) -> Evidence:
    """Return evidence with what the single rankings hang on worked out."""
    path = keeping.folder / "resolved.evidence"
    if path.exists():
        evidence = _loaded(path, nominal.problem)
    with keeping.clock.timing("resolve"):
        for drive in made:
            inference = infer(evidence, [drive])
            if inference.is_open.any():
                evidence = resolve(
                    nominal,
                    inference,
                    seed=keeping.seed,
                    progress=keeping.progress,
                    keep=lambda found: found.save(path),
                )
    return evidence


def _foresight(keeping: Keeping, nominal: Nominal, evidence: Evidence, scale: Scale) -> Foresight:
    """Return what is foreseen of each region from any state."""
    path = keeping.folder / "foresight"
    if not path.exists():
        with keeping.clock.timing("foresee"):
            found = foresee(
                nominal,
                evidence,
                num_trajectories=scale.num_rollouts,
                num_updates=scale.num_updates,
                seed=keeping.seed,
                progress=keeping.progress,
            )
        found.save(path)
    foresight = Foresight.load(path, nominal.problem)
    if foresight.learned_from != evidence.digest:
        raise ValueError(f"{path}: was learned from other evidence: remove it")
    return foresight


def _single(evidence: Evidence, drive: Demonstration) -> Single:
    result = infer(evidence, [drive], tolerance=TOLERANCE)
    belief, bounds = result.posterior, result.is_lower_bound & ~result.entered[0]
    return Single(
        int(result.ranking[0]),
        len(result.leaders),
        int(bounds.sum()),
        np.append(belief.hypotheses, belief.none),
    )


def _early(evidence: Evidence, foresight: Foresight, drive: Demonstration) -> Early:
    """Return from where on a monitor believes in the truth, and in it or a neighbour."""
    course = follow(Monitor(evidence, TASK, foresight, tolerance=TOLERANCE), drive)
    found = [verdict(index) for index in range(course.hypotheses.shape[1])]
    y = np.append(drive.states[:, 1], drive.states[-1, 1])
    exact, near = (
        course.hypotheses[:, [one in right for one in found]].sum(axis=1) > SURE
        for right in ((EXACT,), (EXACT, NEXT))
    )
    return Early(_from(y, exact), _from(y, near))


def _from(y: np.ndarray, holds: np.ndarray) -> float:
    """Return the y from which on something holds to the end, NaN if it does not then."""
    if not holds[-1]:
        return math.nan
    wrong = np.flatnonzero(~holds)
    return float(y[wrong[-1] + 1]) if len(wrong) else float(y[0])


def _seven_share(evidence: Evidence, made: list[Demonstration], seed: int) -> float:
    """Return the share of random sets of seven for which the truth comes first."""
    generator = np.random.default_rng(seed)
    said = infer(evidence, made, tolerance=TOLERANCE).contributions
    num = min(SEVEN, len(made))
    sets = [generator.choice(len(made), num, replace=False) for _ in range(NUM_SETS)]
    return float(np.mean([_leads(said[chosen].sum(axis=0)) for chosen in sets]))


def _leads(score: np.ndarray) -> bool:
    """Return whether the true region has a larger score [H] than every other."""
    return bool(score[TRUTH] > np.delete(score, TRUTH).max())
