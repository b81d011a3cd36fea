"""Train a solver in chunks, and hold the nominal distribution that training leaves.

Shapes: C chunks.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from swerve.base.arguments import positive_number
from swerve.base.progress import progress_bar
from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy
from swerve.solvers.base import LearnOptions, Solver
from swerve.solvers.trained.networks import from_arrays, to_arrays
from swerve.solvers.trained.probe import check_history
from swerve.solvers.trained.run import Run
from swerve.solvers.trained.settings import TrainingSettings
from swerve.solvers.trained.trainers import Trainer


class TrainingSolver(TrainingSettings, Solver["TrainedNominal"]):
    """A solver that trains in chunks of iterations; an iteration is a segment in every lane."""

    @abc.abstractmethod
    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return a trainer for a problem."""

    def at_beta(self, nominal: TrainedNominal, beta: float) -> TrainedNominal:
        """Return the nominal distribution for another beta; solvers of many betas override this.

        Raises:
          ValueError: if the nominal distribution was not learned for this beta.
        """
        raise ValueError(
            f"beta: the {self.name} solver learns for one beta alone, {nominal.problem.beta:g}: "
            f"use swerve.sample(nominal, tasks, beta={beta:g})"
        )

    def covers(self, nominal: TrainedNominal, beta: float) -> bool:
        """Return whether `at_beta` gives a nominal distribution for a beta."""
        return False

    def _learn(self, problem: Problem, options: LearnOptions) -> TrainedNominal:
        return self.train(self.trainer(problem, options.seed), problem, options)

    def train(self, trainer: Trainer, problem: Problem, options: LearnOptions) -> TrainedNominal:
        """Train by a trainer of this solver, or go on from a checkpoint, as `learn` does."""
        tasks, seed, progress, checkpoint = options
        with progress_bar("training", self.num_chunks * self.chunk_steps, progress) as advance:
            run = Run(self, trainer, problem, tasks, seed, checkpoint)
            advance(run.num_done * self.chunk_steps)
            done, before = run.num_done, run.history[-1].seconds if run.history else 0.0
            while (now := run.advance()) is not None:
                rate = self.chunk_steps / (now.seconds - before) / 1000.0
                advance(
                    (run.num_done - done) * self.chunk_steps, note=f"{rate:.0f} k steps/s  {now}"
                )
                done, before = run.num_done, now.seconds
        return TrainedNominal(problem, self, run.policy, np.array(run.history))

    def check(self, problem: Problem) -> None:
        """Accept every problem: training can be tried on any."""

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> TrainedNominal:
        """Rebuild the nominal distribution whose `arrays` were stored."""
        weights = dict(arrays)
        history = weights.pop("history")
        check_history(history)
        trainer = self.trainer(problem, 0)
        like = trainer.policy_of(jax.eval_shape(trainer.initial_state))
        return TrainedNominal(problem, self, from_arrays(like, weights), history)


@dataclass(frozen=True, eq=False)
class TrainedNominal:
    """pi_0 as a policy that was trained and takes the goal as an input.

    Attributes:
      problem: problem that was learned.
      solver: solver that learned the problem.
      policy: policy of all goals.
      history: [C, 6] how training went, a `Progress` each row.
    """

    problem: Problem
    solver: TrainingSolver
    policy: Policy
    history: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the weights of the policy's network, and how training went."""
        return to_arrays(self.policy) | {"history": self.history}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[Policy]:
        """Yield the same policy for each goal."""
        for _ in goals:
            advance(1.0)
            yield self.policy

    def at_beta(self, beta: float) -> TrainedNominal:
        """Return the nominal distribution for another beta, if the network was trained for it.

        Raises:
          ValueError: if the solver is not `SoftValue`, or beta is outside its `beta_span`.
        """
        return self.solver.at_beta(self, positive_number(beta, "beta"))

    def covers(self, beta: float) -> bool:
        """Return whether the network was trained for a beta, so that `at_beta` can be called."""
        return self.solver.covers(self, beta)

    def plot_training(self, path: str | Path | None = None) -> Any:
        """Draw KL, ESS and residual against the time and the steps of training.

        Args:
          path: a file to write, whose suffix tells the format, or None.

        Returns:
          The matplotlib Figure.
        """
        from swerve.solvers.trained.history_plot import plot_training  # needs matplotlib

        return plot_training(self, path)
