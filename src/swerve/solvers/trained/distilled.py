"""A direct policy distilled from a soft value: one network evaluation a step.

Looking ahead asks the soft value once for every action. A smaller network that gives the logits of
the policy and the soft value at once is made to do as it does, where it leads and anywhere else,

    loss = KL(pi_look || pi) + Huber((V - B V) / (1 + |B V| / scale)).

It is several times quicker to sample and a little further from pi_0. Having a value, it is sampled
by sequential Monte Carlo, whose weights make up for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from swerve.base.space import Task
from swerve.problem.problem import Problem
from swerve.simulation.policies import ValuedPolicy
from swerve.solvers.trained.distilled_training import Trainer
from swerve.solvers.trained.soft_value import SoftValue
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver


@dataclass(frozen=True)
class Distilled(TrainingSolver):
    """Solver: a policy network that imitates looking ahead with a soft value.

    Attributes:
      num_steps: environment steps to train for.
      num_lanes: N, episodes simulated side by side, under the policy that is imitated.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G, updates a pass; has to divide the segment.
      learning_rate: at first, falling to a hundredth.
      width: of the two hidden layers.
      loss_scale: nats; errors of the value are divided by 1 + |target| / this.
    """

    num_steps: int = 8_000_000
    num_lanes: int = 512
    segment: int = 32
    explore: float = 0.5
    num_epochs: int = 2
    num_minibatches: int = 8
    learning_rate: float = 3e-3
    width: int = 64
    loss_scale: float = 5.0

    name = "distilled"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_divides("num_minibatches", "segment")

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> TrainedNominal:
        """Learn a soft value with `SoftValue()`, and imitate looking ahead with it.

        The checkpoint of the soft value is a file beside that of the imitation, its name with
        `.teacher` appended.
        """
        beside = checkpoint and checkpoint.with_name(f"{checkpoint.name}.teacher")
        teacher = SoftValue().learn(
            problem, tasks=tasks, seed=seed, progress=progress, checkpoint=beside
        )
        return self.imitate(
            teacher, tasks=tasks, seed=seed, progress=progress, checkpoint=checkpoint
        )

    def imitate(
        self,
        teacher: object,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> TrainedNominal:
        """Return a direct policy that does as a nominal distribution with a soft value.

        Args:
          teacher: from `SoftValue`.
          tasks: those on which KL and ESS are estimated; drawn if None.
          seed: of everything random.
          progress: whether to show a bar.
          checkpoint: file that is written after every chunk and resumed from; None for neither.

        Raises:
          ValueError: if the teacher's policy has no soft value.
        """
        if not isinstance(teacher, TrainedNominal) or not isinstance(teacher.policy, ValuedPolicy):
            name = getattr(getattr(teacher, "solver", teacher), "name", teacher)
            raise ValueError(f"teacher: expected what swerve.SoftValue() learned, got {name!r}")
        trainer = Trainer(teacher.problem, self, seed, teacher.policy)
        return self.train(trainer, teacher.problem, tasks, seed, progress, checkpoint)

    def trainer(self, problem: Problem, seed: int) -> Trainer:
        """Return what would train, had it something to imitate."""
        return Trainer(problem, self, seed, None)
