"""What tests send to other processes: functions of a module, as `pickle` needs them."""

from __future__ import annotations

from typing import Any

import numpy as np
from support.every_solver import GRID, TASK, push

import swerve


def sampled(seed: int) -> tuple[float, str]:
    """Learn, sample and infer; return log Z_0 and the headline."""
    evidence = swerve.sample(swerve.learn(push(), GRID), TASK, 200, seed=seed)
    return float(evidence.log_partition[0]), swerve.infer(evidence).headline


def made(seed: int) -> swerve.Evidence:
    """Return evidence, to be sent back."""
    return swerve.sample(swerve.learn(push(), GRID), TASK, 200, seed=seed)


def headline(evidence: swerve.Evidence) -> str:
    """Return the answer that evidence alone gives."""
    return swerve.infer(evidence).headline


def sampled_from(nominal: Any) -> float:
    """Return log Z_0 by samples of a nominal distribution."""
    return float(np.ravel(swerve.sample(nominal, TASK, 200).log_partition)[0])


def outcome(function: Any, *arguments: Any) -> str:
    """Return the text of the error that a call raises, or of its result."""
    try:
        return str(function(*arguments))
    except Exception as error:
        return f"{type(error).__name__}: {error}"
