"""Say what kind each solver is, in one table that the other packages read.

A new solver is one file below `swerve/solvers`, which defines its class, and one line of `KINDS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial


@dataclass(frozen=True)
class SolverKind:
    """Facts about a solver that the library needs before it imports the solver's module.

    Attributes:
      path: module and class, "module:Class"; a leading dot stands for the package swerve.solvers.
      finer: setting that brings the solver nearer to pi_0 when the setting is raised; empty for
        none.
      value_gap: largest difference [nats] between the solver's own log Z_0 and the log Z_0 of its
        samples that gives no warning; None for a solver without a soft value.
      adapts: whether the solver adapts what it learned to a constraint in force.
      max_dimensions: most state dimensions that the solver takes.
      is_exact: whether the solver answers exactly, without samples.
      is_trained: whether the solver trains a network.
      needs_tables: whether the solver takes tabular MDPs alone.
      tabulates: whether the solver puts a table of cells in place of continuous dynamics.
      teacher: name of the solver whose policy is imitated; empty for none.
    """

    path: str
    finer: str = ""
    value_gap: float | None = None
    adapts: bool = False
    max_dimensions: float = math.inf
    is_exact: bool = False
    is_trained: bool = False
    needs_tables: bool = False
    tabulates: bool = False
    teacher: str = ""

    @property
    def has_soft_value(self) -> bool:
        """Whether the policies of the solver have a soft value."""
        return self.value_gap is not None

    @property
    def computes_value(self) -> bool:
        """Whether the solver computes its soft value without training."""
        return self.has_soft_value and not self.is_trained

    @property
    def demonstrates(self) -> bool:
        """Whether demonstrations that obey a constraint can be sampled with the solver."""
        return self.adapts or self.needs_tables

    @property
    def default_method(self) -> str:
        """Default method of sampling with the solver; "exact" where it needs no sampling."""
        if self.is_exact:
            return "exact"
        return "smc" if self.has_soft_value else "importance"


sampled = SolverKind
trained = partial(SolverKind, finer="num_steps", is_trained=True)
exact = partial(SolverKind, is_exact=True)
KINDS: dict[str, SolverKind] = {  # kinds by the solvers' names on the command line
    "grid": sampled(".grid.grid:Grid", "num_points", value_gap=0.1, adapts=True, max_dimensions=3),
    "ppo": trained(".trained.ppo:PPO"),
    "soft-value": trained(".trained.soft_value:SoftValue", value_gap=1.0, adapts=True),
    "distilled": trained(".trained.distilled:Distilled", value_gap=2.0, teacher="soft-value"),
    "tabular": exact(".exact.tabular:Tabular", needs_tables=True),
    "discrete": exact(".exact.discrete:Discrete", "num_cells", max_dimensions=4, tabulates=True),
    "enumeration": exact(".exact.enumeration:Enumeration"),
    "soft-paths": exact(".exact.soft_paths:SoftPaths"),
}
UNKNOWN = SolverKind("", finer="num_steps")  # kind of a solver that is not in the table


def kind_named(specification: str) -> SolverKind:
    """Return the kind of a solver by its name or specification, such as "ppo?num_steps=2e7"."""
    return KINDS.get(specification.partition("?")[0], UNKNOWN)


def check_solver_name(name: str) -> None:
    """Raise ValueError if no solver has a name."""
    if name not in KINDS:
        raise ValueError(f"no solver named {name!r}; there are {', '.join(KINDS)}")


def kind_stored(representation: str) -> SolverKind:
    """Return the kind of a solver by the text that evidence stores, such as "PPO(num_steps=1)"."""
    class_name = representation.partition("(")[0]
    found = [kind for kind in KINDS.values() if kind.path.endswith(f":{class_name}")]
    return found[0] if found else UNKNOWN


def solver_names(is_wanted: Callable[[SolverKind], bool] = lambda kind: True) -> list[str]:
    """Return the names of the solvers whose kind is wanted; all by default."""
    return [name for name, kind in KINDS.items() if is_wanted(kind)]


def suggested_solver(is_tabular: bool, num_dimensions: int) -> str:
    """Return the solver for an MDP: exact for tables, else the first that adapts to constraints."""
    if is_tabular:
        return solver_names(lambda kind: kind.needs_tables)[0]
    return solver_names(lambda kind: kind.adapts and num_dimensions <= kind.max_dimensions)[0]
