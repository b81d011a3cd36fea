"""One run of distillation: lanes under the policy that is imitated, segments, updates.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from swerve.look_ahead import ValuedPolicy
from swerve.problem import Problem
from swerve.solvers import losses
from swerve.solvers.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.networks import DenseNetwork
from swerve.solvers.segments import Segment, minibatches, roll_segment
from swerve.solvers.soap import soap

if TYPE_CHECKING:
    from swerve.solvers.distilled import Distilled

LOWEST = -1e4  # nats: values are not told apart below
RATE_END = 0.01  # of the first learning rate, reached at the end


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


class DistilledState(NamedTuple):
    """Everything that training carries; with the settings and the seed it determines the rest."""

    network: DenseNetwork
    optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class DistilledInfo(NamedTuple):
    """How an iteration went.

    Attributes:
      residual: median of |V - B V|, nats.
    """

    residual: Float[Array, ""]


@dataclass(frozen=True, eq=False)
class Trainer:
    """One run: its problem, settings, seed, and the policy that is imitated."""

    problem: Problem
    settings: Distilled
    seed: int
    teacher: ValuedPolicy | None

    def policy_of(self, state: DistilledState) -> DirectPolicy:
        """Return the policy that was learned."""
        return DirectPolicy(self.problem, self.settings.loss_scale, state.network)

    def initial_state(self) -> DistilledState:
        """Return what training starts from."""
        settings, mdp = self.settings, self.problem.mdp
        key_network, key_lanes = jax.random.split(jax.random.key(self.seed))
        lanes = fresh_lanes(self.problem, key_lanes, settings.num_lanes, 1.0)
        features = over_lanes(mdp.features, -1, -1, -1)(*lanes)
        sizes = (features.shape[0], settings.width, settings.width, mdp.num_actions + 1)
        network = DenseNetwork(sizes, 0.1, key=key_network)
        optimiser = self.optimiser.init(cast(Any, network))
        return DistilledState(network, optimiser, lanes, jnp.int32(0))

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """SOAP with a falling rate."""
        settings = self.settings
        num_updates = settings.num_iterations * settings.num_epochs * settings.num_minibatches
        return soap(optax.cosine_decay_schedule(settings.learning_rate, num_updates, RATE_END))

    @partial(jax.jit, static_argnums=(0, 2))
    def run(self, state: DistilledState, num_iterations: int) -> tuple[DistilledState, Any]:
        """Run iterations of training in one scan; the information is that of each."""
        return jax.lax.scan(self.iterate, state, None, length=num_iterations)

    @partial(jax.jit, static_argnums=0)
    def visited(self, state: DistilledState) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return self.rollout(state)[1].lanes

    def iterate(self, state: DistilledState, _: Any) -> tuple[DistilledState, DistilledInfo]:
        """Roll out one segment in all lanes and learn from it."""
        lanes, segment = self.rollout(state)
        batches = tuple(minibatches(x, self.settings.num_minibatches) for x in segment.seen)

        def epoch(carry: tuple, _: Any) -> tuple[tuple, Array]:
            return jax.lax.scan(self.update, carry, batches)

        carry = (state.network, state.optimiser)
        carry, residual = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = DistilledInfo(jnp.mean(residual))
        return DistilledState(*carry, lanes, state.iteration + 1), info

    def rollout(self, state: DistilledState) -> tuple[Lanes, Segment]:
        """Roll out one segment of the teacher; what is seen are features and what it proposes."""
        teacher = self.teacher
        assert teacher is not None

        def look(lanes: Lanes, place: Array) -> tuple[Array, tuple[Array, Array, Array]]:
            log_probabilities, value = teacher.propose(*lanes)
            features = self.problem.mdp.features(*lanes)
            return log_probabilities, (features, log_probabilities, jnp.maximum(value, LOWEST))

        key = jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)
        return roll_segment(self.problem, self.settings, look, state.lanes, key)

    def update(self, carry: tuple, batch: tuple[Array, ...]) -> tuple[tuple, Array]:
        """Take one optimiser step on one batch; return the residual too."""
        network, state = carry
        (_, residual), gradient = jax.value_and_grad(self.loss, has_aux=True)(network, batch)
        updates, state = self.optimiser.update(gradient, state)
        return (eqx.apply_updates(network, updates), state), residual

    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> tuple[Array, Array]:
        """Return the mean loss, and the median |V - B V| [nats]."""
        features, target, target_value = batch
        policy = DirectPolicy(self.problem, self.settings.loss_scale, network)
        log_probabilities, value = over_lanes(policy.of, -1)(features)
        scale = losses.loss_scale(target_value, self.settings.loss_scale)
        divergence = jnp.sum(jnp.exp(target) * (target - log_probabilities), axis=0)
        error = losses.huber((value - target_value) / scale)
        return jnp.mean(divergence + error), jnp.median(jnp.abs(value - target_value))
