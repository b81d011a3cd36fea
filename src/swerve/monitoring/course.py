"""How belief moved while a demonstration went on: a monitor led along a finished one.

    P_t(c) ~ prior(c) L_t(c),    t = 0, ..., L - 1, and once more when it has ended

Shapes: L states, H hypotheses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.monitoring.monitor import Monitor


class Course(NamedTuple):
    """What was believed after each state of a demonstration, and at its end.

    Attributes:
      evidence: what it rests on.
      demonstration: that was followed.
      times: [L + 1] time of each state [s], by the model's steps where none are known; the last is
        that of the end.
      none: [L + 1] probability that there is no constraint.
      hypotheses: [L + 1, H] probability of each.
      log_likelihood: [L + 1, H] ratio against no constraint, nats; -inf where struck out.
      entered: [L + 1, H] True from the state on that entered a hypothesis.
    """

    evidence: Evidence
    demonstration: Demonstration
    times: np.ndarray
    none: np.ndarray
    hypotheses: np.ndarray
    log_likelihood: np.ndarray
    entered: np.ndarray

    def __repr__(self) -> str:
        """Return what it is of, in one line."""
        return f"<Course of {self.demonstration.name}: {len(self.times) - 1} states>"


def follow(monitor: Monitor, demonstration: Demonstration) -> Course:
    """Lead a new monitor along a finished demonstration, state by state, and to its end.

    Args:
      monitor: that has seen nothing yet.
      demonstration: of its task.

    Raises:
      ValueError: if the monitor has seen states, or a state or a time cannot be taken in, see
        `Monitor.observe`.
    """
    if not monitor.is_new:
        raise ValueError("monitor: expected one that has seen no state yet: make another")
    times = demonstration.times
    beliefs = [
        monitor.observe(state, None if times is None else float(times[k] - times[0]))
        for k, state in enumerate(demonstration.states)
    ]
    beliefs.append(monitor.finish())
    entered = np.zeros((len(beliefs), len(beliefs[0].hypotheses)), bool)
    for k, belief in enumerate(beliefs):
        entered[k:, list(belief.entered)] = True
    steps = np.arange(len(beliefs) - 1) * monitor.evidence.problem.dt
    known = steps if times is None else times - times[0]
    return Course(
        monitor.evidence,
        demonstration,
        np.append(known, known[-1]),
        np.array([belief.none for belief in beliefs]),
        np.array([belief.hypotheses for belief in beliefs]),
        np.array([belief.log_likelihood for belief in beliefs]),
        entered,
    )
