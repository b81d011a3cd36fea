"""Trainings that take seconds, and histories that are made up."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import short_pendulum

from swerve import PPO, Problem, SoftValue, Task, learn
from swerve.solvers.trained.probe import Reading
from swerve.solvers.trained.run import Run as TrainingRun
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver

SOLVERS = {
    "ppo": PPO(num_steps=20_480, num_lanes=16, segment=8, num_minibatches=2, width=8),
    "soft-value": SoftValue(num_steps=8_000, num_lanes=16, segment=8, width=8),
}
READ = Reading(1.0, 5.0, 0.3)
each_solver = pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)


def new_run(
    solver: TrainingSolver,
    problem: Problem,
    seed: int,
    path: Path | None,
    tasks: Task | None = None,
) -> TrainingRun:
    return TrainingRun(solver, solver.trainer(problem, seed), problem, tasks, seed, path)


@cache
def trained(solver: TrainingSolver) -> TrainedNominal:
    nominal = learn(short_pendulum(), solver, seed=3)
    assert isinstance(nominal, TrainedNominal)
    return nominal


def with_history(**columns: Any) -> TrainedNominal:
    """A nominal whose training is made up."""
    share = np.linspace(0.1, 1.0, 10)
    made = {
        "seconds": 500.0 * share,
        "num_steps": 2e7 * share,
        "kl": 0.3 / share,
        "worst_kl": 0.9 / share,
        "effective_share": 0.8 * share,
        "residual": 0.1 / share,
    }
    history = np.stack([np.broadcast_to(x, 10) for x in (made | columns).values()], axis=1)
    return TrainedNominal(short_pendulum(), PPO(), lambda *_: jnp.zeros(5), history)
