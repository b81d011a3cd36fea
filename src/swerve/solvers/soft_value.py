"""Neural soft values: one goal-conditioned network for every start and goal, any dimension.

    V_t(s) = log mean_a exp(beta r(s, a, s') + V_{t+1}(s'))    (sum for the counting measure),

regressed on lambda-returns of its own residuals under its own look-ahead policy, from exploring
starts over state and time beside on-policy rollouts; see `soft_value_training`. V is a network plus
the terminal reward, which fades with the time to go. Where an episode ends V is not asked: r_T is
paid. Training ends when the KL divergence that a few tasks show stops improving.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import numpy as np

from swerve.arguments import whole_number
from swerve.problem import Problem
from swerve.solvers.soft_value_training import SoftValuePolicy, Trainer
from swerve.solvers.training import Progress, TrainedNominal, TrainingSolver

PATIENCE = 12  # chunks without improvement after which training ends
IMPROVED = 0.97  # of the least KL so far
SLACK = 1e-6  # relative, at the ends of the span of beta
ADAPTING_SHARE = 0.1  # of the steps, for one more known constraint


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
    beta_span: float = 1.0

    name = "soft-value"
    adapting_rounds = 5

    def __post_init__(self) -> None:
        for field in (
            "num_steps",
            "num_lanes",
            "segment",
            "num_epochs",
            "num_minibatches",
            "width",
        ):
            whole_number(getattr(self, field), f"SoftValue: {field}", 1)
        if self.segment % self.num_minibatches:
            raise ValueError(
                f"SoftValue: num_minibatches: expected a divisor of the segment {self.segment}, "
                f"got {self.num_minibatches}"
            )
        for field in ("explore", "trace"):
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(
                    f"SoftValue: {field}: expected a number from 0 to 1, got {getattr(self, field)}"
                )
        if not (math.isfinite(self.beta_span) and self.beta_span >= 1.0):
            raise ValueError(f"SoftValue: beta_span: expected a number >= 1, got {self.beta_span}")
        for field in ("learning_rate", "loss_scale", "fade"):
            if not getattr(self, field) > 0.0:
                raise ValueError(
                    f"SoftValue: {field}: expected a number > 0, got {getattr(self, field)}"
                )

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

    def adapt(self, nominal: TrainedNominal, problem: Problem, seed: int) -> TrainedNominal:
        """Return the nominal distribution of a problem with more known constraints.

        Training goes on for a while with these, from what was learned without them.
        """
        num_steps = max(1, round(ADAPTING_SHARE * self.num_steps))
        settings = replace(self, num_steps=num_steps)
        assert isinstance(nominal.policy, SoftValuePolicy)
        learned_for = nominal.policy.problem.beta
        trainer = settings.trainer(replace(problem, beta=learned_for), seed)
        state = trainer.initial_state()._replace(network=nominal.policy.network)
        trained, _ = trainer.run(state, settings.num_iterations)
        if all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(trained.network)):
            state = trained  # else what was there before is the better one
        policy = trainer.policy_of(state).at(nominal.policy.log_beta)
        return TrainedNominal(problem, self, policy, nominal.history)

    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether the KL has not improved for PATIENCE chunks."""
        kl = [progress.kl for progress in history]
        return len(kl) > PATIENCE and min(kl[-PATIENCE:]) > IMPROVED * min(kl[:-PATIENCE])
