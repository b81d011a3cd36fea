"""Evidence made of known trajectories with known weights: nothing is simulated.

Shapes: K tasks, N trajectories of each, H hypotheses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from brute_force.reference.answers import Weighted
from brute_force.reference.cases import Case
from brute_force.reference.worlds import SmoothWorld
from brute_force.translation import hypotheses_of
from support.synthetic import make_evidence, make_record

from swerve import StateSpace, Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import Samples
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.problem.record import ProblemRecord

NUM = 400  # trajectories of a task


class Sampled(NamedTuple):
    """Trajectories sampled by the reference, with replacement.

    Attributes:
      rows: [K, N] their numbers among all trajectories of their task.
      log_probability: [K, N] nats.
      reward: [K, N].
      length: [K, N].
      entered: [K, N, H].
    """

    rows: np.ndarray
    log_probability: np.ndarray
    reward: np.ndarray
    length: np.ndarray
    entered: np.ndarray

    def log_weight(self, case: Case, beta: float) -> np.ndarray:
        """Return beta R + log m - log pi [K, N], nats."""
        measure = np.log(len(case.world.actions)) if case.measure == "uniform" else 0.0
        return beta * self.reward - measure * self.length - self.log_probability

    def tasks(self, case: Case, beta: float) -> list[Weighted]:
        """Return the trajectories of each task with their weights."""
        pairs = zip(self.log_weight(case, beta), self.entered, strict=True)
        return [Weighted(*pair, num=NUM, is_sample=True) for pair in pairs]


def sampled(case: Case, seed: int) -> Sampled:
    """Sample trajectories from a distribution near pi_0."""
    generator, columns = np.random.default_rng([seed, 2]), []
    for paths, log_weight, entered in zip(case.paths, case.log_weights, case.entered, strict=True):
        log_chance = 0.8 * log_weight + generator.normal(0.0, 0.2, len(log_weight))
        chance = np.exp(log_chance - log_chance.max())
        chance /= chance.sum()
        rows = generator.choice(len(chance), NUM, p=chance)
        found = (rows, np.log(chance[rows]), paths.reward[rows], paths.length[rows], entered[rows])
        columns.append(found)
    return Sampled(*map(np.stack, zip(*columns, strict=True)))


def record_of(case: Case) -> ProblemRecord:
    """Return the problem of a case as plain data, without a model."""
    axes = case.world.axes
    places = np.concatenate([one.states.reshape(-1, len(axes.names)) for one in case.paths])
    bounds = np.stack([places.min(axis=0) - 2.0, places.max(axis=0) + 2.0], axis=1)
    hypotheses = hypotheses_of(case)
    if not isinstance(hypotheses, HypothesisSet):
        hypotheses = ConstraintHypotheses(hypotheses)
    is_state = isinstance(case.world, SmoothWorld) and case.world.goals_are_states
    return make_record(
        space=StateSpace(axes.names, axes.angles, bounds),
        action_names=case.world.action_names,
        goal_names=axes.names if is_state else ("mark",)[: case.goals.shape[1]],
        goal_is_last_state=is_state,
        num_actions=len(case.world.actions),
        num_steps=case.world.num_steps,
        dt=case.world.dt,
        hypotheses=hypotheses,
        beta=case.beta,
        measure=case.measure,
        between_states=case.between,
    )


def evidence_of(
    case: Case, sample: Sampled, record: ProblemRecord, method: str = "importance"
) -> Evidence:
    """Return the library's evidence of sampled trajectories."""
    shape = sample.reward.shape
    states = [one.states[rows[:2]] for one, rows in zip(case.paths, sample.rows, strict=True)]
    samples = Samples(
        total_reward=sample.reward,
        log_probability=sample.log_probability,
        length=sample.length,
        log_correction=np.zeros(shape),
        ancestor=np.broadcast_to(np.arange(NUM), shape),
        violations=np.packbits(sample.entered, axis=-1, bitorder="little"),
        kept=np.stack(states),
        soft_value=np.full(shape[0], np.nan),
    )
    return make_evidence(record, samples, Task(case.starts, case.goals), method)
