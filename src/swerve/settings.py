"""How to learn and sample, as far as it is said."""

from __future__ import annotations

import dataclasses
from typing import Any

from swerve.arguments import whole_number
from swerve.samples import METHODS
from swerve.specification import Specification


@dataclasses.dataclass(frozen=True)
class Settings:
    """How to learn and sample; None stands for what was last worked out with, or the default.

    Attributes:
      solver: a solver specification (default: `nominal.default_solver`).
      seed: of learning and sampling (default 0).
      method: "importance" (default) or "plain".
      num_trajectories: N a task (default 10,000).

    Raises:
      ValueError: if there is no such method, or a number is out of range.
    """

    solver: str | None = None
    seed: int | None = None
    method: str | None = None
    num_trajectories: int | None = None

    def __post_init__(self) -> None:
        if self.solver is not None:
            object.__setattr__(self, "solver", str(Specification.parse(self.solver)))
        if self.method is not None and self.method not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if self.num_trajectories is not None:
            whole_number(self.num_trajectories, "samples", 2)
        if self.seed is not None:
            whole_number(self.seed, "seed", 0)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Settings:
        """Rebuild settings from JSON data, leaving out what is not known here."""
        names = {field.name for field in dataclasses.fields(cls)}
        return cls(**{name: value for name, value in data.items() if name in names})

    def completed(self, others: Settings) -> Settings:
        """Return these settings, with those of others where there is none."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return dataclasses.replace(others, **given)
