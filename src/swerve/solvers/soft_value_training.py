"""One run of soft value learning: lanes of episodes, segments, residuals, updates.

An iteration rolls out one segment of L steps in all lanes under the look-ahead policy of the
network as it is. At each step that policy works out (B V)_t(s), so the residual

    delta_t = (B V)_t(s_t) - V_t(s_t)

costs nothing, and V is moved towards its lambda-return

    V_t(s_t) + sum_k lambda^k delta_{t+k},

the sum ending with the episode or the segment. Lanes that explore start anew, anywhere at any time,
with every segment; the others go on from where they were until their episode ends. The random
numbers of an iteration depend on the seed and its number alone.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from swerve.look_ahead import LookAhead
from swerve.problem import Problem
from swerve.solvers import losses
from swerve.solvers.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.networks import DenseNetwork
from swerve.solvers.segments import Segment, minibatches, roll_segment
from swerve.solvers.soap import soap

if TYPE_CHECKING:
    from swerve.solvers.soft_value import SoftValue

LOWEST = -1e4  # nats: values are not told apart below, where next to nothing comes from
RATE_END = 0.01  # of the first learning rate, reached at the end


class SoftValuePolicy(LookAhead):
    """The look-ahead policy of the network, for all goals.

    Attributes:
      settings: of the solver; the scale of values and how the terminal shape fades.
      log_beta: log of the beta that it is for, relative to the problem's.
    """

    problem: Problem = eqx.field(static=True)
    settings: SoftValue = eqx.field(static=True)
    network: DenseNetwork
    log_beta: Float[Array, ""]

    @property
    def beta(self) -> Float[Array, ""]:
        """Inverse temperature that it is for."""
        return self.problem.beta * jnp.exp(self.log_beta)

    def at(self, log_beta: float | Float[Array, ""]) -> SoftValuePolicy:
        """Return the policy for another beta, by its log relative to the problem's."""
        return SoftValuePolicy(self.problem, self.settings, self.network, jnp.asarray(log_beta))

    def value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return what the network adds to the terminal reward, which fades with time to go."""
        return self.value_of(*self.inputs(state, step, goal))

    def inputs(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " F"], Float[Array, ""]]:
        """Return the features of a state, and beta r_T as far as it has not faded [nats]."""
        mdp, settings = self.problem.mdp, self.settings
        share_to_go = (mdp.num_steps - step) / mdp.num_steps
        terminal = jnp.maximum(self.beta * mdp.terminal_reward(state, goal), LOWEST)
        shape = terminal * jnp.exp(-share_to_go / settings.fade)
        features = mdp.features(state, step, goal)
        if settings.beta_span > 1.0:
            place = self.log_beta / math.log(settings.beta_span)
            features = jnp.append(features, place)
        return features, shape

    def value_of(self, features: Float[Array, " F"], shape: Float[Array, ""]) -> Float[Array, ""]:
        """Return V of what `inputs` returns."""
        output = self.network(features)[0]
        learned = losses.value_of_output(output, self.settings.loss_scale)
        return jnp.maximum(learned + shape, LOWEST)


class SoftValueState(NamedTuple):
    """Everything that training carries; with the settings and the seed it determines the rest."""

    network: DenseNetwork
    optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class SoftValueInfo(NamedTuple):
    """How an iteration went.

    Attributes:
      loss: mean of the Huber losses of relative errors.
      residual: median of |(B V) - V|, nats.
    """

    loss: Float[Array, ""]
    residual: Float[Array, ""]


@dataclass(frozen=True, eq=False)
class Trainer:
    """One run: its problem, settings and seed."""

    problem: Problem
    settings: SoftValue
    seed: int

    def policy(self, network: DenseNetwork) -> SoftValuePolicy:
        """Return the look-ahead policy of a network."""
        return SoftValuePolicy(self.problem, self.settings, network, jnp.zeros(()))

    def policy_of(self, state: SoftValueState) -> SoftValuePolicy:
        """Return the look-ahead policy of what was learned."""
        return self.policy(state.network)

    @partial(jax.jit, static_argnums=0)
    def visited(self, state: SoftValueState) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return self.rollout(state)[1].lanes

    def initial_state(self) -> SoftValueState:
        """Return what training starts from."""
        settings = self.settings
        key_network, key_lanes = jax.random.split(jax.random.key(self.seed))
        lanes = fresh_lanes(self.problem, key_lanes, settings.num_lanes, settings.explore)
        features = over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes)
        num_inputs = features.shape[0] + (settings.beta_span > 1.0)
        sizes = (num_inputs, settings.width, settings.width, 1)
        network = DenseNetwork(sizes, 0.1, key=key_network)
        optimiser = self.optimiser.init(cast(Any, network))
        return SoftValueState(network, optimiser, lanes, jnp.int32(0))

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """SOAP with a falling rate."""
        settings = self.settings
        num_updates = settings.num_iterations * settings.num_epochs * settings.num_minibatches
        return soap(optax.cosine_decay_schedule(settings.learning_rate, num_updates, RATE_END))

    @partial(jax.jit, static_argnums=(0, 2))
    def run(
        self, state: SoftValueState, num_iterations: int
    ) -> tuple[SoftValueState, SoftValueInfo]:
        """Run iterations of training in one scan; the information is that of each."""
        return jax.lax.scan(self.iterate, state, None, length=num_iterations)

    def iterate(self, state: SoftValueState, _: Any) -> tuple[SoftValueState, SoftValueInfo]:
        """Roll out one segment in all lanes and learn from it."""
        lanes, segment = self.rollout(state)
        *inputs, backed = segment.seen
        now = jax.lax.map(self.values(state.network), inputs)
        residual = backed - now
        target = now + losses.discounted(residual, segment.ended, self.settings.trace)
        batches = tuple(minibatches(x, self.settings.num_minibatches) for x in (*inputs, target))

        def epoch(carry: tuple, _: Any) -> tuple[tuple, Array]:
            return jax.lax.scan(self.update, carry, batches)

        carry = (state.network, state.optimiser)
        carry, loss = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = SoftValueInfo(jnp.mean(loss), jnp.median(jnp.abs(residual)))
        return SoftValueState(*carry, lanes, state.iteration + 1), info

    def rollout(self, state: SoftValueState) -> tuple[Lanes, Segment]:
        """Roll out one segment; what is seen are the inputs of V, and (B V)_t(s) [nats]."""
        policy = self.policy_of(state)

        def look(lanes: Lanes, place: Array) -> tuple[Array, tuple[Array, Array, Array]]:
            at_beta = policy.at((2.0 * place - 1.0) * math.log(self.settings.beta_span))
            log_probabilities, backed = at_beta.propose(*lanes)
            return log_probabilities, (*at_beta.inputs(*lanes), jnp.maximum(backed, LOWEST))

        key = jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)
        return roll_segment(self.problem, self.settings, look, state.lanes, key)

    def values(self, network: DenseNetwork) -> Any:
        """Return what maps features [F, N] and shapes [N] to values [N]."""
        each = over_lanes(self.policy(network).value_of, -1, -1)
        return lambda inputs: each(*inputs)

    def update(self, carry: tuple, batch: tuple[Array, ...]) -> tuple[tuple, Array]:
        """Take one optimiser step on one batch."""
        network, state = carry
        loss, gradient = jax.value_and_grad(self.loss)(network, batch)
        updates, state = self.optimiser.update(gradient, state)
        return (eqx.apply_updates(network, updates), state), loss

    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Array:
        """Return the mean Huber loss of relative errors."""
        *inputs, target = batch
        scale = losses.loss_scale(target, self.settings.loss_scale)
        return jnp.mean(losses.huber((self.values(network)(inputs) - target) / scale))
