"""The nominal distribution pi_0: what a solver learns, and how it is kept.

A nominal yields, for every goal, a policy whose trajectories follow pi_0 as nearly as the solver
can make them; importance weights take care of the rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from swerve.base import store
from swerve.base.arguments import instance, whole_number
from swerve.base.space import Task
from swerve.evidence.exact import ExactAnswer
from swerve.problem.loading import Specification, build
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_tasks
from swerve.simulation.trajectory import Policy
from swerve.solvers.exact.discrete import Discrete
from swerve.solvers.exact.enumeration import Enumeration
from swerve.solvers.exact.soft_paths import SoftPaths
from swerve.solvers.exact.tabular import Tabular
from swerve.solvers.grid.grid import MAX_DIMENSIONS, Grid
from swerve.solvers.trained.distilled import Distilled
from swerve.solvers.trained.ppo import PPO
from swerve.solvers.trained.soft_value import SoftValue
from swerve.systems.tabular import TabularMDP

KIND = "swerve-nominal"
VERSION = 2


class Nominal(Protocol):
    """What a solver knows of pi_0, for every goal of a problem."""

    @property
    def problem(self) -> Problem:
        """What it was learned for."""
        ...

    @property
    def solver(self) -> Solver:
        """How it was learned."""
        ...

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the learned numbers, to be stored."""
        ...


@runtime_checkable
class PolicyNominal(Nominal, Protocol):
    """An approximation of pi_0 that is sampled."""

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[Policy]:
        """Yield the policy of each goal [G, g] in turn.

        Args:
          goals: [G, g].
          advance: called with the number of goals, a fraction perhaps, done since the last call.
        """
        ...


@runtime_checkable
class ExactNominal(Nominal, Protocol):
    """pi_0 itself: what would be sampled is worked out."""

    def answer(
        self,
        task: Task,
        generator: np.random.Generator,
        advance: Callable[[float], None] = lambda share: None,
        avoiding: Sequence[int] = (),
    ) -> ExactAnswer:
        """Return what is exactly so for a task; log Z_0 is -inf where no trajectory is allowed.

        Args:
          task: start [n] and goal [g].
          generator: of the trajectories that are drawn for pictures.
          advance: called with the share of the task done since the last call; in all, 1.
          avoiding: hypotheses C to be obeyed: log Z_C and P(avoid c | avoid C) are returned.
        """
        ...


@runtime_checkable
class Solver(Protocol):
    """A way to pi_0: a frozen dataclass of settings.

    Attributes:
      name: what the command line calls it.
    """

    name: str

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None,
        seed: int,
        progress: bool,
        checkpoint: Path | None,
    ) -> Nominal:
        """Learn pi_0."""
        ...

    def check(self, problem: Problem) -> None:
        """Raise ValueError if this solver cannot solve the problem, before any work."""
        ...

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> Nominal:
        """Rebuild what `learn` returned from its `arrays`."""
        ...


SOLVERS: dict[str, type[Solver]] = {
    "grid": Grid,
    "ppo": PPO,
    "soft-value": SoftValue,
    "distilled": Distilled,
    "tabular": Tabular,
    "discrete": Discrete,
    "enumeration": Enumeration,
    "soft-paths": SoftPaths,
}


def learn(
    problem: Problem,
    solver: str | Solver | None = None,
    *,
    tasks: Task | Sequence[Task] | None = None,
    seed: int = 0,
    progress: bool = False,
    checkpoint: str | Path | None = None,
) -> Nominal:
    """Learn the nominal distribution of a problem.

    Args:
      problem: what to learn it for.
      solver: a solver such as `swerve.PPO(num_steps=20_000_000)`, or its name, with parameters as
        in "ppo?num_steps=2e7"; None takes tables if the MDP is tabular, else the grid for up to 3
        state dimensions, else soft value networks.
      tasks: those on which solvers that train report their progress, as for `sample`; drawn from
        the MDP if None.
      seed: of everything random.
      progress: whether to show a progress bar.
      checkpoint: a file that training writes as it goes and resumes from.

    Returns:
      The nominal distribution, ready for `sample` with any tasks.

    Raises:
      ValueError: if an argument is of the wrong kind, there is no such solver, it cannot solve this
        problem, or a task is not one of it.
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
    if isinstance(chosen, type) or not isinstance(chosen, Solver):
        raise ValueError(
            "solver: expected a name such as 'grid', or an object such as swerve.PPO(), got "
            f"{chosen!r}"
        )
    seed = whole_number(seed, "seed", 0)
    path = Path(checkpoint) if checkpoint is not None else None
    batch = None if tasks is None else checked_tasks(problem, tasks)
    return chosen.learn(problem, tasks=batch, seed=seed, progress=progress, checkpoint=path)


def resolve_solver(text: str) -> Solver:
    """Return the solver that a text such as "grid" or "ppo?num_steps=2e7" names.

    Raises:
      ValueError: if there is none of that name, or it has no such parameter.
    """
    specification = Specification.parse(text)
    if specification.target not in SOLVERS:
        raise ValueError(
            f"no solver named {specification.target!r}; there are {', '.join(SOLVERS)}"
        )
    return build(SOLVERS[specification.target], specification, text)


def default_solver(problem: Problem) -> str:
    """Return the solver to use where none is asked for: tables, else a grid if one fits."""
    if isinstance(problem.mdp, TabularMDP):
        return "tabular"
    return "grid" if len(problem.mdp.state_names) <= MAX_DIMENSIONS else "soft-value"


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
      store.StoreError: if the file is cut short, altered, or of another kind, version or problem.
    """
    stored = store.open_file(path, KIND, VERSION)
    if stored.header["problem"] != problem.record.fingerprint:
        raise store.StoreError(
            path,
            f"holds the nominal distribution of another problem, not of {problem.record.summary}",
            "learn this problem into another file",
        )
    solver = SOLVERS[stored.header["solver"]](**stored.header["settings"])
    return solver.restore(problem, {name: stored.array(name) for name in stored.names})
