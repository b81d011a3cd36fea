"""Train from segments: the iterations of a run, their random numbers, minibatches and updates.

The random numbers of an iteration depend on the seed and the number of the iteration alone, so a
run that goes on from a checkpoint is the same run.

Shapes: N lanes, L steps of a segment, I iterations, G minibatches, A actions. The batch is the last
axis of every array.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.trained.networks import DenseNetwork
from swerve.solvers.trained.segments import Segment, minibatches, roll_segment
from swerve.solvers.trained.settings import TrainingSettings
from swerve.solvers.trained.soap import soap

RATE_END = 0.01  # share of the first learning rate that is left at the end of a run


class SegmentInfo(NamedTuple):
    """How an iteration went; of several iterations, with a leading [I].

    Attributes:
      residual: median of |residual|, see `probe.Progress`, nats.
    """

    residual: Float[Array, ""]


class Trainer(abc.ABC):
    """One run of a solver for a problem; its states have `lanes` and an `iteration`.

    Attributes:
      restarts: whether lanes that explore start anew with every segment.
    """

    restarts: bool

    def __init__(self, problem: Problem, settings: TrainingSettings, seed: int) -> None:
        self.problem, self.settings, self.seed = problem, settings, seed

    @abc.abstractmethod
    def policy_of(self, state: Any) -> Policy:
        """Return the policy that was learned; its leaves are the weights of one network."""

    @abc.abstractmethod
    def initial_state(self) -> Any:
        """Return the state that training starts from, a tree of arrays."""

    @abc.abstractmethod
    def iterate(self, state: Any, _: Any) -> tuple[Any, SegmentInfo]:
        """Roll out one segment in all lanes and learn from the segment."""

    @abc.abstractmethod
    def look(self, state: Any, lane: Lanes, place: Array) -> tuple[Array, Any]:
        """Return log pi [A] of the policy that is rolled out, and numbers to keep of the step.

        Args:
          state: state of training in this iteration.
          lane: where the lane is.
          place: a number from 0 to 1 that stays with the lane.
        """

    @property
    def imitated(self) -> str:
        """Fingerprint of the policy that is imitated; empty if there is none, the default."""
        return ""

    def probed(self, state: Any) -> Sequence[tuple[Policy, float]]:
        """Return the policies to be tried, each with its beta."""
        return [(self.policy_of(state), self.problem.beta)]

    @property
    def updates_per_iteration(self) -> int:
        """Optimiser steps of an iteration."""
        return self.settings.num_epochs * self.settings.num_minibatches

    def at_iteration(self, state: Any, iteration: int) -> Any:
        """Return a state moved along the schedule of the learning rate to an iteration."""
        count = jnp.int32(iteration * self.updates_per_iteration)
        state = optax.tree_utils.tree_set(state, count=count)  # of schedule and optimiser
        return state._replace(iteration=jnp.int32(iteration))

    def run(self, state: Any, num_iterations: int) -> tuple[Any, SegmentInfo]:
        """Run iterations of training in one scan; return the last state and how each went [I]."""
        return self._run(state, num_iterations)

    @cached_property
    def _run(self) -> Callable[[Any, int], tuple[Any, SegmentInfo]]:
        """Function `run`, compiled; it is dropped with this trainer."""
        return jax.jit(
            lambda state, num: jax.lax.scan(self.iterate, state, None, length=num), static_argnums=1
        )

    def visited(self, state: Any) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return jax.jit(lambda state: self.rollout(state)[1].lanes)(state)

    def rollout(self, state: Any) -> tuple[Lanes, Segment]:
        """Roll out one segment in all lanes."""
        look = partial(self.look, state)
        key = jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)
        return roll_segment(
            self.problem, self.settings, look, state.lanes, key, restart=self.restarts
        )


class NetworkState(NamedTuple):
    """Everything that training carries: with settings and seed, it determines the rest of a run."""

    network: DenseNetwork
    optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class NetworkTrainer(Trainer):
    """One run in which a single network is trained by regression on segments."""

    restarts = True

    @abc.abstractmethod
    def policy(self, network: DenseNetwork) -> Policy:
        """Return the policy of a network."""

    @abc.abstractmethod
    def sizes(self, num_features: int) -> tuple[int, int]:
        """Return how many inputs and outputs the network has."""

    @abc.abstractmethod
    def columns(
        self, network: DenseNetwork, segment: Segment
    ) -> tuple[tuple[Array, ...], Float[Array, "L N"]]:
        """Return a segment's columns to learn from, all [L, ..., N], and residuals [nats]."""

    @abc.abstractmethod
    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Float[Array, ""]:
        """Return the mean loss over a minibatch of the columns."""

    def policy_of(self, state: NetworkState) -> Policy:
        """Return the policy that was learned."""
        return self.policy(state.network)

    def initial_state(self) -> NetworkState:
        """Return the state that training starts from.

        All lanes start anywhere at any time, so that their episodes do not end together.
        """
        settings = self.settings
        key_network, key_lanes = jax.random.split(jax.random.key(self.seed))
        lanes = fresh_lanes(self.problem, key_lanes, settings.num_lanes, 1.0)
        features = over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes)
        num_inputs, num_outputs = self.sizes(features.shape[0])
        sizes = (num_inputs, settings.width, settings.width, num_outputs)
        network = DenseNetwork(sizes, 0.1, key=key_network)
        optimiser = self.optimiser.init(cast(Any, network))
        return NetworkState(network, optimiser, lanes, jnp.int32(0))

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """SOAP with a falling rate."""
        settings = self.settings
        num_updates = settings.num_iterations * self.updates_per_iteration
        return soap(optax.cosine_decay_schedule(settings.learning_rate, num_updates, RATE_END))

    def iterate(self, state: NetworkState, _: Any) -> tuple[NetworkState, SegmentInfo]:
        """Roll out one segment in all lanes and learn from the segment."""
        lanes, segment = self.rollout(state)
        columns, residual = self.columns(state.network, segment)
        batches = tuple(minibatches(x, self.settings.num_minibatches) for x in columns)

        def epoch(carry: tuple, _: Any) -> tuple[tuple, None]:
            return jax.lax.scan(self.update, carry, batches)

        carry = (state.network, state.optimiser)
        carry, _ = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = SegmentInfo(jnp.median(jnp.abs(residual)))
        return NetworkState(*carry, lanes, state.iteration + 1), info

    def update(self, carry: tuple, batch: tuple[Array, ...]) -> tuple[tuple, None]:
        """Take one optimiser step on one minibatch."""
        network, state = carry
        updates, state = self.optimiser.update(jax.grad(self.loss)(network, batch), state)
        return (optax.apply_updates(cast(Any, network), updates), state), None
