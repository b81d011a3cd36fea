"""How closely people follow the shortest way: beta, by cross-validation.

Squares that one track enters are free, so nothing there holds the others back. Chosen is the beta
under which each track enters, or does not, the squares that another one has entered as probably as
can be,

    sum_i mean_c log p_i(c),   p_i(c) = 1 - Z_c/Z_0 if track i enters c, Z_c/Z_0 if not,

i over tracks, c over the squares that count for i and that a track other than i enters. What a path
looks like from step to step does not come into it: people's are smoother than those of a lattice,
and by their lengths beta would be at the boundary.

An obstacle that many tracks have to go round would pass for straying. So it is done twice, the
second time with what the first beta leads to in force, if that is more probable than nothing.

Shapes: D tracks, H hypotheses, L betas.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from swerve.base.space import Task
from swerve.inference.ranking import Inference
from swerve.solvers.exact.soft_paths import PathNominal
from swerve.systems.walker import Walker

CLEARANCE = 0.75  # m, between the ends of a track and the squares that it tells of
FIRST, RATIO, LAST = 1.02, 1.05, 3.0  # betas that are tried, in units of the least
NUM_WORSE = 3  # betas in a row below the best, after which no higher one is tried
QUICK_RATIO, QUICK_LAST = 1.1, 2.0
UNLIKELY = 1e-6  # the least probability that a track is charged for
NUM_RESAMPLED = 1000  # sets of tracks, for the interval of beta
RULE = "cross-validated likelihood of which squares that another track has entered a track enters"


class Beta(NamedTuple):
    """How beta was chosen.

    Attributes:
      value: the beta [nats/m].
      interval: where it lies for 95 % of sets of tracks drawn anew from these, and half a step
        between the betas that were tried on either side.
      least: above which pi_0 exists.
      tried: [L] betas.
      score: [L, D] mean log-probability of what each track enters, nats a square.
    """

    value: float
    interval: tuple[float, float]
    least: float
    tried: np.ndarray
    score: np.ndarray

    @property
    def at_boundary(self) -> bool:
        """Whether one of the outermost betas that were tried is the best."""
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
    """Choose beta among some, lowest first, of which [L] are tried.

    Args:
      nominal: of the room, for any beta.
      start: what tracks enter, and what counts for them, inferred at any beta.
      tried: betas, ascending.
      generator: of sets of tracks.
      avoiding: a hypothesis that is in force, where it counts.
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
    half, least = (
        math.sqrt(tried[1] / tried[0]),
        walker.least_beta,
    )  # nothing tells finer than steps
    best = float(tried[score.sum(axis=1).argmax()])
    return Beta(best, (max(low / half, least), high * half), least, tried, score)


def _avoid_probability(
    nominal: PathNominal, tasks: Task, held: np.ndarray, avoiding: int | None
) -> np.ndarray:
    """Return the probability [D, H] of avoiding each hypothesis, with one in force for some."""
    found = np.empty((len(held), len(nominal.problem.hypotheses)))
    for some, in_force in ((held, [avoiding]), (~held, [])):
        if some.any():
            part = Task(*(values[some] for values in tasks))
            found[some] = nominal.log_ratio(part, [c for c in in_force if c is not None])
    return np.clip(np.exp(found), 0.0, 1.0)
