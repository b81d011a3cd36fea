"""Hold and check the settings that all solvers which train have in common.

Shapes: N lanes, L steps of a segment, G minibatches.
"""

from __future__ import annotations

from collections.abc import Sequence

from swerve.base.arguments import positive_number, whole_number
from swerve.solvers.trained.probe import Progress

NUM_CHUNKS = 40  # chunks of a run: as many checkpoints, and as many rows of the history


class TrainingSettings:
    """Settings of training in chunks of iterations; an iteration is a segment in every lane.

    Subclasses are frozen dataclasses, with these among their settings.

    Attributes:
      name: name of the solver on the command line.
      num_steps: environment steps to train for.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G, updates a pass.
      learning_rate: learning rate at first.
      width: width of the two hidden layers.
      loss_scale: scale of the losses, nats.
    """

    name: str
    num_steps: int
    num_lanes: int
    segment: int
    explore: float
    num_epochs: int
    num_minibatches: int
    learning_rate: float
    width: int
    loss_scale: float

    def __post_init__(self) -> None:
        """Check the settings that all solvers which train have."""
        self.check_numbers(
            whole=("num_steps", "num_lanes", "segment", "num_epochs", "num_minibatches", "width"),
            shares=("explore",),
            positive=("learning_rate", "loss_scale"),
        )

    def check_numbers(
        self,
        *,
        whole: Sequence[str] = (),
        shares: Sequence[str] = (),
        positive: Sequence[str] = (),
    ) -> None:
        """Check that settings are whole numbers >= 1, shares from 0 to 1, or numbers > 0.

        Raises:
          ValueError: naming the first setting that is out of range.
        """
        solver = type(self).__name__
        for field in whole:
            whole_number(getattr(self, field), f"{solver}: {field}", 1)
        for field in shares:
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(
                    f"{solver}: {field}: expected a number from 0 to 1, got {getattr(self, field)}"
                )
        for field in positive:
            positive_number(getattr(self, field), f"{solver}: {field}")

    def check_divides(self, part: str, whole: str) -> None:
        """Raise ValueError unless one setting divides another."""
        first, second = getattr(self, part), getattr(self, whole)
        if second % first:
            raise ValueError(
                f"{type(self).__name__}: {part}: expected a divisor of {whole}, {second}, got "
                f"{first}"
            )

    def has_settled(self, history: list[Progress]) -> bool:
        """Return whether training may go on to the last part of its schedule: False by default."""
        return False

    @property
    def chunk_iterations(self) -> int:
        """Iterations between two checkpoints."""
        return max(1, round(self.num_steps / (self.num_lanes * self.segment * NUM_CHUNKS)))

    @property
    def chunk_steps(self) -> int:
        """Environment steps between two checkpoints."""
        return self.chunk_iterations * self.num_lanes * self.segment

    @property
    def num_chunks(self) -> int:
        """Chunks of a run: about NUM_CHUNKS."""
        return max(1, round(self.num_steps / self.chunk_steps))

    @property
    def num_iterations(self) -> int:
        """Iterations of a whole run."""
        return self.num_chunks * self.chunk_iterations
