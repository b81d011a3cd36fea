"""Choose beta, how closely people follow the shortest way, by cross-validation.

A square that one track enters is free of obstacles, so the other tracks avoid or enter it by choice
alone. The chosen beta maximises the probability of these choices,

    sum_i mean_c log p_i(c),   p_i(c) = 1 - Z_c/Z_0 if track i enters c, Z_c/Z_0 if not,

i over tracks, c over the squares that count for i and that a track other than i enters. The steps
of a track do not count: people's tracks are smoother than paths on a lattice, and the likelihood of
their lengths has its maximum at the boundary of beta.

A way around an obstacle looks like a long way by choice, which lowers beta. So beta is chosen
twice if, by the first beta, a constraint is more probable than none: the second time with that
constraint in force.

Shapes: D tracks, H hypotheses, L betas.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from swerve.answer import Inference
from swerve.base.space import Task
from swerve.solvers.exact.soft_paths import PathNominal
from swerve.systems.walker import Walker

CLEARANCE = 0.75  # m between the ends of a track and the squares that count for it
FIRST, RATIO, LAST = 1.02, 1.05, 3.0  # first beta to try, ratio of two, last: times the least
NUM_WORSE = 3  # betas worse than the best before them, after which no higher one is tried
QUICK_RATIO, QUICK_LAST = 1.1, 2.0  # the same with --quick
UNLIKELY = 1e-6  # least probability of a choice, so that one track does not decide alone
NUM_RESAMPLED = 1000  # bootstrap samples of the tracks, for the interval of beta
RULE = "cross-validated likelihood that a track enters, or not, squares that other tracks enter"


class Beta(NamedTuple):
    """The chosen beta and the scores that it was chosen by.

    Attributes:
      value: the chosen beta [nats/m].
      interval: 95 % interval by bootstrap over the tracks, widened at both ends by half a step
        between the betas that were tried.
      least: beta above which pi_0 exists.
      tried: [L] betas that were tried.
      score: [L, D] mean log-probability of the choices of each track, nats a square.
    """

    value: float
    interval: tuple[float, float]
    least: float
    tried: np.ndarray
    score: np.ndarray

    @property
    def at_boundary(self) -> bool:
        """Whether the lowest or the highest beta that was tried is the best."""
        return self.value in (self.tried[0], self.tried[-1])


def ladder(least: float, is_quick: bool) -> np.ndarray:
    """Return the betas [L] to try, above the least."""
    ratio, last = (QUICK_RATIO, QUICK_LAST) if is_quick else (RATIO, LAST)
    return least * FIRST * ratio ** np.arange(1 + int(math.log(last / FIRST) / math.log(ratio)))


def choose_beta(
    nominal: PathNominal,
    start: Inference,
    tried: np.ndarray,
    generator: np.random.Generator,
    avoiding: int | None = None,
    advance: Callable[[], None] = lambda: None,
) -> Beta:
    """Return the best beta, trying the lowest first and ending after NUM_WORSE worse ones.

    Args:
      nominal: nominal of the room, at any beta.
      start: inference at any beta, for the squares that tracks enter and that count for them.
      tried: betas to try, ascending.
      generator: random generator of the bootstrap.
      avoiding: index of a hypothesis in force for the tracks that it counts for; None if none is.
      advance: called after each beta.
    """
    tasks = Task.stack([item.task for item in start.demonstrations])
    is_counted = start.is_counted[start.task_of]
    entered = start.entered & is_counted
    counts = is_counted & (entered.sum(axis=0) - entered > 0)
    held = np.zeros(len(entered), bool) if avoiding is None else is_counted[:, avoiding]
    scores: list[np.ndarray] = []
    for beta in tried:
        if len(scores) - int(np.argmax([one.sum() for one in scores] or [0.0])) > NUM_WORSE:
            break
        avoid = _avoid_probability(nominal.at_beta(float(beta)), tasks, held, avoiding)
        probability = np.maximum(np.where(entered, 1.0 - avoid, avoid), UNLIKELY)
        total = np.where(counts, np.log(probability), 0.0).sum(axis=1)
        scores.append(total / np.maximum(counts.sum(axis=1), 1))
        advance()
    walker, num, score = nominal.problem.mdp, len(entered), np.array(scores)
    assert isinstance(walker, Walker)
    tried = tried[: len(score)]
    weights = generator.multinomial(num, np.full(num, 1.0 / num), NUM_RESAMPLED)
    low, high = np.percentile(tried[(score @ weights.T).argmax(axis=0)], (2.5, 97.5)).tolist()
    half, least = math.sqrt(tried[1] / tried[0]), walker.least_beta  # half a step, as a ratio
    best = float(tried[score.sum(axis=1).argmax()])
    return Beta(best, (max(low / half, least), high * half), least, tried, score)


def _avoid_probability(
    nominal: PathNominal, tasks: Task, held: np.ndarray, avoiding: int | None
) -> np.ndarray:
    """Return the probability [D, H] of avoiding each hypothesis, with one in force where `held`."""
    found = np.empty((len(held), len(nominal.problem.hypotheses)))
    for some, in_force in ((held, [avoiding]), (~held, [])):
        if some.any():
            part = Task(*(values[some] for values in tasks))
            found[some] = nominal.log_ratio(part, [c for c in in_force if c is not None])
    return np.clip(np.exp(found), 0.0, 1.0)
