"""Learn the nominal distribution pi_0 of a problem, and keep it in a file.

The table in `swerve.base.solver_kinds` lists the solvers. The module of a solver is imported when
the solver is used.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swerve.base import schema, store
from swerve.base.arguments import instance, seed_number
from swerve.base.forked import check_process
from swerve.base.solver_kinds import KINDS, check_solver_name, suggested_solver
from swerve.base.space import Task
from swerve.base.specification import Specification, build
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_tasks
from swerve.solvers.base import Nominal, Solver
from swerve.systems.tabular import TabularMDP

KIND = "swerve-nominal"
VERSION = 2


class NominalData(schema.Data):
    """The header of a stored nominal distribution; the settings are those of its solver."""

    problem: str
    solver: str
    settings: dict[str, Any]


def learn(
    problem: Problem,
    solver: str | Solver[Any] | None = None,
    *,
    tasks: Task | Sequence[Task] | None = None,
    seed: int = 0,
    progress: bool = False,
    checkpoint: str | Path | None = None,
) -> Nominal:
    """Learn the nominal distribution of a problem.

    Args:
      problem: what to learn.
      solver: a solver such as `swerve.PPO(num_steps=20_000_000)`, or its name, with settings as in
        "ppo?num_steps=2e7"; None takes tables if the MDP is tabular, else the grid for up to 3
        state dimensions, else soft value networks.
      tasks: tasks on which solvers that train report their progress, as for `sample`; sampled from
        the MDP if None.
      seed: seed of everything random.
      progress: whether to show a progress bar.
      checkpoint: a file that training writes as it goes, and from which an interrupted training
        goes on.

    Returns:
      The nominal distribution, ready for `sample` with any tasks.

    Raises:
      ValueError: if an argument is of the wrong kind, no solver has this name, the solver cannot
        solve this problem, or a task does not belong to the problem.
    """
    instance(
        problem,
        Problem,
        "problem",
        "make one with swerve.Problem or swerve.load_problem('pendulum')",
    )
    if solver is None:
        solver = default_solver(problem)
    chosen = resolve_solver(solver) if isinstance(solver, str) else solver
    if not isinstance(chosen, Solver):
        raise ValueError(
            "solver: expected a name such as 'grid', or an object such as swerve.PPO(), got "
            f"{chosen!r}: a solver of your own inherits from swerve.solvers.base.Solver"
        )
    seed = seed_number(seed)
    path = Path(checkpoint) if checkpoint is not None else None
    batch = None if tasks is None else checked_tasks(problem, tasks)
    return chosen.learn(problem, tasks=batch, seed=seed, progress=progress, checkpoint=path)


def resolve_solver(text: str) -> Solver[Any]:
    """Return the solver that a text such as "grid" or "ppo?num_steps=2e7" names.

    Raises:
      ValueError: if no solver has this name, or the solver has no such setting.
    """
    specification = Specification.parse(text)
    check_solver_name(specification.target)
    return build(_solver_class(specification.target), specification, text)


def default_solver(problem: Problem) -> str:
    """Return the name of the solver that `learn` takes for a problem if none is named."""
    is_tabular = isinstance(problem.mdp, TabularMDP)
    return suggested_solver(is_tabular, len(problem.mdp.state_names))


def save_nominal(path: str | Path, nominal: Nominal) -> None:
    """Write a nominal distribution to one file, atomically."""
    header = {
        "problem": nominal.problem.record.fingerprint,
        "solver": nominal.solver.name,
        "settings": dataclasses.asdict(nominal.solver),  # pyright: ignore[reportArgumentType]
    }
    store.write(path, KIND, VERSION, header, nominal.arrays())


def load_nominal(path: str | Path, problem: Problem) -> Nominal:
    """Read a nominal distribution of this problem.

    Raises:
      store.StoreError: if the file is cut short, altered, of another kind, version or problem, or
        holds what no nominal distribution holds.
      RuntimeError: in a process that was forked after JAX had begun to run.
    """
    check_process()
    stored = store.open_file(path, KIND, VERSION)
    header = schema.checked(path, stored.header, NominalData)
    if header.problem != problem.record.fingerprint:
        raise store.StoreError(
            path,
            f"holds the nominal distribution of another problem, not of {problem.record.summary}",
            "learn this problem into another file",
        )
    name = header.solver
    if name not in KINDS:
        raise store.StoreError(
            path, f"was learned by solver {name!r}, which this version lacks", "learn it again"
        )
    solver = schema.checked(path, header.settings, _solver_class(name))
    with schema.contents(path):
        return solver.restore(problem, {name: stored.array(name) for name in stored.names})


def _solver_class(name: str) -> type[Solver[Any]]:
    """Import and return the class of a solver, by its name in the table."""
    module, _, class_name = KINDS[name].path.partition(":")
    return getattr(importlib.import_module(module, "swerve.solvers"), class_name)
