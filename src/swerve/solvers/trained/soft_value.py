"""Neural soft values: one goal-conditioned network for every start and goal, any dimension.

    V_t(s) = log mean_a exp(beta r(s, a, s') + V_{t+1}(s'))    (sum for the counting measure)

An iteration rolls out one segment of L steps in all lanes under the look-ahead policy of the
current network; a share of the lanes starts anywhere in state and time. At each step that policy
computes (B V)_t(s), the right-hand side above, so the residual

    delta_t = (B V)_t(s_t) - V_t(s_t)

costs nothing. V is moved towards its lambda-return,

    V_t(s_t) + sum_k lambda^k delta_{t+k},

a sum that ends with the episode or the segment. V is a network plus the terminal reward, which
fades with the time to go. Where an episode ends, r_T is paid and V is not used. When the KL
divergence on a few tasks stops improving, training goes on to the last part of its schedule, in
which the learning rate falls.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from swerve.problem.problem import Problem
from swerve.simulation.policies import LOWEST, LookAhead
from swerve.solvers.base import AdaptingSolver
from swerve.solvers.trained import losses
from swerve.solvers.trained.lanes import Lanes, over_lanes
from swerve.solvers.trained.networks import DenseNetwork
from swerve.solvers.trained.probe import Progress
from swerve.solvers.trained.segments import Segment
from swerve.solvers.trained.trainers import NetworkState, NetworkTrainer
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver

PATIENCE = 15  # chunks without improvement after which training goes on to its last part
IMPROVED = 0.97  # a KL below this share of the least KL so far is an improvement
SLACK = 1e-6  # relative rounding error allowed at the ends of the span of beta
ADAPTING_SHARE = 0.1  # share of num_steps for a round of adapting to a constraint in force
ADAPTING_STEPS = 1_000_000  # environment steps of a round, at least, however few num_steps is
ADAPTING_ROUNDS = 5  # rounds of adapting to a constraint in force, at most
DOOMED_MARGIN = 100.0
"""Nats below the least unconstrained value, for states that cannot avoid the constraint."""
NEAR_FLOOR = 0.9  # share of the floor: values below were meant to be the floor
NUM_ASKED = 4096  # states in which the least unconstrained value is looked for


@dataclass(frozen=True)
class SoftValue(TrainingSolver, AdaptingSolver[TrainedNominal]):
    """Solver: a soft value network, and one-step look-ahead with it.

    Attributes:
      num_steps: environment steps to train for at most.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G, updates a pass; must divide the segment.
      trace: lambda of the returns; 0 trusts the network, 1 the residuals along the segment.
      learning_rate: learning rate at first; it falls to a hundredth.
      width: width of the two hidden layers.
      loss_scale: nats; errors are divided by 1 + |target| / loss_scale.
      fade: share of the horizon in which the terminal reward fades to 1 / e of itself.
      floor: least value [nats], given to states that cannot avoid a known constraint. Choose it far
        below the values that matter, but no further: the network has to follow the cliff.
      beta_span: one network serves every beta from the problem's beta / beta_span to beta *
        beta_span, which takes longer to learn; 1 for the beta of the problem alone.
    """

    num_steps: int = 36_000_000
    num_lanes: int = 512
    segment: int = 32
    explore: float = 0.5
    num_epochs: int = 2
    num_minibatches: int = 8
    trace: float = 0.95
    learning_rate: float = 3e-3
    width: int = 160
    loss_scale: float = 5.0
    fade: float = 0.04
    floor: float = LOWEST
    beta_span: float = 1.0

    name = "soft-value"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers(shares=("trace",), positive=("fade",))
        self.check_divides("num_minibatches", "segment")
        if not LOWEST <= self.floor < 0.0:
            raise ValueError(
                f"SoftValue: floor: expected a number from {LOWEST:g} to below 0, got {self.floor}"
            )
        if not (math.isfinite(self.beta_span) and self.beta_span >= 1.0):
            raise ValueError(f"SoftValue: beta_span: expected a number >= 1, got {self.beta_span}")

    def at_beta(self, nominal: TrainedNominal, beta: float) -> TrainedNominal:
        """Return the nominal distribution for another beta of the span.

        Raises:
          ValueError: if beta is outside the span.
        """
        assert isinstance(nominal.policy, SoftValuePolicy)
        learned_for = nominal.policy.problem.beta
        if not self.covers(nominal, beta):
            low, high = learned_for / self.beta_span, learned_for * self.beta_span
            raise ValueError(
                f"beta: expected one from {low:g} to {high:g}, which the soft value was learned "
                f"for, got {beta:g}: learn with a larger beta_span, or let "
                "swerve.sample(nominal, tasks, beta=...) go on from there"
            )
        problem = replace(nominal.problem, beta=beta)
        policy = nominal.policy.at(math.log(beta / learned_for))
        return replace(nominal, problem=problem, policy=policy)

    def covers(self, nominal: TrainedNominal, beta: float) -> bool:
        """Return whether a beta is in the span of a nominal distribution."""
        assert isinstance(nominal.policy, SoftValuePolicy)
        learned_for, span = nominal.policy.problem.beta, self.beta_span * (1.0 + SLACK)
        return learned_for / span <= beta <= learned_for * span

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> TrainedNominal:
        """Rebuild the nominal distribution whose `arrays` were stored."""
        nominal = super().restore(problem, arrays)
        policy = nominal.policy
        assert isinstance(policy, SoftValuePolicy)
        learned_for = replace(problem, beta=problem.beta / math.exp(policy.log_beta))
        return replace(nominal, policy=replace(policy, problem=learned_for))

    def trainer(self, problem: Problem, seed: int) -> SoftValueTrainer:
        """Return a trainer for a problem."""
        return SoftValueTrainer(problem, self, seed)

    def adapted(
        self, nominal: TrainedNominal, problem: Problem, seed: int
    ) -> Iterator[TrainedNominal]:
        """Yield nominal distributions of a problem with more known constraints, the best last.

        Training goes on from the network that was learned without these constraints, now with them
        in force. The rounds end early if training diverges.
        """
        num_steps = max(ADAPTING_STEPS, round(ADAPTING_SHARE * self.num_steps))
        assert isinstance(nominal.policy, SoftValuePolicy)
        floor = nominal.policy.settings.floor
        if floor == LOWEST:
            floor = least_value(nominal.policy, seed) - DOOMED_MARGIN
        settings = replace(self, num_steps=num_steps, floor=floor)
        learned_for = nominal.policy.problem.beta
        trainer = settings.trainer(replace(problem, beta=learned_for), seed)
        first = trainer.initial_state()
        state = first._replace(network=nominal.policy.network)
        for _ in range(ADAPTING_ROUNDS):
            state, _ = trainer.run(state, settings.num_iterations)
            if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.network)):
                return
            policy = trainer.policy(state.network).at(nominal.policy.log_beta)
            yield TrainedNominal(problem, self, policy, nominal.history)
            state = state._replace(optimiser=first.optimiser)  # the rate falls anew in each round

    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether the KL has not improved for PATIENCE chunks."""
        kl = [progress.kl for progress in history]
        return len(kl) > PATIENCE and min(kl[-PATIENCE:]) > IMPROVED * min(kl[:-PATIENCE])


