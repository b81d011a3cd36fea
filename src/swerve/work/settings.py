"""How to learn and sample, as far as it is said."""

from __future__ import annotations

import dataclasses
from typing import Any

from swerve.base.arguments import whole_number
from swerve.evidence.samples import EXACT, METHODS, NUM_KEPT, SMC_SOLVERS
from swerve.problem.loading import Specification

EXACT_SOLVERS = ("enumeration", "tabular", "discrete", "soft-paths")


@dataclasses.dataclass(frozen=True)
class Settings:
    """How to learn and sample; None stands for what was last worked out with, or the default.

    Attributes:
      solver: a solver specification (default: `nominal.default_solver`).
      seed: of learning and sampling (default 0).
      method: "smc" (default of solvers with a soft value), "importance" (of others that sample) or
        "plain".
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
        exact = _is_exact(self.solver)
        if exact and self.method not in (None, EXACT):
            raise ValueError(
                f"method: solver {self.solver!r} gives exact answers, leave {self.method!r} out"
            )
        if self.method not in (None, *METHODS, *([EXACT] if exact else [])):
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if self.method == "smc" and self.solver is not None:
            name = Specification.parse(self.solver).target
            if name not in SMC_SOLVERS:
                raise ValueError(
                    f"method: 'smc' needs a solver with a soft value ({', '.join(SMC_SOLVERS)}), "
                    f"got {name!r}: use 'importance'"
                )
        if exact and self.num_trajectories not in (None, NUM_KEPT):
            raise ValueError(
                f"samples: solver {self.solver!r} gives exact answers, leave "
                f"{self.num_trajectories} out"
            )
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
        if self.solver is not None and others.solver is not None:
            mine, theirs = _default_method(self.solver), _default_method(others.solver)
            num = None if EXACT in (mine, theirs) else others.num_trajectories
            if mine != theirs:
                others = Settings(seed=others.seed, num_trajectories=num)
        return dataclasses.replace(others, **given)

    def filled(self) -> Settings:
        """Return these settings with the defaults where there is none; the solver is known."""
        assert self.solver is not None
        method = _default_method(self.solver)
        defaults = {"seed": 0, "method": method, "num_trajectories": 10_000}
        if method == EXACT:
            defaults["num_trajectories"] = NUM_KEPT
        given = {name: value for name, value in vars(self).items() if value is not None}
        return Settings(**defaults | given)


def _is_exact(solver: str | None) -> bool:
    """Return whether a solver, if one is named, gives exact answers."""
    return solver is not None and _default_method(solver) == EXACT


def _default_method(solver: str) -> str:
    """Return how a solver is sampled unless something else is asked for."""
    name = Specification.parse(solver).target
    if name in EXACT_SOLVERS:
        return EXACT
    return "smc" if name in SMC_SOLVERS else "importance"
