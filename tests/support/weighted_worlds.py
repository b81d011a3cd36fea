"""Worlds of a few trajectories, all of them known, and samples of these."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class World(NamedTuple):
    """All M trajectories there are: log m exp(beta R), log pi, and what each enters."""

    log_target: np.ndarray
    log_proposal: np.ndarray
    violates: np.ndarray

    @property
    def log_partition(self) -> float:
        return math.log(np.exp(self.log_target).sum())

    @property
    def nominal(self) -> np.ndarray:
        return np.exp(self.log_target) / np.exp(self.log_target).sum()

    @property
    def avoid_probability(self) -> np.ndarray:
        return self.nominal @ ~self.violates

    @property
    def log_weight(self) -> np.ndarray:
        return self.log_target - self.log_proposal

    def sample(self, num: int, generator: np.random.Generator) -> np.ndarray:
        return generator.choice(len(self.log_target), num, p=np.exp(self.log_proposal))

    @property
    def bits(self) -> np.ndarray:
        return pack(self.violates)


def pack(violates: np.ndarray) -> np.ndarray:
    return np.packbits(violates, axis=-1, bitorder="little")


def make_world(seed: int, num: int = 40, num_hypotheses: int = 9, spread: float = 0.7) -> World:
    generator = np.random.default_rng(seed)
    log_target = generator.normal(2.0, 1.0, num)
    log_proposal = log_target + generator.normal(0.0, spread, num)
    log_proposal -= np.log(np.exp(log_proposal).sum())
    violates = generator.random((num, num_hypotheses)) < generator.uniform(0.3, 0.7, num_hypotheses)
    return World(log_target, log_proposal, violates)


def random_sample(
    generator: np.random.Generator, num: int = 60, num_hypotheses: int = 11
) -> tuple[np.ndarray, np.ndarray]:
    violates = generator.random((num, num_hypotheses)) < generator.random(num_hypotheses)
    return generator.normal(-100.0, 2.0, num), violates
