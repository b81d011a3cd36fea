"""Steps of greedy selection, worked out by sums over sets of hypotheses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from support.cases import STANDARD_ERRORS, entered_by, spread_of, weights_avoiding

from swerve import Demonstration, Evidence, Inference, Task, greedy, infer, sample
from swerve.evidence import estimators
from swerve.solvers.exact.enumeration import EnumerationNominal
from swerve.solvers.exact.tabular import TableNominal


class Choice(NamedTuple):
    """A step of greedy selection worked out by sums over sets.

    Attributes:
      gain: [H] nats a demonstration; -inf where ruled out.
      log_partition: [K] log Z_C of each task with the best one in force.
    """

    gain: np.ndarray
    log_partition: np.ndarray

    @property
    def best(self) -> int:
        return int(self.gain.argmax())

    @property
    def margin(self) -> float:
        """By how much the best beats the next, nats."""
        return float(np.diff(np.sort(self.gain)[-2:])[0])


def choose(
    nominal: EnumerationNominal | TableNominal, start: Inference, picked: Sequence[int]
) -> Choice:
    """Choose one more on top of some, given which tasks there are and what was entered."""
    sets = [list(picked), *([*picked, c] for c in range(start.entered.shape[1]))]
    tasks = zip(*start.evidence.tasks, strict=True)
    values = np.array([nominal.log_partition(Task(*task), sets) for task in tasks])
    gain = start.task_counts @ (values[:, :1] - values[:, 1:]) / start.task_counts.sum()
    gain[start.entered.any(axis=0) | ~np.isfinite(gain)] = -np.inf
    gain[list(picked)] = -np.inf
    return Choice(gain, values[:, 1 + int(gain.argmax())])


def sampled_demonstrations(
    nominal: EnumerationNominal | TableNominal, tasks: Task, num: int
) -> list[Demonstration]:
    """Return demonstrations sampled from the exact distribution of a problem, some of each task."""
    evidence = sample(nominal, tasks)
    length, mdp = evidence.samples.length, nominal.problem.mdp
    made = []
    for k, task in enumerate(zip(*evidence.tasks, strict=True)):
        for i in range(num):
            states = evidence.samples.kept[k, i, : length[k, i] + 1]
            change = np.diff(states, axis=0)[:, -len(mdp.action_names) :]
            made.append(Demonstration(f"{k}-{i}", states, Task(*task), actions=change / mdp.dt))
    return made


def gain_error(start: Inference, picked: Sequence[int], c: int) -> float:
    """Return the standard error of the gain of hypothesis c on top of some, nats."""
    variance = 0.0
    for k, share in enumerate(start.task_counts / start.task_counts.sum()):
        weight = estimators.normalise(weights_avoiding(start.evidence, k, picked))
        avoids = ~entered_by(start.evidence, k)[:, c]
        probability = weight @ avoids
        variance += (share / probability) ** 2 * (weight**2 @ (avoids - probability) ** 2)
    return math.sqrt(variance)


def assert_greedy_agrees(
    evidence: Evidence,
    nominal: EnumerationNominal | TableNominal,
    made: Sequence[Demonstration],
    least: int,
) -> None:
    """The same picks in order for as long as sampling can tell them apart, `least` at least."""
    start = infer(evidence, made)
    agreed: list[int] = []
    exact = infer(sample(nominal, evidence.tasks), made)
    truth = greedy(exact, nominal, threshold=0.02)
    for pick, exactly in zip(greedy(start, threshold=0.02), truth, strict=False):
        choice = choose(nominal, start, agreed)
        assert exactly.gain == pytest.approx(choice.gain.max(), abs=1e-9)
        error = STANDARD_ERRORS * gain_error(start, agreed, choice.best)
        if choice.margin < 2.0 * error:
            break
        assert pick.hypothesis == exactly.hypothesis == choice.best
        assert pick.gain == pytest.approx(choice.gain.max(), abs=error + 1e-3)
        agreed.append(pick.hypothesis)
        for k, value in enumerate(choice.log_partition):
            spread = STANDARD_ERRORS * spread_of(weights_avoiding(evidence, k, agreed))
            assert pick.log_partition[k] == pytest.approx(value, abs=spread + 1e-3)
    assert len(agreed) >= least
