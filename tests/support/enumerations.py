"""Problems that are enumerated."""

from __future__ import annotations

import numpy as np
from support.reference import short_cart

from swerve import Problem, Task, learn
from swerve.evidence.exact import ExactAnswer
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal

STANDARD_ERRORS = 4.5
FAST = Task(np.array([0.9, 0.6]), np.array([-0.5, 0.0]))  # a third of the time off the track


def nominal_of(problem: Problem) -> EnumerationNominal:
    nominal = learn(problem, Enumeration())
    assert isinstance(nominal, EnumerationNominal)
    return nominal


def answer(problem: Problem, task: Task, seed: int = 0) -> ExactAnswer:
    return nominal_of(problem).answer(task, np.random.default_rng(seed), lambda share: None)


CART_NOMINAL = nominal_of(short_cart())  # for all tests, so that its steps are compiled once
