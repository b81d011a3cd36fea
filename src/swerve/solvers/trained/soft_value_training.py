"""One run of soft value learning: what is learned from a segment.

An iteration rolls out one segment of L steps in all lanes under the look-ahead policy of the
network as it is. At each step that policy works out (B V)_t(s), so the residual

    delta_t = (B V)_t(s_t) - V_t(s_t)

costs nothing, and V is moved towards its lambda-return

    V_t(s_t) + sum_k lambda^k delta_{t+k},

the sum ending with the episode or the segment.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.policies import LOWEST, LookAhead
from swerve.solvers.trained import losses
from swerve.solvers.trained.lanes import Lanes, over_lanes
from swerve.solvers.trained.network_training import NetworkState, NetworkTrainer
from swerve.solvers.trained.networks import DenseNetwork
from swerve.solvers.trained.segments import Segment

if TYPE_CHECKING:
    from swerve.solvers.trained.soft_value import SoftValue


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
        return jnp.maximum(learned + shape, self.settings.floor)


class Trainer(NetworkTrainer):
    """One run."""

    settings: SoftValue

    def policy(self, network: DenseNetwork) -> SoftValuePolicy:
        """Return the look-ahead policy of a network."""
        return SoftValuePolicy(self.problem, self.settings, network, jnp.zeros(()))

    def probed(self, state: NetworkState) -> list[tuple[SoftValuePolicy, float]]:
        """Return the policies of the problem's beta, and of the ends of the span of betas."""
        policy, span = self.policy(state.network), self.settings.beta_span
        factors = (1.0, 1.0 / span, span) if span > 1.0 else (1.0,)
        return [(policy.at(math.log(x)), x * self.problem.beta) for x in factors]

    def sizes(self, num_features: int) -> tuple[int, int]:
        """Return how many inputs and outputs the network has; beta may be an input."""
        return num_features + (self.settings.beta_span > 1.0), 1

    def look(
        self, state: NetworkState, lane: Lanes, place: Array
    ) -> tuple[Array, tuple[Array, Array, Array]]:
        """Return log pi [A], the inputs of V, and (B V)_t(s) [nats]."""
        policy = self.policy(state.network).at(
            (2.0 * place - 1.0) * math.log(self.settings.beta_span)
        )
        log_probabilities, backed = policy.propose(*lane)
        return log_probabilities, (*policy.inputs(*lane), jnp.maximum(backed, self.settings.floor))

    def columns(
        self, network: DenseNetwork, segment: Segment
    ) -> tuple[tuple[Array, ...], Float[Array, "L N"]]:
        """Return the inputs of V with its lambda-returns, and the residuals [nats]."""
        *inputs, backed = segment.seen
        now = jax.lax.map(self.values(network), inputs)
        residual = backed - now
        target = now + losses.discounted(residual, segment.ended, self.settings.trace)
        return (*inputs, target), residual

    def values(self, network: DenseNetwork) -> Any:
        """Return what maps features [F, N] and shapes [N] to values [N]."""
        each = over_lanes(self.policy(network).value_of, -1, -1)
        return lambda inputs: each(*inputs)

    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Float[Array, ""]:
        """Return the mean Huber loss of relative errors."""
        *inputs, target = batch
        scale = losses.loss_scale(target, self.settings.loss_scale)
        return jnp.mean(losses.huber((self.values(network)(inputs) - target) / scale))
