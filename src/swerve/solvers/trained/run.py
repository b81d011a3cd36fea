"""A run of training, chunk by chunk: its checkpoint, its history, and whose fault a NaN is.

After every chunk a few tasks show how far the policy is from pi_0, and a checkpoint is written. A
chunk that ends in numbers that are not finite is gone through again, to name what the MDP returned;
where the MDP is innocent training has diverged, and what was learned before is kept. Where the KL
has risen far above the least that there was it has diverged too, and the state of the least KL is
kept. Where the solver says that the KL has settled, the run goes on from its best state to the last
part of its schedule: it is the fall of the learning rate that takes the noise out of what was
learned.

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

from swerve.base.space import Task
from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.checkpoints import Checkpoint
from swerve.solvers.trained.lanes import check_lanes
from swerve.solvers.trained.networks import from_arrays, to_arrays
from swerve.solvers.trained.nonfinite import check_steps
from swerve.solvers.trained.probe import Probe, Progress
from swerve.solvers.trained.settings import TrainingSettings
from swerve.solvers.trained.trainers import SegmentInfo, Trainer

FAR = 1.0  # nats: KL of a policy that is hardly pi_0
RISEN = 3.0  # times the least KL, FAR on top: beyond, training has diverged
NUM_RISEN = 5  # chunks in a row; one at the end
NEARER = 0.9  # times the first KL: a run that ends above it has come no nearer to pi_0
LAST_PART = 0.3  # of the schedule: what a run that has settled goes on with
CALLER = 6  # frames from a warning here to the call of `Solver.learn`, which the warning names


class Run:
    """A run of training that advances chunk by chunk, from its checkpoint if there is one.

    Args:
      solver: and its settings.
      trainer: of the solver.
      problem: what to learn.
      tasks: those on which KL and ESS are estimated; drawn if None. A run that goes on keeps those
        that it began with.
      seed: of everything random.
      checkpoint: file that is written after every chunk and resumed from; None for neither.

    Raises:
      ValueError: if the checkpoint is of another run, or no episode can begin.
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
            tasks = Task(arrays.pop("start"), arrays.pop("goal"))
            self.history = [Progress(*row) for row in arrays.pop("history").tolist()]
            self._state, self._best = (
                from_arrays(
                    self._state,
                    {k.removeprefix(at): x for k, x in arrays.items() if k.startswith(at)},
                )
                for at in ("state/", "best/")
            )
        self._probe = Probe(problem, tasks)

    @property
    def policy(self) -> Policy:
        """What was learned so far."""
        return self._trainer.policy_of(self._state)

    @property
    def num_done(self) -> int:
        """Chunks of the schedule that are done or were passed over."""
        return int(self._state.iteration) // self._solver.chunk_iterations

    def advance(self) -> Progress | None:
        """Train for a chunk; return how it went, or None where the run is over or diverged.

        Where the KL has settled, that chunk is the first of the last part of the schedule.

        Raises:
          ValueError: if the MDP returned a number that is not finite, or nothing was learned yet
            and training diverged.
        """
        self._pass_over()
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
            self._blame_mdp()
            self._diverged()
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

    def _pass_over(self) -> None:
        """Go on from the best state to the last part of the schedule where the KL has settled."""
        solver = self._solver
        first = round((1.0 - LAST_PART) * solver.num_chunks)
        if self.num_done < first and solver.has_settled(self.history):
            self._state = self._trainer.at_iteration(self._best, first * solver.chunk_iterations)

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return all that is needed to go on, to be stored."""
        states = {"state": self._state, "best": self._best}
        return {
            f"{at}/{name}": array
            for at, state in states.items()
            for name, array in to_arrays(state).items()
        } | {"history": np.array(self.history), **self._probe.tasks._asdict()}

    @cached_property
    def _train(self) -> Callable[[Any], tuple[Any, SegmentInfo]]:
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

    def _has_risen(self, num_chunks: int) -> bool:
        """Return whether the KL of each of the last chunks is far above the least there was."""
        kl = [progress.kl for progress in self.history]
        highest = RISEN * min(kl, default=math.inf) + FAR
        return len(kl) >= num_chunks and min(kl[-num_chunks:]) > highest

    def _warn_of_rise(self) -> None:
        kl = [progress.kl for progress in self.history]
        warnings.warn(
            f"training diverged: the KL rose to {kl[-1]:.2g} nats after {len(kl)} chunks. The "
            f"network of the least, {min(kl):.2g} nats after {1 + int(np.argmin(kl))} chunks, is "
            f"kept. Lower learning_rate from {self._solver.learning_rate}",
            RuntimeWarning,
            stacklevel=CALLER,
        )

    def _warn_of_standstill(self) -> None:
        """Say so where a whole run has come no nearer to pi_0."""
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
        warnings.warn(f"{text}. The network before that is kept", RuntimeWarning, stacklevel=CALLER)


def _is_finite(state: Any) -> bool:
    """Return whether all numbers that training carries are finite."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
