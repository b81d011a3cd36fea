"""What solvers that train share: a run in chunks, its history, and the nominal that it leaves.

    run = Run(solver, trainer, problem, tasks, seed, checkpoint)
    while (progress := run.advance()) is not None: ...

After every chunk a few tasks show how far the policy is from pi_0, and a checkpoint is written. A
chunk that ends in numbers that are not finite is gone through again, to name what the MDP returned;
where the MDP is innocent training has diverged, and what was learned before is kept.

Shapes: N lanes, L steps of a segment, I iterations, C chunks.
"""

from __future__ import annotations

import abc
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import numpy as np

from swerve.arguments import positive_number
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.solvers.checkpoints import Checkpoint
from swerve.solvers.lanes import Lanes, check_lanes
from swerve.solvers.networks import from_arrays, to_arrays
from swerve.solvers.nonfinite import check_steps
from swerve.solvers.probe import Probe, Reading
from swerve.space import Task
from swerve.trajectory import Policy

NUM_CHUNKS = 40


class Progress(NamedTuple):
    """How training went up to the end of a chunk.

    Attributes:
      seconds: of training so far, without compiling and probes.
      num_steps: environment steps so far.
      kl: median KL over the tasks tried, nats.
      worst_kl: the largest.
      effective_share: median ESS, as a share of the trajectories.
      residual: median |beta r + log m - log pi + V(s') - V(s)| in the lanes, nats; 0 for pi_0 and
        its soft value. Of a look-ahead policy it is |(B V)(s) - V(s)|.
    """

    seconds: float
    num_steps: float
    kl: float
    worst_kl: float
    effective_share: float
    residual: float

    def __str__(self) -> str:
        """Return for example 'KL 0.84 nats  ESS 35 %  residual 0.12 nats'."""
        reading = Reading(self.kl, self.worst_kl, self.effective_share)
        return f"{reading}  residual {self.residual:.2g} nats"


class Info(Protocol):
    """How iterations went."""

    @property
    def residual(self) -> Any:
        """[I] the residual of each, see `Progress`."""
        ...


class Trainer(Protocol):
    """How a solver trains for a problem; its states are trees of arrays."""

    def initial_state(self) -> Any:
        """Return what training starts from."""
        ...

    def run(self, state: Any, num_iterations: int) -> tuple[Any, Info]:
        """Run iterations of training."""
        ...

    def policy_of(self, state: Any) -> Policy:
        """Return the policy that was learned; its leaves are the weights of one network."""
        ...

    def visited(self, state: Any) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        ...


class TrainingSolver(abc.ABC):
    """A solver that trains, in chunks of iterations of a segment in every lane.

    Subclasses are frozen dataclasses of settings, these among them.
    """

    name: str
    num_steps: int
    num_lanes: int
    segment: int
    learning_rate: float

    @abc.abstractmethod
    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return what trains for a problem."""

    @abc.abstractmethod
    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether training may end before its last step."""

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
          tasks: those on which KL and ESS are estimated; drawn if None.
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
            advance(len(run.history) * self.chunk_steps)
            before = run.history[-1].seconds if run.history else 0.0
            while not self.has_settled(run.history) and (now := run.advance()) is not None:
                rate = self.chunk_steps / (now.seconds - before) / 1000.0
                advance(self.chunk_steps, note=f"{rate:.0f} k steps/s  {now}")
                before = now.seconds
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
        from swerve.training_plot import plot_training

        return plot_training(self, path)


class Run:
    """A run of training that advances chunk by chunk, from its checkpoint if there is one.

    Args:
      solver: and its settings.
      trainer: of the solver.
      problem: what to learn.
      tasks: those on which KL and ESS are estimated; drawn if None.
      seed: of everything random.
      checkpoint: file that is written after every chunk and resumed from; None for neither.

    Raises:
      ValueError: if the checkpoint is of another run, or no episode can begin.
    """

    def __init__(
        self,
        solver: TrainingSolver,
        trainer: Trainer,
        problem: Problem,
        tasks: Task | None,
        seed: int,
        checkpoint: Path | None,
    ) -> None:
        check_lanes(problem, solver.num_lanes, seed)
        self._solver, self._problem = solver, problem
        self._trainer = trainer
        self._probe = Probe(problem, tasks)
        self._checkpoint = Checkpoint(checkpoint, problem, solver, seed)
        self._state = self._trainer.initial_state()
        self.history: list[Progress] = []
        arrays = self._checkpoint.load()
        if arrays is not None:
            self.history = [Progress(*row) for row in arrays.pop("history").tolist()]
            self._state = from_arrays(self._state, arrays)

    @property
    def policy(self) -> Policy:
        """What was learned so far."""
        return self._trainer.policy_of(self._state)

    def advance(self) -> Progress | None:
        """Train for a chunk; return how it went, or None where the run is over or diverged.

        Raises:
          ValueError: if the MDP returned a number that is not finite, or nothing was learned yet
            and training diverged.
        """
        if len(self.history) >= self._solver.num_chunks:
            return None
        train = self._train
        began = time.perf_counter()
        state, info = jax.block_until_ready(train(self._state))
        seconds = time.perf_counter() - began
        if not _is_finite(state):
            self._blame_mdp()
            self._diverged()
            return None
        self._state = state
        seconds += self.history[-1].seconds if self.history else 0.0
        num_steps = float((len(self.history) + 1) * self._solver.chunk_steps)
        residual = float(np.median(info.residual))
        reading = self._probe.read(self.policy)
        self.history.append(Progress(seconds, num_steps, *reading, residual))
        self._checkpoint.save(to_arrays(state) | {"history": np.array(self.history)})
        return self.history[-1]

    @cached_property
    def _train(self) -> Callable[[Any], tuple[Any, Info]]:
        """What trains for a chunk, compiled before the clock runs."""
        num_iterations = self._solver.chunk_iterations
        train = jax.jit(lambda state: self._trainer.run(state, num_iterations))
        return train.lower(self._state).compile()

    def _blame_mdp(self) -> None:
        """Go through the last chunk again; raise ValueError where the MDP is to blame for it."""
        state = self._state
        for _ in range(self._solver.chunk_iterations):
            if not _is_finite(state):
                return
            check_steps(self._problem, self._trainer.visited(state))
            state, _ = self._trainer.run(state, 1)

    def _diverged(self) -> None:
        """Raise ValueError where nothing was learned yet, else say that the last state is kept."""
        iteration = len(self.history) * self._solver.chunk_iterations
        text = (
            f"training diverged after {iteration} iterations: a weight is not finite, though "
            f"{type(self._problem.mdp).__name__} returned finite numbers. Check how large its "
            f"rewards and features are, or lower learning_rate from {self._solver.learning_rate}"
        )
        if not self.history:
            raise ValueError(text)
        warnings.warn(f"{text}. The network before that is kept", RuntimeWarning, stacklevel=5)


def _is_finite(state: Any) -> bool:
    """Return whether all numbers that training carries are finite."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
