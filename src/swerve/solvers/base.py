"""Define what every solver and every nominal distribution offers.

A nominal distribution pi_0 yields, for every goal, a policy whose trajectories follow pi_0 as
nearly as the solver can make them; importance weights correct the rest. The nominal distribution of
an exact solver is an `evidence.exact.ExactNominal` instead.

Shapes: G goals, g goal dimensions.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from swerve.base.forked import check_process
from swerve.base.interrupts import heeded
from swerve.base.solver_kinds import SolverKind, kind_named
from swerve.base.space import Task
from swerve.problem.problem import Problem
from swerve.simulation.trajectory import Policy


class Nominal(Protocol):
    """What a solver knows of pi_0, for every goal of a problem."""

    @property
    def problem(self) -> Problem:
        """Problem that was learned."""
        ...

    @property
    def solver(self) -> Solver[Any]:
        """Solver that learned the problem."""
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
          advance: called with the number of goals done since the last call; may be a fraction.
        """
        ...


@runtime_checkable
class ManyBetasNominal(Nominal, Protocol):
    """A nominal distribution that was learned for a span of betas."""

    def covers(self, beta: float) -> bool:
        """Return whether the span contains a beta."""
        ...

    def at_beta(self, beta: float) -> Nominal:
        """Return the nominal distribution for another beta of the span."""
        ...


class LearnOptions(NamedTuple):
    """The options of `Solver.learn`; see there."""

    tasks: Task | None = None
    seed: int = 0
    progress: bool = False
    checkpoint: Path | None = None


N = TypeVar("N")


class Solver(abc.ABC, Generic[N]):
    """A way to pi_0: a frozen dataclass of settings, which makes nominal distributions N.

    Attributes:
      name: name of the solver on the command line, and in `swerve.base.solver_kinds`.
    """

    name: str

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> N:
        """Learn the nominal distribution of a problem.

        Solvers that do not train use `problem` alone: they compute when a task is sampled, and
        nothing that they compute is random.

        Args:
          problem: what to learn.
          tasks: tasks on which KL and ESS are estimated while training, as for `sample`; sampled
            from the MDP if None.
          seed: seed of everything random.
          progress: whether to show a bar with steps per second, KL, ESS and residual.
          checkpoint: file that is written after every chunk of training, and from which an
            interrupted training goes on; None to write and read no file.

        Raises:
          ValueError: if this solver cannot solve the problem, the checkpoint is of another run, the
            MDP returned a number that is not finite, training diverged from the beginning, or
            hardly any episode that the MDP samples can begin.
        """
        check_process()
        self.check(problem)
        with heeded():
            return self._learn(problem, LearnOptions(tasks, seed, progress, checkpoint))

    @abc.abstractmethod
    def _learn(self, problem: Problem, options: LearnOptions) -> N:
        """Learn the nominal distribution of a problem that `check` has passed."""

    @abc.abstractmethod
    def check(self, problem: Problem) -> None:
        """Raise ValueError if this solver cannot solve the problem, before any work."""

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> N:
        """Rebuild a nominal distribution from its stored `arrays`.

        By default no arrays are stored: the problem is learned again.
        """
        return self.learn(problem)

    @property
    def kind(self) -> SolverKind:
        """Kind of this solver, from the table of solvers."""
        return kind_named(self.name)

    def check_dimensions(self, problem: Problem) -> None:
        """Raise ValueError if the state of a problem has too many dimensions for this solver."""
        names, most = problem.mdp.state_names, self.kind.max_dimensions
        if len(names) > most:
            raise ValueError(
                f"the {self.name} solver takes at most {most} state dimensions, "
                f"{type(problem.mdp).__name__} has {len(names)} ({', '.join(names)}): "
                "use solver 'soft-value'"
            )


class AdaptingSolver(Solver[N]):
    """A solver whose soft value can be adapted to more known constraints."""

    @abc.abstractmethod
    def adapted(self, nominal: N, problem: Problem, seed: int) -> Iterator[N]:
        """Yield nominal distributions of a problem with more known constraints, the best last.

        Args:
          nominal: nominal distribution of the problem without these constraints.
          problem: problem with the constraints in force.
          seed: seed of everything random.
        """
