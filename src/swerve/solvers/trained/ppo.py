"""Maximum-entropy proximal policy optimisation: one goal-conditioned policy for all tasks.

This is how the paper reaches pi_0: maximise its eq. 6, in which the log-probability of the executed
action is part of the return at weight 1 / beta; here everything is multiplied by beta, in nats
(`PPOTrainer.soft_rewards`).

Every lane continues its own episode from segment to segment and starts anew when the episode ends.
An iteration rolls out one segment in all lanes and takes a few epochs of gradient steps on it.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.policies import log_measure
from swerve.solvers.trained import losses
from swerve.solvers.trained.lanes import Lanes, fresh_lanes, over_lanes
from swerve.solvers.trained.networks import DenseNetwork
from swerve.solvers.trained.segments import Segment
from swerve.solvers.trained.trainers import RATE_END, SegmentInfo, Trainer
from swerve.solvers.trained.training import TrainingSolver

KNOWN_PENALTY = 1e4  # nats, where an episode ends in a known constraint: worse than any return


@dataclass(frozen=True)
class PPO(TrainingSolver):
    """Solver: maximum-entropy PPO.

    Attributes:
      num_steps: environment steps to train for.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G; must divide num_lanes.
      gae_lambda: lambda of the generalised advantage estimates.
      clip: how far the ratio of new to old probabilities may be from 1 in the surrogate.
      learning_rate: learning rate at first; it falls linearly to a hundredth.
      width: width of the two hidden layers of the policy and of the value network.
      loss_scale: nats; losses are divided by 1 + |value| / loss_scale.
    """

    num_steps: int = 20_000_000
    num_lanes: int = 256
    segment: int = 32
    explore: float = 0.5
    num_epochs: int = 3
    num_minibatches: int = 8
    gae_lambda: float = 0.9
    clip: float = 0.2
    learning_rate: float = 3e-3
    width: int = 64
    loss_scale: float = 10.0

    name = "ppo"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers(shares=("gae_lambda",), positive=("clip",))
        self.check_divides("num_minibatches", "num_lanes")

    def trainer(self, problem: Problem, seed: int) -> PPOTrainer:
        """Return a trainer for a problem."""
        return PPOTrainer(problem, self, seed)


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
    """Everything that training carries: with settings and seed, it determines the rest of a run."""

    policy: DenseNetwork
    value: DenseNetwork
    policy_optimiser: Any
    value_optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class Batch(NamedTuple):
    """A segment with advantages and value targets, [..., columns] with a leading G."""

    features: Array
    action: Array
    log_probabilities: Array
    advantage: Array
    value: Array
    target: Array


class PPOTrainer(Trainer):
    """One run of PPO."""

    settings: PPO
    restarts = False

    def policy_of(self, state: PPOState) -> PPOPolicy:
        """Return the policy that was learned."""
        return PPOPolicy(self.problem, state.policy)

    def initial_state(self) -> PPOState:
        """Return the state that training starts from."""
        settings, mdp = self.settings, self.problem.mdp
        key_policy, key_value, key_lanes = jax.random.split(jax.random.key(self.seed), 3)
        # all lanes start at any time, so that their episodes do not end together
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
        num_updates = settings.num_iterations * self.updates_per_iteration
        rate = settings.learning_rate
        schedule = optax.linear_schedule(rate, rate * RATE_END, num_updates)
        return optax.chain(optax.clip_by_global_norm(10.0), optax.adam(schedule, b2=0.99, eps=1e-6))

    def iterate(self, state: PPOState, _: Any) -> tuple[PPOState, SegmentInfo]:
        """Roll out one segment in all lanes and learn from the segment."""
        lanes, segment = self.rollout(state)
        batch, residual = self.batch(state.value, segment, lanes)

        def epoch(carry: tuple, _: Any) -> tuple[tuple, None]:
            return jax.lax.scan(self.update, carry, batch)

        carry = (state.policy, state.value, state.policy_optimiser, state.value_optimiser)
        carry, _ = jax.lax.scan(epoch, carry, None, length=self.settings.num_epochs)
        info = SegmentInfo(jnp.median(jnp.abs(residual)))
        return PPOState(*carry, lanes, state.iteration + 1), info

    def look(self, state: PPOState, lane: Lanes, place: Array) -> tuple[Array, tuple[Array, Array]]:
        """Return log pi [A], and to keep: the features and log pi."""
        features = self.problem.mdp.features(*lane)
        log_probabilities = jax.nn.log_softmax(state.policy(features))
        return log_probabilities, (features, log_probabilities)

    def batch(
        self, value: DenseNetwork, segment: Segment, lanes: Lanes
    ) -> tuple[Batch, Float[Array, "L N"]]:
        """Return advantages and targets, in minibatches of whole lanes, and residuals [nats]."""
        settings = self.settings
        groups = settings.num_minibatches

        def values(features: Array) -> Array:
            return losses.value_of_output(over_lanes(value, -1)(features)[0], settings.loss_scale)

        def group(x: Array) -> Array:
            """Return [L, ..., N] as [G, ..., L N / G], with exploring lanes in each group."""
            x = x.reshape(*x.shape[:-1], -1, groups)
            x = jnp.moveaxis(x, (-1, 0), (0, -2))
            return x.reshape(*x.shape[:-2], -1)

        seen, log_probabilities = segment.seen
        features = group(seen)
        now = jax.lax.map(values, features).reshape(groups, settings.segment, -1)
        now = jnp.moveaxis(now, 0, -1).reshape(settings.segment, -1)
        last = values(over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes))
        later = jnp.where(segment.ended, 0.0, jnp.concatenate([now[1:], last[None]]))
        residual = self.soft_rewards(segment) + later - now
        advantage = losses.discounted(residual, segment.ended, settings.gae_lambda)
        columns = (segment.action, log_probabilities, advantage, now, advantage + now)
        return Batch(features, *map(group, columns)), residual

    def soft_rewards(self, segment: Segment) -> Float[Array, "L N"]:
        """Return beta r - log pi of each step (the paper, eq. 6, times beta), nats.

        The uniform measure takes log A off each step; the counting measure takes nothing.
        """
        forbidden = jnp.isneginf(segment.reward)
        earned = jnp.where(forbidden, -KNOWN_PENALTY, self.problem.beta * segment.reward)
        return earned - segment.log_probability - log_measure(self.problem)

    def update(self, carry: tuple, batch: Batch) -> tuple[tuple, None]:
        """Take one optimiser step of the policy and of the value on a minibatch."""
        policy, value, policy_state, value_state = carry
        policy, policy_state = self.descend(self.policy_loss, policy, policy_state, batch)
        value, value_state = self.descend(self.value_loss, value, value_state, batch)
        return (policy, value, policy_state, value_state), None

    def descend(self, loss: Any, network: DenseNetwork, state: Any, batch: Batch) -> tuple:
        """Take one optimiser step on a loss."""
        updates, state = self.optimiser.update(jax.grad(loss)(network, batch), state)
        return optax.apply_updates(cast(Any, network), updates), state

    def policy_loss(self, policy: DenseNetwork, batch: Batch) -> Array:
        """Return the mean clipped surrogate of a minibatch."""

        def loss(features: Array, action: Array, old: Array, advantage: Array) -> Array:
            new = jax.nn.log_softmax(policy(features))
            return losses.policy_loss(new, old, action, advantage, clip=self.settings.clip)

        # the scale depends on the state alone: with one for each action the best policy would move
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
