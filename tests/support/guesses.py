"""Policies that are wrong on purpose, and nominals made of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from swerve import Problem
from swerve.simulation.policies import LookAhead


class Guess(LookAhead):
    """Looks ahead with a value that somebody made up: a share of what the goal's distance says."""

    problem: Problem = eqx.field(static=True)
    weight: float = 0.0

    def value(self, state, step, goal):
        return self.weight * jnp.sum(self.problem.mdp.space.difference(state, goal) ** 2)


@dataclass(frozen=True, eq=False)
class Guessed:
    """The nominal of a guess."""

    problem: Problem
    weight: float = 0.0
    solver = dataclasses.make_dataclass("Guessing", [])()

    def arrays(self) -> dict[str, np.ndarray]:
        return {}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[Guess]:
        yield from (Guess(self.problem, self.weight) for _ in goals)


@dataclasses.dataclass(frozen=True, eq=False)
class Fixed:
    """A nominal of one policy."""

    policy: Any
    solver = dataclasses.make_dataclass("Fixing", [])()

    @property
    def problem(self) -> Problem:
        return self.policy.problem

    def arrays(self) -> dict[str, np.ndarray]:
        return {}

    def policies(self, goals: np.ndarray, advance=lambda share: None):
        yield from (self.policy for _ in goals)
