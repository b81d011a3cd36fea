"""What solvers share that learn from segments: the run of iterations, and its random numbers.

The random numbers of an iteration depend on the seed and its number alone, so that a run resumed
from a checkpoint is the same run.

Shapes: N lanes, L steps of a segment, I iterations, A actions. The batch is the last axis of every
array.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.lanes import Lanes
from swerve.solvers.trained.segments import Segment, roll_segment
from swerve.solvers.trained.training import TrainingSolver

RATE_END = 0.01  # of the first learning rate, reached at the end


class SegmentInfo(NamedTuple):
    """How an iteration went.

    Attributes:
      residual: median of |residual|, see `training_run.Progress`, nats.
    """

    residual: Float[Array, ""]


class SegmentTrainer(abc.ABC):
    """One run: its problem, settings and seed. States have `lanes` and an `iteration`.

    Attributes:
      restarts: whether lanes that explore start anew with every segment.
    """

    restarts: bool

    def __init__(self, problem: Problem, settings: TrainingSolver, seed: int) -> None:
        self.problem, self.settings, self.seed = problem, settings, seed

    @abc.abstractmethod
    def policy_of(self, state: Any) -> Policy:
        """Return the policy that was learned."""

    @abc.abstractmethod
    def initial_state(self) -> Any:
        """Return what training starts from."""

    @abc.abstractmethod
    def iterate(self, state: Any, _: Any) -> tuple[Any, SegmentInfo]:
        """Roll out one segment in all lanes and learn from it."""

    @abc.abstractmethod
    def look(self, state: Any, lane: Lanes, place: Array) -> tuple[Array, Any]:
        """Return log pi [A] of the policy that is rolled out, and what to keep of a step.

        Args:
          state: of the iteration.
          lane: where the lane is.
          place: a number from 0 to 1 that stays with the lane.
        """

    @property
    def imitated(self) -> str:
        """Fingerprint of what it imitates: of nothing, unless overridden."""
        return ""

    def probed(self, state: Any) -> Sequence[tuple[Policy, float]]:
        """Return the policies to be tried, each with the beta that it is for."""
        return [(self.policy_of(state), self.problem.beta)]

    @property
    def updates_per_iteration(self) -> int:
        """Optimiser steps of an iteration."""
        return self.settings.num_epochs * self.settings.num_minibatches

    def at_iteration(self, state: Any, iteration: int) -> Any:
        """Return a state as far along the schedule of the learning rate as an iteration is."""
        count = jnp.int32(iteration * self.updates_per_iteration)
        state = optax.tree_utils.tree_set(state, count=count)  # of the schedule, and of Adam
        return state._replace(iteration=jnp.int32(iteration))

    @partial(jax.jit, static_argnums=(0, 2))
    def run(self, state: Any, num_iterations: int) -> tuple[Any, SegmentInfo]:
        """Run iterations of training in one scan; the information [I] is that of each."""
        return jax.lax.scan(self.iterate, state, None, length=num_iterations)

    @partial(jax.jit, static_argnums=0)
    def visited(self, state: Any) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return self.rollout(state)[1].lanes

    def rollout(self, state: Any) -> tuple[Lanes, Segment]:
        """Roll out one segment in all lanes."""
        look = partial(self.look, state)
        key = jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)
        return roll_segment(
            self.problem, self.settings, look, state.lanes, key, restart=self.restarts
        )
