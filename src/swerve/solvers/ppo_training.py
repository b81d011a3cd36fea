"""One run of maximum-entropy PPO: lanes of episodes, segments, minibatches, updates.

Every lane continues its own episode from segment to segment and starts anew when it ends. An
iteration rolls out one segment in all lanes and takes a few epochs of gradient steps on it. The
random numbers of an iteration depend on the seed and its number alone, so a run that stops and goes
on gives the same numbers as one that does not.

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
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from swerve.problem import Problem
from swerve.solvers import losses
from swerve.solvers.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.networks import DenseNetwork
from swerve.trajectory import draw_action, take_step

if TYPE_CHECKING:
    from swerve.solvers.ppo import PPO

KNOWN_PENALTY = 1e4  # nats, where an episode ends in a known constraint: worse than any return
RATE_END = 0.01  # of the first learning rate, reached at the end


class PPOPolicy(eqx.Module):
    """The learned policy of all goals."""

    problem: Problem = eqx.field(static=True)
    network: DenseNetwork

    def __call__(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return log pi(a | state, step, goal) for every action."""
        return jax.nn.log_softmax(self.network(self.problem.mdp.features(state, step, goal)))


class PPOState(NamedTuple):
    """Everything that training carries; with the settings and the seed it determines the rest."""

    policy: DenseNetwork
    value: DenseNetwork
    policy_optimiser: Any
    value_optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class Segment(NamedTuple):
    """What a rollout leaves: [F, N], [N], [A, N], [N], [N] for the losses, and lanes; leading L."""

    features: Array
    action: Array
    log_probabilities: Array
    reward: Array
    ended: Array
    lanes: Lanes


class Batch(NamedTuple):
    """A segment with advantages and value targets, [..., columns] with a leading G."""

    features: Array
    action: Array
    log_probabilities: Array
    advantage: Array
    value: Array
    target: Array


class PPOInfo(NamedTuple):
    """How an iteration went.

    Attributes:
      residual: median of |r~ + V(s') - V(s)|, r~ the soft reward, nats.
    """

    residual: Float[Array, ""]