class SoftValuePolicy(LookAhead):
    """The look-ahead policy of the network, for all goals.

    Attributes:
      problem: problem that was learned.
      settings: the solver: scale of the values, and how the terminal reward fades.
      network: network that gives the soft value.
      log_beta: log of the beta of the policy, relative to the problem's.
    """

    problem: Problem = eqx.field(static=True)
    settings: SoftValue = eqx.field(static=True)
    network: DenseNetwork
    log_beta: Float[Array, ""]

    @property
    def beta(self) -> Float[Array, ""]:
        """Inverse temperature of the policy."""
        return self.problem.beta * jnp.exp(self.log_beta)

    @property
    def least_value(self) -> float:
        """Soft values below this one [nats] stand for states that known constraints close in."""
        return NEAR_FLOOR * self.settings.floor

    def at(self, log_beta: float | Float[Array, ""]) -> SoftValuePolicy:
        """Return the policy for another beta, given its log relative to the problem's."""
        log = jnp.asarray(log_beta, jnp.float32)
        return SoftValuePolicy(self.problem, self.settings, self.network, log)

    def value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return V: the sum of the network and of the fading terminal reward."""
        return self.value_of(*self.inputs(state, step, goal))

    def inputs(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> tuple[Float[Array, " F"], Float[Array, ""]]:
        """Return the features of a state, and beta r_T, faded with the time to go [nats]."""
        mdp, settings = self.problem.mdp, self.settings
        share_to_go = (mdp.num_steps - jnp.asarray(step, jnp.float32)) / mdp.num_steps
        terminal = jnp.maximum(self.beta * mdp.terminal_reward(state, goal), LOWEST)
        shape = terminal * jnp.exp(-share_to_go / settings.fade)
        features = mdp.features(state, step, goal)
        if settings.beta_span > 1.0:
            place = self.log_beta / math.log(settings.beta_span)
            features = jnp.append(features, place)
        return features, shape

    def value_of(self, features: Float[Array, " F"], shape: Float[Array, ""]) -> Float[Array, ""]:
        """Return V for the numbers that `inputs` returns."""
        output = self.network(features)[0]
        learned = losses.value_of_output(output, self.settings.loss_scale)
        return jnp.maximum(learned + shape, self.settings.floor)


class SoftValueTrainer(NetworkTrainer):
    """One run of soft value learning."""

    settings: SoftValue

    def policy(self, network: DenseNetwork) -> SoftValuePolicy:
        """Return the look-ahead policy of a network."""
        return SoftValuePolicy(self.problem, self.settings, network, jnp.float32(0.0))

    def probed(self, state: NetworkState) -> list[tuple[SoftValuePolicy, float]]:
        """Return the policies for the problem's beta and for the ends of the span of betas."""
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
        """Return the function from features [F, N] and faded terminal rewards [N] to values [N]."""
        each = over_lanes(self.policy(network).value_of, -1, -1)
        return lambda inputs: each(*inputs)

    def loss(self, network: DenseNetwork, batch: tuple[Array, ...]) -> Float[Array, ""]:
        """Return the mean Huber loss of relative errors."""
        *inputs, target = batch
        scale = losses.loss_scale(target, self.settings.loss_scale)
        return jnp.mean(losses.huber((self.values(network)(inputs) - target) / scale))


def least_value(policy: SoftValuePolicy, seed: int) -> float:
    """Return the least soft value of states anywhere at any time, with any goal [nats].

    The result is 0 at most. States that cannot avoid a known constraint do not count: their learned
    values lie near LOWEST.
    """
    mdp = policy.problem.mdp
    key_state, key_step, key_task = jax.random.split(jax.random.key(seed), 3)
    states = jax.vmap(mdp.sample_state)(jax.random.split(key_state, NUM_ASKED))
    steps = jax.random.randint(key_step, (NUM_ASKED,), 0, mdp.num_steps, jnp.int32)
    goals = jax.vmap(mdp.sample_task)(jax.random.split(key_task, NUM_ASKED)).goal
    values = np.asarray(jax.vmap(policy.value)(states, steps, goals))
    return float(values[values > 0.5 * LOWEST].min(initial=0.0))
