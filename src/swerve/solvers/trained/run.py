"""Run training chunk by chunk: keep its checkpoint and history, and find the cause of a NaN.

After every chunk a few tasks show how far the policy is from pi_0, and a checkpoint is written. A
chunk that ends in numbers that are not finite is repeated step by step, to name the method of the
MDP that returned them. If the MDP returned finite numbers, training has diverged, and the state
before the chunk is kept. If the KL has risen far above its least value, training has diverged too,
and the state of the least KL is kept. When the solver says that the KL has settled, the run goes on
from its best state to the last part of its schedule: the fall of the learning rate removes the
noise.

Shapes: N lanes, L steps of a segment, I iterations.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from swerve.base import schema
from swerve.base.space import Task
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_tasks
from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.checkpoints import Checkpoint
from swerve.solvers.trained.lanes import check_lanes
from swerve.solvers.trained.networks import from_arrays, to_arrays
from swerve.solvers.trained.nonfinite import check_steps
from swerve.solvers.trained.probe import Probe, Progress, check_history
from swerve.solvers.trained.settings import TrainingSettings
from swerve.solvers.trained.trainers import SegmentInfo, Trainer

FAR = 1.0  # nats: a policy with a larger KL is far from pi_0
RISEN = 3.0  # training has diverged where the KL is above RISEN times its least value, plus FAR
NUM_RISEN = 5  # chunks in a row with such a KL; at the end of a run one chunk is enough
NEARER = 0.9  # share of the first KL: a run that ends above it has come no nearer to pi_0
LAST_PART = 0.3  # share of the schedule that a run goes on to when its KL has settled
CALLER = 6  # frames from a warning here to the call of `Solver.learn`, which the warning names


class Run:
    """A run of training that advances chunk by chunk, from its checkpoint if there is one.

    Attributes:
      history: how training went up to the end of each chunk.

    Args:
      solver: settings of the solver.
      trainer: trainer of the solver.
      problem: problem to learn.
      tasks: tasks on which KL and ESS are estimated; sampled from the MDP if None. A run that goes
        on from a checkpoint keeps the tasks that it began with.
      seed: seed of everything random.
      checkpoint: file that is written after every chunk, and from which the run goes on; None to
        write and read no file.

    Raises:
      ValueError: if the checkpoint is of another run, or no episode can begin.
      StoreError: if the checkpoint is altered, or holds what no checkpoint holds.
    """

    def __init__(
        self,
        solver: TrainingSettings,
        trainer: Trainer,
        problem: Problem,
        tasks: Task | None,
        seed: int,
        checkpoint: Path | None,
    ) -> None:
        check_lanes(problem, solver.num_lanes, seed)
        self._solver, self._problem = solver, problem
        self._trainer = trainer
        self._checkpoint = Checkpoint(checkpoint, problem, solver, seed, trainer.imitated)
        self._state = self._trainer.initial_state()
        self.history: list[Progress] = []
        self._best = self._state  # the state of the least KL
        arrays = self._checkpoint.load()
        if arrays is not None:
            assert checkpoint is not None
            with schema.contents(checkpoint):
                tasks = self._restore(arrays)
        self._probe = Probe(problem, tasks)

    def _restore(self, arrays: dict[str, np.ndarray]) -> Task:
        """Take up the states and the history of a checkpoint; return its tasks.

        Raises:
          ValueError: if the arrays are not those of a checkpoint; also other errors where an array
            is missing.
        """
        tasks = checked_tasks(self._problem, Task(arrays.pop("start"), arrays.pop("goal")))
        history = arrays.pop("history")
        check_history(history)
        self.history = [Progress(*row) for row in history.tolist()]
        self._state, self._best = (
            from_arrays(
                self._state,
                {k.removeprefix(at): x for k, x in arrays.items() if k.startswith(at)},
            )
            for at in ("state/", "best/")
        )
        if not 0 <= self.num_done <= self._solver.num_chunks:
            raise ValueError(f"{self.num_done} of {self._solver.num_chunks} chunks are done")
        return tasks

    @property
    def policy(self) -> Policy:
        """Policy that was learned so far."""
        return self._trainer.policy_of(self._state)

    @property
    def num_done(self) -> int:
        """Chunks of the schedule that are done or were skipped."""
        return int(self._state.iteration) // self._solver.chunk_iterations

    def advance(self) -> Progress | None:
        """Train for a chunk; return how it went, or None where the run is over or diverged.

        If the KL has settled, the chunk is the first of the last part of the schedule.

        Raises:
          ValueError: if the MDP returned a number that is not finite, or training
            diverged before anything was learned.
        """
        self._skip_if_settled()
        is_over = self.num_done >= self._solver.num_chunks
        if self._has_risen(1 if is_over else NUM_RISEN):
            self._state = self._best
            self._warn_of_rise()
            return None
        if is_over:
            self._warn_of_standstill()
            return None
        train = self._train
        began = time.perf_counter()
        state, info = jax.block_until_ready(train(self._state))
        seconds = time.perf_counter() - began
        if not _is_finite(state):
            self._check_mdp()
            self._keep_last()
            return None
        self._state = state
        seconds += self.history[-1].seconds if self.history else 0.0
        num_steps = float((len(self.history) + 1) * self._solver.chunk_steps)
        residual = float(np.median(info.residual))
        reading = self._probe.read(self._trainer.probed(state))
        if reading.kl <= min((before.kl for before in self.history), default=math.inf):
            self._best = state
        self.history.append(Progress(seconds, num_steps, *reading, residual))
        self._checkpoint.save(self._arrays())
        return self.history[-1]

    def _skip_if_settled(self) -> None:
        """If the KL has settled, move the best state on to the last part of the schedule."""
        solver = self._solver
        first = round((1.0 - LAST_PART) * solver.num_chunks)
        if self.num_done < first and solver.has_settled(self.history):
            self._state = self._trainer.at_iteration(self._best, first * solver.chunk_iterations)

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a checkpoint: states, history and tasks."""
        states = {"state": self._state, "best": self._best}
        return {
            f"{at}/{name}": array
            for at, state in states.items()
            for name, array in to_arrays(state).items()
        } | {"history": np.array(self.history), **self._probe.tasks._asdict()}

    @cached_property
    def _train(self) -> Callable[[Any], tuple[Any, SegmentInfo]]:
        """Function that trains for a chunk, compiled before the clock runs."""
        num_iterations = self._solver.chunk_iterations
        train = jax.jit(lambda state: self._trainer.run(state, num_iterations))
        return train.lower(self._state).compile()

    def _check_mdp(self) -> None:
        """Repeat the last chunk, and raise ValueError if the MDP returned a bad number in it."""
        state = self._state
        for _ in range(self._solver.chunk_iterations):
            if not _is_finite(state):
                return
            check_steps(self._problem, self._trainer.visited(state))
            state, _ = self._trainer.run(state, 1)

    def _has_risen(self, num_chunks: int) -> bool:
        """Return whether the KL of each of the last chunks is far above the least KL."""
        kl = [progress.kl for progress in self.history]
        highest = RISEN * min(kl, default=math.inf) + FAR
        return len(kl) >= num_chunks and min(kl[-num_chunks:]) > highest

    def _warn_of_rise(self) -> None:
        """Warn that the KL has risen, and say which state is kept."""
        kl = [progress.kl for progress in self.history]
        warnings.warn(
            f"training diverged: the KL rose to {kl[-1]:.2g} nats after {len(kl)} chunks. The "
            f"network of the least KL, {min(kl):.2g} nats after {1 + int(np.argmin(kl))} chunks, "
            f"is kept. Lower learning_rate from {self._solver.learning_rate}",
            RuntimeWarning,
            stacklevel=CALLER,
        )

    def _warn_of_standstill(self) -> None:
        """Warn if a whole run has come no nearer to pi_0."""
        kl = [progress.kl for progress in self.history]
        if len(kl) >= NUM_RISEN and FAR < NEARER * kl[0] <= kl[-1] < math.inf:
            warnings.warn(
                f"training came no nearer to pi_0: KL {kl[0]:.2g} nats after one chunk and "
                f"{kl[-1]:.2g} after {len(kl)}. Train longer than num_steps="
                f"{self._solver.num_steps:g}, or change learning_rate from "
                f"{self._solver.learning_rate}",
                RuntimeWarning,
                stacklevel=CALLER,
            )

    def _keep_last(self) -> None:
        """Warn that training diverged; raise ValueError if no finite state can be kept."""
        iteration = len(self.history) * self._solver.chunk_iterations
        text = (
            f"training diverged after {iteration} iterations: a weight is not finite, though "
            f"{type(self._problem.mdp).__name__} returned finite numbers. Check how large its "
            f"rewards and features are, or lower learning_rate from {self._solver.learning_rate}"
        )
        if not self.history:
            raise ValueError(text)
        warnings.warn(f"{text}. The network before that is kept", RuntimeWarning, stacklevel=CALLER)


def _is_finite(state: Any) -> bool:
    """Return whether all numbers of a state of training are finite."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
