"""What solvers that train share: settings, learning in chunks, and the nominal that it leaves.

Shapes: N lanes, L steps of a segment, C chunks.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from swerve.base.arguments import positive_number, whole_number
from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.networks import from_arrays, to_arrays
from swerve.solvers.trained.run import Progress, Run, Trainer

NUM_CHUNKS = 40


class TrainingSolver(abc.ABC):
    """A solver that trains, in chunks of iterations of a segment in every lane.

    Subclasses are frozen dataclasses of settings, these among them.
    """

    name: str
    num_steps: int
    num_lanes: int
    segment: int
    explore: float
    num_epochs: int
    num_minibatches: int
    learning_rate: float
    width: int
    loss_scale: float

    def __post_init__(self) -> None:
        """Check what all of them have."""
        self.check_numbers(
            whole=("num_steps", "num_lanes", "segment", "num_epochs", "num_minibatches", "width"),
            shares=("explore",),
            positive=("learning_rate", "loss_scale"),
        )

    def check_numbers(
        self,
        *,
        whole: Sequence[str] = (),
        shares: Sequence[str] = (),
        positive: Sequence[str] = (),
    ) -> None:
        """Raise ValueError where a setting is no whole number, no number in [0, 1], or not > 0."""
        solver = type(self).__name__
        for field in whole:
            whole_number(getattr(self, field), f"{solver}: {field}", 1)
        for field in shares:
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(
                    f"{solver}: {field}: expected a number from 0 to 1, got {getattr(self, field)}"
                )
        for field in positive:
            positive_number(getattr(self, field), f"{solver}: {field}")

    def check_divides(self, part: str, whole: str) -> None:
        """Raise ValueError unless one setting divides another."""
        first, second = getattr(self, part), getattr(self, whole)
        if second % first:
            raise ValueError(
                f"{type(self).__name__}: {part}: expected a divisor of {whole}, {second}, got "
                f"{first}"
            )

    @abc.abstractmethod
    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return what trains for a problem."""

    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether training may go to its end: not before its time, unless overridden."""
        return False

    def at_beta(self, nominal: TrainedNominal, beta: float) -> TrainedNominal:
        """Return what was learned for another beta too; solvers that can override this.

        Raises:
          ValueError: if that is not so.
        """
        raise ValueError(
            f"beta: the {self.name} solver learns for one alone, {nominal.problem.beta:g}: use "
            f"swerve.sample(nominal, tasks, beta={beta:g})"
        )

    def covers(self, nominal: TrainedNominal, beta: float) -> bool:
        """Return whether `at_beta` knows a beta."""
        return False

    @property
    def chunk_iterations(self) -> int:
        """Iterations between two checkpoints."""
        return max(1, round(self.num_steps / (self.num_lanes * self.segment * NUM_CHUNKS)))

    @property
    def chunk_steps(self) -> int:
        """Environment steps between two checkpoints."""
        return self.chunk_iterations * self.num_lanes * self.segment

    @property
    def num_chunks(self) -> int:
        """Chunks of a run: about NUM_CHUNKS."""
        return max(1, round(self.num_steps / self.chunk_steps))

    @property
    def num_iterations(self) -> int:
        """Iterations of a whole run."""
        return self.num_chunks * self.chunk_iterations

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> TrainedNominal:
        """Train, or go on training from a checkpoint, and return the nominal distribution.

        Args:
          problem: what to learn.
          tasks: as for `sample`: those on which KL and ESS are estimated; drawn if None.
          seed: of everything random.
          progress: whether to show a bar with steps per second, KL, ESS and residual.
          checkpoint: file that is written after every chunk and resumed from; None for neither.

        Raises:
          ValueError: if the checkpoint is of another run, the MDP returned a number that is not
            finite, training diverged from the beginning, or no episode that the MDP draws can
            begin.
        """
        return self.train(self.trainer(problem, seed), problem, tasks, seed, progress, checkpoint)

    def train(
        self,
        trainer: Trainer,
        problem: Problem,
        tasks: Task | None,
        seed: int,
        progress: bool,
        checkpoint: Path | None,
    ) -> TrainedNominal:
        """Train by a trainer of this solver's, as `learn` does."""
        run = Run(self, trainer, problem, tasks, seed, checkpoint)
        with progress_bar("training", self.num_chunks * self.chunk_steps, progress) as advance:
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
        """Do nothing: there is no problem that it could not try."""

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> TrainedNominal:
        """Return the nominal distribution whose `arrays` were stored."""
        weights = dict(arrays)
        history = weights.pop("history")
        trainer = self.trainer(problem, 0)
        like = eqx.filter_eval_shape(lambda: trainer.policy_of(trainer.initial_state()))
        return TrainedNominal(problem, self, from_arrays(like, weights), history)


@dataclass(frozen=True, eq=False)
class TrainedNominal:
    """pi_0 as a policy that was trained and takes the goal as an input.

    Attributes:
      policy: of all goals.
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
        """Return the same for another beta, where one network was trained for a span of them.

        Raises:
          ValueError: if the solver is not `SoftValue`, or beta is beyond its `beta_span`.
        """
        return self.solver.at_beta(self, positive_number(beta, "beta"))

    def covers(self, beta: float) -> bool:
        """Return whether `at_beta` knows a beta."""
        return self.solver.covers(self, beta)

    def plot_training(self, path: str | Path | None = None) -> Any:
        """Draw KL, ESS and residual against the time and the steps of training.

        Args:
          path: a file to write (its suffix tells the format), or None.

        Returns:
          The matplotlib Figure.
        """
        from swerve.solvers.trained.history_plot import plot_training

        return plot_training(self, path)
