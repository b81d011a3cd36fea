"""Say which scores are bounds or rest on too few trajectories, and what was done about them.

Where hardly any nominal trajectory avoids a hypothesis, its score is open. `swerve.resolve` works
open scores out. Some it tries in vain, some are left for want of time, and some it cannot try.

Shapes: K tasks, H hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from swerve.base.phrases import some_names
from swerve.base.solver_kinds import kind_stored, solver_names
from swerve.evidence.evidence import Evidence
from swerve.inference.ranking import Ranking
from swerve.inference.unresolved import worth_resolving


def hardly_avoided(inference: Ranking) -> Iterator[str]:
    """Yield warnings about hypotheses that hardly any nominal trajectory avoids."""
    evidence, ranking = inference.evidence, inference.ranking
    used = (inference.counts.avoiding > 0) & ~evidence.has_too_few[:, None]
    floored = evidence.is_floored & used
    in_vain = np.isposinf(evidence.summary.log_ratio_error) & used  # `resolve` failed
    bounds = ranking[floored[:, ranking].any(axis=0)]
    if len(bounds):
        resolution = evidence.resolution[floored[:, bounds].any(axis=1)]
        text = (
            f"the score of {_names(bounds)} is only a lower bound: almost every nominal trajectory "
            "of a task enters it, and for each demonstration of such a task the samples tell no "
            f"more than about {-math.log(resolution.min()):.1f} nats"
        )
        if not kind_stored(evidence.solver).adapts:
            names = " and ".join(solver_names(lambda kind: kind.adapts))
            text += f". The solvers {names} can tell more"
        tried = bounds[(floored & in_vain)[:, bounds].any(axis=0)]
        yield text + _in_vain(evidence, tried) + _left(inference, bounds)
    few = ranking[(in_vain & ~floored)[:, ranking].any(axis=0)]
    if len(few):
        yield (
            f"the score of {_names(few)} rests on the two or three nominal trajectories of a task "
            "that avoid it: its error may be larger than stated"
        ) + _in_vain(evidence, few)


def _names(hypotheses: np.ndarray) -> str:
    return some_names([f"hypothesis {index}" for index in hypotheses])


def _in_vain(evidence: Evidence, tried: np.ndarray) -> str:
    """Return the text for log ratios that `swerve.resolve` tried and could not settle."""
    if not len(tried):
        return ""
    finer = kind_stored(evidence.solver).finer
    more = f"give the solver more {finer}, " if finer else ""
    return (
        f". Sampling with {_names(tried)} in force did not settle it: sample more trajectories, "
        f"{more}or see whether anything the robot can do avoids it"
    )


def _left(inference: Ranking, bounds: np.ndarray) -> str:
    """Return the text for bounds that `swerve.resolve` would replace and has not tried.

    The text leaves out bounds that can change nothing, such as of hypotheses that a tolerance keeps
    far behind: `swerve.resolve` leaves these out too.
    """
    worth = set(worth_resolving(inference).tolist())
    left = np.array([index for index in bounds.tolist() if index in worth], int)
    is_able = kind_stored(inference.evidence.solver).adapts
    if not (len(left) and is_able and inference.score_name == "likelihood"):
        return ""
    return (
        f". {_names(left)} {'was' if len(left) == 1 else 'were'} not tried with the hypothesis in "
        "force: swerve.resolve does this, and so does swerve infer without --no-resolve, as far "
        "as the time goes"
    )
