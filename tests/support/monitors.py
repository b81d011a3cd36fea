"""A monitor whose foresight is known."""

from __future__ import annotations

import numpy as np
from support.synthetic import TASKS, make_evidence

from swerve import Monitor, Task
from swerve.evidence.evidence import Evidence
from swerve.monitoring.foresight import Ahead

TASK = Task(TASKS.start[0], TASKS.goal[0])
START = TASKS.start[0].tolist()


class Known:
    """Foresight that says log P(avoid) = -h (T - step) / 100 for hypothesis h.

    At the horizon, where nothing is left to be foreseen and nobody should ask, it is wrong.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.fingerprint = evidence.problem.fingerprint
        self.num = len(evidence.problem.hypotheses)

    def towards(self, goal: np.ndarray) -> Ahead:
        return lambda state, step: -np.arange(self.num) * (5 - step if step < 5 else 9) / 100.0


def make_monitor(evidence: Evidence | None = None, **options) -> Monitor:
    evidence = evidence or make_evidence()
    return Monitor(evidence, TASK, Known(evidence), **options)