@dataclass(frozen=True, eq=False)
class Trainer:
    """One run: its problem, settings and seed."""

    problem: Problem
    settings: PPO
    seed: int

    def policy_of(self, state: PPOState) -> PPOPolicy:
        """Return the policy that was learned."""
        return PPOPolicy(self.problem, state.policy)

    @partial(jax.jit, static_argnums=0)
    def visited(self, state: PPOState) -> Lanes:
        """Return where the lanes go in the iteration that begins in a state, [L, ..., N]."""
        return self.rollout(state.policy, state.lanes, self.key(state))[1].lanes

    def key(self, state: PPOState) -> Key[Array, ""]:
        """Return the source of randomness of the iteration that begins in a state."""
        return jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)

    def initial_state(self) -> PPOState:
        """Return what training starts from."""
        settings, mdp = self.settings, self.problem.mdp
        key_policy, key_value, key_lanes = jax.random.split(jax.random.key(self.seed), 3)
        # all at any time at first, so that ends come evenly
        lanes = fresh_lanes(self.problem, key_lanes, settings.num_lanes, explore=1.0)
        features = over_lanes(mdp.features, -1, -1, -1)(*lanes)
        hidden = (features.shape[0], settings.width, settings.width)
        policy = DenseNetwork((*hidden, mdp.num_actions), 0.1, key=key_policy)
        value = DenseNetwork((*hidden, 1), 1.0, key=key_value)
        optimiser = self.optimiser
        policy_state, value_state = (optimiser.init(cast(Any, net)) for net in (policy, value))
        return PPOState(policy, value, policy_state, value_state, lanes, jnp.int32(0))

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """Adam with clipped gradients and a falling rate."""
        settings = self.settings
        num_updates = settings.num_iterations * settings.num_epochs * settings.num_minibatches
        rate = settings.learning_rate
        schedule = optax.linear_schedule(rate, rate * RATE_END, num_updates)
        return optax.chain(optax.clip_by_global_norm(10.0), optax.adam(schedule, b2=0.99, eps=1e-6))

    @partial(jax.jit, static_argnums=(0, 2))
    def run(self, state: PPOState, num_iterations: int) -> tuple[PPOState, PPOInfo]:
        """Run iterations of training in one scan; the information is that of each."""
        return jax.lax.scan(self.iterate, state, None, length=num_iterations)

    def iterate(self, state: PPOState, _: Any) -> tuple[PPOState, PPOInfo]:
        """Roll out one segment in all lanes and learn from it."""
        lanes, segment = self.rollout(state.policy, state.lanes, self.key(state))
        batch, residual = self.batch(state.value, segment, lanes)

        def epoch(carry: tuple, _: Any) -> tuple[tuple, None]:
            return jax.lax.scan(self.update, carry, batch)

        carry = (state.policy, state.value, state.policy_optimiser, state.value_optimiser)
        carry, _ = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = PPOInfo(jnp.median(jnp.abs(residual)))
        return PPOState(*carry, lanes, state.iteration + 1), info

    def rollout(
        self, policy: DenseNetwork, lanes: Lanes, key: Key[Array, ""]
    ) -> tuple[Lanes, Segment]:
        """Roll out one segment; a lane whose episode ends goes on with a fresh one."""
        settings, problem = self.settings, self.problem
        key_fresh, key_actions = jax.random.split(key)
        num_lanes = settings.num_lanes
        fresh = jax.vmap(lambda key: fresh_lanes(problem, key, num_lanes, settings.explore))(
            jax.random.split(key_fresh, settings.segment)  # for every step one that could end there
        )
        uniforms = jax.random.uniform(key_actions, (settings.segment, num_lanes))
        offset = np.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0

        def advance(lanes: Lanes, fresh: Lanes, uniform: Array) -> tuple[Lanes, Segment]:
            features = problem.mdp.features(*lanes)
            log_probabilities = jax.nn.log_softmax(policy(features))
            action, log_probability = draw_action(log_probabilities, uniform)
            taken = take_step(problem, lanes.state, action, lanes.step, lanes.goal)
            earned = jnp.where(
                jnp.isneginf(taken.reward), -KNOWN_PENALTY, problem.beta * taken.reward
            )
            moved = Lanes(taken.state, lanes.step + 1, lanes.goal)
            following = jax.tree.map(partial(jnp.where, taken.ended), fresh, moved)
            reward = earned - log_probability - offset
            left = Segment(features, action, log_probabilities, reward, taken.ended, lanes)
            return following, left

        return jax.lax.scan(
            lambda lanes, x: over_lanes(advance, -1, -1, -1)(lanes, *x), lanes, (fresh, uniforms)
        )

    def batch(
        self, value: DenseNetwork, segment: Segment, lanes: Lanes
    ) -> tuple[Batch, Float[Array, "L N"]]:
        """Return advantages and targets, in minibatches of whole lanes, and residuals [nats]."""
        settings = self.settings
        groups = settings.num_minibatches

        def values(features: Array) -> Array:
            return losses.value_of_output(over_lanes(value, -1)(features)[0], settings.loss_scale)

        def group(x: Array) -> Array:
            """[L, ..., N] to [G, ..., L N / G], each group with its share of exploring lanes."""
            x = x.reshape(*x.shape[:-1], -1, groups)
            x = jnp.moveaxis(x, (-1, 0), (0, -2))
            return x.reshape(*x.shape[:-2], -1)

        features = group(segment.features)
        now = jax.lax.map(values, features).reshape(groups, settings.segment, -1)
        now = jnp.moveaxis(now, 0, -1).reshape(settings.segment, -1)
        last = values(over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes))
        later = jnp.where(segment.ended, 0.0, jnp.concatenate([now[1:], last[None]]))
        residual = segment.reward + later - now
        advantage = losses.discounted(residual, segment.ended, settings.gae_lambda)
        columns = (segment.action, segment.log_probabilities, advantage, now, advantage + now)
        return Batch(features, *map(group, columns)), residual

    def update(self, carry: tuple, batch: Batch) -> tuple[tuple, None]:
        """Take one step on a minibatch, of the policy and of the value."""
        policy, value, policy_state, value_state = carry
        policy, policy_state = self.descend(self.policy_loss, policy, policy_state, batch)
        value, value_state = self.descend(self.value_loss, value, value_state, batch)
        return (policy, value, policy_state, value_state), None

    def descend(self, loss: Any, network: DenseNetwork, state: Any, batch: Batch) -> tuple:
        """Take one optimiser step on a loss."""
        updates, state = self.optimiser.update(jax.grad(loss)(network, batch), state)
        return eqx.apply_updates(network, updates), state

    def policy_loss(self, policy: DenseNetwork, batch: Batch) -> Array:
        """Return the mean clipped surrogate of a minibatch."""

        def loss(features: Array, action: Array, old: Array, advantage: Array) -> Array:
            new = jax.nn.log_softmax(policy(features))
            return losses.policy_loss(new, old, action, advantage, clip=self.settings.clip)

        # a scale of the state alone, since one of the action would move the best policy there
        scale = losses.loss_scale(batch.value, self.settings.loss_scale)
        advantage = losses.bounded(batch.advantage, scale)
        each = over_lanes(loss, -1, -1, -1, -1)(*batch[:3], advantage)
        return jnp.mean(each / scale)

    def value_loss(self, value: DenseNetwork, batch: Batch) -> Array:
        """Return the mean Huber loss of relative errors of a minibatch."""
        scale = self.settings.loss_scale
        predicted = losses.value_of_output(over_lanes(value, -1)(batch.features)[0], scale)
        error = (predicted - batch.target) / losses.loss_scale(batch.target, scale)
        return jnp.mean(losses.huber(error))
