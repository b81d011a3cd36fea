"""How to learn and sample a problem: solver, seed, method and number of trajectories."""

from __future__ import annotations

import dataclasses
from typing import Any

from swerve.base.arguments import seed_number, whole_number
from swerve.base.solver_kinds import check_solver_name, kind_named, solver_names
from swerve.base.specification import Specification
from swerve.evidence.samples import EXACT, METHODS, NUM_KEPT

NUM_TRAJECTORIES = 10_000  # default N a task: resolves probabilities down to about 1e-4
MOST_TRAJECTORIES = 10_000_000  # N a task that memory is asked for: more is a slip of the keyboard


@dataclasses.dataclass(frozen=True)
class Settings:
    """How to learn and sample; None stands for the value used last in the folder, or the default.

    Attributes:
      solver: a solver specification (default: `learn.default_solver`).
      seed: seed of learning and sampling (default 0).
      method: "smc" (default of solvers with a soft value), "importance" (default of other solvers
        that are sampled) or "plain"; "exact" of solvers that give exact answers.
      num_trajectories: N a task (default NUM_TRAJECTORIES).

    Raises:
      ValueError: if there is no such method, the method does not suit the solver, or a number is
        out of range.
    """

    solver: str | None = None
    seed: int | None = None
    method: str | None = None
    num_trajectories: int | None = None

    def __post_init__(self) -> None:
        if self.solver is not None:
            specification = Specification.parse(self.solver)
            check_solver_name(specification.target)
            object.__setattr__(self, "solver", str(specification))
            self._check_method_suits(self.solver)
        is_exact = self.solver is not None and kind_named(self.solver).is_exact
        if self.method not in (None, *METHODS, *([EXACT] if is_exact else [])):
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if is_exact and self.num_trajectories not in (None, NUM_KEPT):
            raise ValueError(
                f"samples: solver {self.solver!r} gives exact answers, leave "
                f"{self.num_trajectories} out"
            )
        if self.num_trajectories is not None:
            whole_number(self.num_trajectories, "samples", 2, MOST_TRAJECTORIES)
        if self.seed is not None:
            seed_number(self.seed)

    def _check_method_suits(self, solver: str) -> None:
        """Raise ValueError if a solver cannot be sampled by the method."""
        kind = kind_named(solver)
        if kind.is_exact and self.method not in (None, EXACT):
            raise ValueError(
                f"method: solver {solver!r} gives exact answers, leave {self.method!r} out"
            )
        if self.method == "smc" and not kind.has_soft_value:
            names = ", ".join(solver_names(lambda kind: kind.has_soft_value))
            raise ValueError(
                f"method: 'smc' needs a solver with a soft value ({names}), got "
                f"{Specification.parse(solver).target!r}: use 'importance'"
            )

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Settings:
        """Rebuild settings from JSON data, leaving out names that this version does not know."""
        names = {field.name for field in dataclasses.fields(cls)}
        return cls(**{name: value for name, value in data.items() if name in names})

    def completed(self, others: Settings) -> Settings:
        """Return these settings, with the values of others where these have None.

        A method, and the N of an exact answer, are not taken over from a solver of another kind.
        """
        given = {name: value for name, value in vars(self).items() if value is not None}
        if self.solver is not None and others.solver is not None:
            mine = kind_named(self.solver).default_method
            theirs = kind_named(others.solver).default_method
            num = None if EXACT in (mine, theirs) else others.num_trajectories
            if mine != theirs:
                others = Settings(seed=others.seed, num_trajectories=num)
        return dataclasses.replace(others, **given)

    def filled(self) -> Settings:
        """Return these settings with the defaults where these have None; the solver is known."""
        assert self.solver is not None
        method = kind_named(self.solver).default_method
        num = NUM_KEPT if method == EXACT else NUM_TRAJECTORIES
        defaults = {"seed": 0, "method": method, "num_trajectories": num}
        given = {name: value for name, value in vars(self).items() if value is not None}
        return Settings(**defaults | given)
