"""One run of distillation: lanes under the policy that is imitated, and what it does there.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.policies import LOWEST, ValuedPolicy
from swerve.solvers.trained import losses
from swerve.solvers.trained.lanes import Lanes, over_lanes
from swerve.solvers.trained.network_training import NetworkState, NetworkTrainer
from swerve.solvers.trained.networks import DenseNetwork, to_arrays
from swerve.solvers.trained.segments import Segment

if TYPE_CHECKING:
    from swerve.solvers.trained.distilled import Distilled


class DirectPolicy(ValuedPolicy):
    """A policy and a soft value by one network, for all goals.

    Attributes:
      loss_scale: of its values.
    """

    problem: Problem = eqx.field(static=True)
    loss_scale: float = eqx.field(static=True)
    network: DenseNetwork

    def propose(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " A"], Float[Array, ""]]:
        """Return log pi(a | s, t) of every action, and what it takes for V_t(s) [nats]."""
        return self.of(self.problem.mdp.features(state, step, goal))

    def of(self, features: Float[Array, " F"]) -> tuple[Float[Array, " A"], Float[Array, ""]]:
        """Return the same of features."""
        output = self.network(features)
        value = losses.value_of_output(output[-1], self.loss_scale)
        return jax.nn.log_softmax(output[:-1]), value


class Trainer(NetworkTrainer):
    """One run, with the policy that is imitated."""

    settings: Distilled

    def __init__(
        self, problem: Problem, settings: Distilled, seed: int, teacher: ValuedPolicy | None
    ) -> None:
        super().__init__(problem, settings, seed)
        self.teacher = teacher

    @property
    def imitated(self) -> str:
        """Fingerprint of the teacher's network."""
        weights = hashlib.sha256()
        for array in to_arrays(self.teacher).values():
            weights.update(array.tobytes())
        return weights.hexdigest()

    def policy(self, network: DenseNetwork) -> DirectPolicy:
        """Return the policy of a network."""
        return DirectPolicy(self.problem, self.settings.loss_scale, network)

    def sizes(self, num_features: int) -> tuple[int, int]:
        """Return how many inputs and outputs the network has."""
        return num_features, self.problem.mdp.num_actions + 1

    def look(
        self, state: NetworkState, lane: Lanes, place: Array
    ) -> tuple[Array, tuple[Array, Array, Array]]:
        """Return log pi [A] of the teacher, features, log pi again, and its soft value [nats]."""
        assert self.teacher is not None
        log_probabilities, value = self.teacher.propose(*lane)
        features = self.problem.mdp.features(*lane)
        return log_probabilities, (features, log_probabilities, jnp.maximum(value, LOWEST))

    def columns(
        self, network: DenseNetwork, segment: Segment
    ) -> tuple[tuple[Array, ...], Float[Array, "L N"]]:
        """Return what the teacher did, and how far its soft values are from the network's."""
        features, _, value = segment.seen
        _, now = jax.lax.map(over_lanes(self.policy(network).of, -1), features)
        return segment.seen, value - now

    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Float[Array, ""]:
        """Return the mean divergence from the teacher, and Huber loss of relative errors."""
        features, target, target_value = batch
        log_probabilities, value = over_lanes(self.policy(network).of, -1)(features)
        scale = losses.loss_scale(target_value, self.settings.loss_scale)
        divergence = jnp.sum(jnp.exp(target) * (target - log_probabilities), axis=0)
        return jnp.mean(divergence + losses.huber((value - target_value) / scale))
