"""Follow the belief along a finished demonstration: a monitor observes state after state.

    P_t(c) ~ prior(c) L_t(c),    t = 0, ..., L - 1, and once more at the end

Shapes: L states, H hypotheses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.monitoring.monitor import Monitor


class Course(NamedTuple):
    """The belief after each state of a demonstration, and at its end.

    Attributes:
      evidence: evidence that the monitor used.
      demonstration: demonstration that was followed.
      times: [L + 1] time of each state [s], one step of the model apart where the demonstration has
        no times; the last number is the time of the end.
      none: [L + 1] probability that there is no constraint.
      hypotheses: [L + 1, H] probability of each hypothesis.
      log_likelihood: [L + 1, H] ratio against no constraint, nats; -inf where struck out.
      entered: [L + 1, H] True from the first state on that enters a hypothesis.
    """

    evidence: Evidence
    demonstration: Demonstration
    times: np.ndarray
    none: np.ndarray
    hypotheses: np.ndarray
    log_likelihood: np.ndarray
    entered: np.ndarray

    def __repr__(self) -> str:
        """Return the demonstration's name and its number of states, in one line."""
        return f"<Course of {self.demonstration.name}: {len(self.times) - 1} states>"


def follow(monitor: Monitor, demonstration: Demonstration) -> Course:
    """Let a new monitor observe a finished demonstration, state by state, to the end.

    Args:
      monitor: monitor that has not observed any state.
      demonstration: demonstration of the monitor's task.

    Raises:
      ValueError: if the monitor has observed states, or refuses a state or a time (see
        `Monitor.observe`).
    """
    if not monitor.is_new:
        raise ValueError("monitor: expected one that has seen no state yet: make a new one")
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
