"""What solvers share that train one network on segments: minibatches and updates.

Shapes: N lanes, L steps of a segment, G minibatches, A actions. The batch is the last axis of every
array.
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from swerve.simulation.trajectory import Policy
from swerve.solvers.trained.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.trained.networks import DenseNetwork
from swerve.solvers.trained.segments import Segment, minibatches
from swerve.solvers.trained.soap import soap
from swerve.solvers.trained.trainers import RATE_END, SegmentInfo, SegmentTrainer


class NetworkState(NamedTuple):
    """Everything that training carries; with the settings and the seed it determines the rest."""

    network: DenseNetwork
    optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class NetworkTrainer(SegmentTrainer):
    """One run: its problem, settings and seed."""

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
        """Return what to learn from a segment, all [L, ..., N], and its residuals [nats]."""

    @abc.abstractmethod
    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Float[Array, ""]:
        """Return the mean loss over a minibatch of the columns."""

    def policy_of(self, state: NetworkState) -> Policy:
        """Return the policy that was learned."""
        return self.policy(state.network)

    def initial_state(self) -> NetworkState:
        """Return what training starts from: lanes anywhere at any time, so that none keep step."""
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
        """Roll out one segment in all lanes and learn from it."""
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
        return (eqx.apply_updates(network, updates), state), None
