"""Neural soft values: one goal-conditioned network for every start and goal, any dimension.

    V_t(s) = log mean_a exp(beta r(s, a, s') + V_{t+1}(s'))    (sum for the counting measure),

regressed on lambda-returns of its own residuals under its own look-ahead policy, from exploring
starts over state and time beside on-policy rollouts; see `soft_value_training`. V is a network plus
the terminal reward, which fades with the time to go. Where an episode ends V is not asked: r_T is
paid. When the KL divergence that a few tasks show stops improving, training goes to its end: the
last part of its schedule, in which the learning rate falls.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np

from swerve.problem.problem import Problem
from swerve.simulation.policies import LOWEST
from swerve.solvers.trained.run import Progress
from swerve.solvers.trained.soft_value_training import SoftValuePolicy, Trainer
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver

PATIENCE = 15  # chunks without improvement after which training goes to its end
IMPROVED = 0.97  # of the least KL so far
SLACK = 1e-6  # relative, at the ends of the span of beta
ADAPTING_SHARE = 0.1  # of the steps, for a round of adapting to one more known constraint
ADAPTING_STEPS = 1_000_000  # of a round, at least, however easy the rest was to learn
ADAPTING_ROUNDS = 5
DOOMED = 100.0  # nats below the worst that there is without a constraint, of who has to enter it
NUM_ASKED = 4096  # states, for that worst


@dataclass(frozen=True)
class SoftValue(TrainingSolver):
    """Solver: a soft value network, and one-step look-ahead with it.

    Attributes:
      num_steps: environment steps to train for at most.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G, updates a pass; has to divide the segment.
      trace: lambda of the returns; 0 trusts the network, 1 the residuals along the segment.
      learning_rate: at first, falling to a hundredth.
      width: of the two hidden layers.
      loss_scale: nats; errors are divided by 1 + |target| / this.
      fade: share of the horizon in which the terminal reward fades to 1 / e of itself.
      floor: of states from which a known constraint cannot be avoided, and of whatever is worse
        [nats]. Far below what matters, but no further: the network has to follow the cliff.
      beta_span: one network serves every beta from the problem's divided by this to that times it,
        which takes longer to learn as well; 1 for that of the problem alone.
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
          ValueError: if beta is beyond the span.
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
        """Return whether a nominal distribution was learned for a beta too."""
        assert isinstance(nominal.policy, SoftValuePolicy)
        learned_for, span = nominal.policy.problem.beta, self.beta_span * (1.0 + SLACK)
        return learned_for / span <= beta <= learned_for * span

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> TrainedNominal:
        """Return the nominal distribution whose `arrays` were stored."""
        nominal = super().restore(problem, arrays)
        policy = nominal.policy
        assert isinstance(policy, SoftValuePolicy)
        learned_for = replace(problem, beta=problem.beta / math.exp(policy.log_beta))
        return replace(nominal, policy=replace(policy, problem=learned_for))

    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return what trains for a problem."""
        return Trainer(problem, self, seed)

    def adapted(
        self, nominal: TrainedNominal, problem: Problem, seed: int
    ) -> Iterator[TrainedNominal]:
        """Yield the nominal distribution of a problem with more known constraints, ever better.

        Training goes on with these, from what was learned without them; it ends where it diverges.
        """
        num_steps = max(ADAPTING_STEPS, round(ADAPTING_SHARE * self.num_steps))
        assert isinstance(nominal.policy, SoftValuePolicy)
        floor = nominal.policy.settings.floor
        if floor == LOWEST:
            floor = least_value(nominal.policy, seed) - DOOMED
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
            state = state._replace(optimiser=first.optimiser)  # whose rate falls with each round

    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether the KL has not improved for PATIENCE chunks."""
        kl = [progress.kl for progress in history]
        return len(kl) > PATIENCE and min(kl[-PATIENCE:]) > IMPROVED * min(kl[:-PATIENCE])


def least_value(policy: SoftValuePolicy, seed: int) -> float:
    """Return the least soft value of states anywhere at any time, on the way to any goal [nats].

    It is 0 at most. States from which a known constraint cannot be avoided do not count: the values
    that were learned for them lie about LOWEST.
    """
    mdp = policy.problem.mdp
    key_state, key_step, key_task = jax.random.split(jax.random.key(seed), 3)
    states = jax.vmap(mdp.sample_state)(jax.random.split(key_state, NUM_ASKED))
    steps = jax.random.randint(key_step, (NUM_ASKED,), 0, mdp.num_steps)
    goals = jax.vmap(mdp.sample_task)(jax.random.split(key_task, NUM_ASKED)).goal
    values = np.asarray(jax.vmap(policy.value)(states, steps, goals))
    return float(values[values > 0.5 * LOWEST].min(initial=0.0))
