"""Maximum-entropy proximal policy optimisation: one goal-conditioned policy for all tasks.

The paper's way to pi_0: maximise its eq. 6, where the log-probability of the executed action is
part of the return at weight 1 / beta, here with everything times beta, in nats. Half of the lanes
start anywhere at any time (exploring starts), half where tasks start; see `ppo_training` for an
iteration and `training` for a run of them.
"""

from __future__ import annotations

from dataclasses import dataclass

from swerve.problem.problem import Problem
from swerve.solvers.trained.ppo_training import Trainer
from swerve.solvers.trained.training import TrainingSolver


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
      gae_lambda: of the advantages.
      clip: of the surrogate.
      learning_rate: at first, falling linearly to a hundredth.
      width: of the two hidden layers of the policy and of the value network.
      loss_scale: nats; losses are divided by 1 + |value| / this.
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

    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return what trains for a problem."""
        return Trainer(problem, self, seed)
