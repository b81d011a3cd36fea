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

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from swerve.look_ahead import LookAhead
from swerve.problem import Problem
from swerve.solvers import losses
from swerve.solvers.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.networks import DenseNetwork
from swerve.solvers.soap import soap
from swerve.trajectory import draw_action, take_step

if TYPE_CHECKING:
    from swerve.solvers.soft_value import SoftValue

LOWEST = -1e4  # nats: values are not told apart below, where next to nothing comes from
RATE_END = 0.01  # of the first learning rate, reached at the end


class SoftValuePolicy(LookAhead):
    """The look-ahead policy of the network, for all goals.

    Attributes:
      settings: of the solver; the scale of values and how the terminal shape fades.
    """

    problem: Problem = eqx.field(static=True)
    settings: SoftValue = eqx.field(static=True)
    network: DenseNetwork

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
        terminal = jnp.maximum(self.problem.beta * mdp.terminal_reward(state, goal), LOWEST)
        shape = terminal * jnp.exp(-share_to_go / settings.fade)
        return mdp.features(state, step, goal), shape

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


class Segment(NamedTuple):
    """What a rollout leaves: [F, N], three of [N] for the loss, and lanes; with a leading L.

    Attributes:
      features: of the states.
      shape: what is left there of the terminal reward, nats.
      backed: (B V)_t(s_t), nats.
      ended: whether the episode ended with this step.
      lanes: where they were.
    """

    features: Array
    shape: Array
    backed: Array
    ended: Array
    lanes: Lanes


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
        return SoftValuePolicy(self.problem, self.settings, network)

    def policy_of(self, state: SoftValueState) -> SoftValuePolicy:
        """Return the look-ahead policy of what was learned."""
        return self.policy(state.network)

    @partial(jax.jit, static_argnums=0)
    def visited(self, state: SoftValueState) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return self.rollout(self.policy_of(state), state.lanes, self.key(state))[1].lanes

    def key(self, state: SoftValueState) -> Key[Array, ""]:
        """Return the source of randomness of the iteration that begins in a state."""
        return jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)

    def initial_state(self) -> SoftValueState:
        """Return what training starts from."""
        settings = self.settings
        key_network, key_lanes = jax.random.split(jax.random.key(self.seed))
        lanes = fresh_lanes(self.problem, key_lanes, settings.num_lanes, settings.explore)
        features = over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes)
        sizes = (features.shape[0], settings.width, settings.width, 1)
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
        lanes, segment = self.rollout(self.policy_of(state), state.lanes, self.key(state))
        now = jax.lax.map(self.values(state.network), segment[:2])
        residual = segment.backed - now
        target = now + losses.discounted(residual, segment.ended, self.settings.trace)

        batches = jax.tree.map(self.minibatches, (segment.features, segment.shape, target))

        def epoch(carry: tuple, _: Any) -> tuple[tuple, Array]:
            return jax.lax.scan(self.update, carry, batches)

        carry = (state.network, state.optimiser)
        carry, loss = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = SoftValueInfo(jnp.mean(loss), jnp.median(jnp.abs(residual)))
        return SoftValueState(*carry, lanes, state.iteration + 1), info

    def rollout(
        self, policy: SoftValuePolicy, lanes: Lanes, key: Key[Array, ""]
    ) -> tuple[Lanes, Segment]:
        """Roll out one segment; a lane whose episode ends goes on with a fresh one."""
        settings, problem = self.settings, self.problem
        key_fresh, key_actions = jax.random.split(key)
        num_lanes = settings.num_lanes
        fresh = jax.vmap(lambda key: fresh_lanes(problem, key, num_lanes, settings.explore))(
            jax.random.split(key_fresh, settings.segment)
        )
        uniforms = jax.random.uniform(key_actions, (settings.segment, num_lanes))
        explores = jnp.arange(num_lanes) < settings.explore * num_lanes
        lanes = jax.tree.map(lambda new, old: jnp.where(explores, new[0], old), fresh, lanes)

        def advance(lanes: Lanes, fresh: Lanes, uniform: Array) -> tuple[Lanes, Segment]:
            log_probabilities, backed = policy.propose(*lanes)
            action, _ = draw_action(log_probabilities, uniform)
            taken = take_step(problem, lanes.state, action, lanes.step, lanes.goal)
            moved = Lanes(taken.state, lanes.step + 1, lanes.goal)
            following = jax.tree.map(partial(jnp.where, taken.ended), fresh, moved)
            inputs = policy.inputs(*lanes)
            return following, Segment(*inputs, jnp.maximum(backed, LOWEST), taken.ended, lanes)

        return jax.lax.scan(
            lambda lanes, x: over_lanes(advance, -1, -1, -1)(lanes, *x), lanes, (fresh, uniforms)
        )

    def minibatches(self, column: Array) -> Array:
        """Return a segment's [L, ..., N] as [G, ..., L N / G], steps of a batch far apart."""
        num = self.settings.num_minibatches
        column = column.reshape(-1, num, *column.shape[1:])
        column = jnp.moveaxis(column, 0, -2)
        return column.reshape(*column.shape[:-2], -1)

    def values(self, network: DenseNetwork) -> Any:
        """Return what maps features [F, N] and shapes [N] to values [N]."""
        each = over_lanes(self.policy(network).value_of, -1, -1)
        return lambda inputs: each(*inputs)

    def update(self, carry: tuple, batch: tuple[Array, Array, Array]) -> tuple[tuple, Array]:
        """Take one optimiser step on one batch."""
        network, state = carry
        loss, gradient = jax.value_and_grad(self.loss)(network, batch)
        updates, state = self.optimiser.update(gradient, state)
        return (eqx.apply_updates(network, updates), state), loss

    def loss(self, network: DenseNetwork, batch: tuple[Array, Array, Array]) -> Array:
        """Return the mean Huber loss of relative errors."""
        *inputs, target = batch
        scale = losses.loss_scale(target, self.settings.loss_scale)
        return jnp.mean(losses.huber((self.values(network)(inputs) - target) / scale))
