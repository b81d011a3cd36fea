"""Greedy selection worked out the slow way: everything is weighed anew for each pick."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from support.synthetic import make_demonstration, make_evidence, make_samples

from swerve import Inference, infer
from swerve.hypotheses.bits import unpack

NUM_TASKS, NUM_HYPOTHESES = 3, 12


def made_up(
    seed: int, tolerance: float, counted: float, num_trajectories: int, num_demonstrations: int = 7
) -> Inference:
    """An inference of random bits, weights, demonstrations, and tasks that some count for."""
    generator = np.random.default_rng(seed)
    samples = make_samples(num_trajectories, seed=seed)
    chance = generator.uniform(0.0, 0.5, NUM_HYPOTHESES)
    hits = generator.random((NUM_TASKS, num_trajectories, NUM_HYPOTHESES)) < chance
    hits[:, :, 1] = hits[:, :, 2]  # which nothing tells apart
    samples = samples._replace(violations=np.packbits(hits, axis=-1, bitorder="little"))
    start = infer(make_evidence(samples=samples), tolerance=tolerance)
    task_of = generator.integers(0, NUM_TASKS, num_demonstrations)
    return dataclasses.replace(
        start,
        demonstrations=tuple(make_demonstration(int(k)) for k in task_of),
        task_of=task_of,
        entered=generator.random((num_demonstrations, NUM_HYPOTHESES)) < 0.1,
        is_counted=generator.random((NUM_TASKS, NUM_HYPOTHESES)) < counted,
    )


class Plain:
    """Gains worked out by weighing all trajectories anew, one hypothesis after another."""

    def __init__(self, inference: Inference) -> None:
        self.inference, evidence = inference, inference.evidence
        self.bits = unpack(evidence.samples.violations, NUM_HYPOTHESES)
        self.log_share = np.zeros(NUM_TASKS)
        self.picked: list[int] = []

    def log_ratio(self, k: int, c: int) -> float:
        """log P(avoid c | avoid C) of a task, nats."""
        counted = self.inference.is_counted[k]
        if not counted[c]:
            return 0.0
        picked = [p for p in self.picked if counted[p]]
        if not picked:
            return self.inference.evidence.log_ratio[k, c]
        avoids = ~self.bits[k][:, picked].any(axis=1)
        if not avoids.any():
            return 0.0
        log_weight = self.inference.evidence.log_weight[k][avoids]
        weight = np.exp(log_weight - log_weight.max())
        share = weight @ ~self.bits[k][avoids, c] / weight.sum()
        return math.log(max(share, weight @ weight / weight.sum() ** 2))

    def term(self, d: int, hypotheses: list[int], log_share: float) -> float:
        """Return what a demonstration says of a set, nats."""
        eps, k = self.inference.tolerance, self.inference.task_of[d]
        entered = self.inference.entered[d] & self.inference.is_counted[k]
        enters = entered[hypotheses].any()
        if eps == 0.0:
            return -math.inf if enters else -log_share
        return math.log(eps + (0.0 if enters else (1.0 - eps) * math.exp(-log_share)))

    def gains(self) -> np.ndarray:
        """Return what each hypothesis gains, -inf where it may not be picked."""
        found = np.full(NUM_HYPOTHESES, -np.inf)
        for c in set(range(NUM_HYPOTHESES)) - set(self.picked):
            ratios = [self.log_ratio(k, c) for k in range(NUM_TASKS)]
            if self.inference.struck_out[c]:
                continue
            found[c] = sum(
                self.term(d, [*self.picked, c], float(self.log_share[k] + ratios[k]))
                - self.term(d, self.picked, float(self.log_share[k]))
                for d, k in enumerate(self.inference.task_of)
            )
        return found

    def add(self, c: int) -> None:
        self.log_share = self.log_share + [self.log_ratio(k, c) for k in range(NUM_TASKS)]
        self.picked.append(c)
