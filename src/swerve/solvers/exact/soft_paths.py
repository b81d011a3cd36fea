"""Soft shortest paths: pi_0 over walks of any number of steps, exactly.

    Z_0(s) = sum over walks xi from s to where an episode ends of m exp(beta R(xi)),
    pi(a | s) = m exp(beta r(s, a)) Z_0(s') / Z_0(s),

on the states of a table, computed as in `walks`: no sampling, no horizon and no error. The result
is pi_0 of the MDP if walks end before its horizon, which is checked.

Shapes: S states of the table, P of these that steps leave or reach, A actions, M steps, K tasks,
H hypotheses, B = ceil(H / 8) bytes, N trajectories, T steps of the horizon.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from swerve.base.pickling import PickledByFields
from swerve.base.space import Task
from swerve.evidence.exact import ExactAnswer, KeptTrajectories
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import pack_sets, unpack_range
from swerve.problem.problem import Problem
from swerve.solvers.base import LearnOptions, Solver
from swerve.solvers.exact.discrete import Discrete
from swerve.solvers.exact.tabular import TableNominal, Tabular
from swerve.solvers.exact.walks import Ends, Steps, Walks
from swerve.systems.tabular import TabularMDP

MAX_STATES = 8000  # states P: their matrix takes 0.5 GB and minutes
NUM_FOUND = 3  # sets of hypotheses in force whose matrices are kept, about 0.1 GB each
COLUMNS = 1 << 8  # hypotheses whose steps are looked up at once, to bound memory
SMALLEST = 1e-290  # least sum of weights that float64 holds with all its digits
SHARED = ("_bits", "_steps", "_rewards")  # slow to compute, and the same for every beta
LATE = 1e-3  # share of the walks that may be longer than the horizon


@dataclass(frozen=True)
class SoftPaths(Solver["PathNominal"]):
    """Solver: exact sums over walks of any length, for rewards that do not depend on the goal.

    Attributes:
      num_cells: cells of the table along each axis; actions must lead from the centre of a cell to
        the centre of another. 0 takes the `num_cells` of the MDP, which a Walker has. A tabular MDP
        is its own table.
    """

    num_cells: tuple[int, ...] | int = 0

    name = "soft-paths"

    def _learn(self, problem: Problem, options: LearnOptions) -> PathNominal:
        return PathNominal(
            problem, self, self._maker(problem).learn(problem, progress=options.progress)
        )

    def check(self, problem: Problem) -> None:
        """Raise ValueError if `tabular` or `discrete` cannot make the table."""
        self._maker(problem).check(problem)

    def _maker(self, problem: Problem) -> Tabular | Discrete:
        if isinstance(problem.mdp, TabularMDP):
            return Tabular()
        return Discrete(self.num_cells or getattr(problem.mdp, "num_cells", 0), hold=1)


@dataclass(frozen=True, eq=False)
class PathNominal(PickledByFields):
    """pi_0 on a table of states, over walks of any length.

    Attributes:
      problem: problem that was learned.
      solver: solver that learned the problem.
      table: states and steps, which do not depend on beta: the table's own beta may differ.
    """

    problem: Problem
    solver: SoftPaths
    table: TableNominal
    _found: dict[tuple[int, ...], Walks] = dataclasses.field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_found": {}}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return no arrays: everything is computed from the problem."""
        return {}

    def at_beta(self, beta: float) -> PathNominal:
        """Return the nominal distribution of another beta, with the same attributes SHARED."""
        other = PathNominal(dataclasses.replace(self.problem, beta=beta), self.solver, self.table)
        other.__dict__.update({name: getattr(self, name) for name in SHARED})
        return other

    def answer(
        self,
        task: Task,
        generator: np.random.Generator,
        advance: Callable[[float], None] = lambda share: None,
        avoiding: Sequence[int] = (),
    ) -> ExactAnswer:
        """Return log Z_0, Z_c / Z_0 of every hypothesis and trajectories sampled from pi_0.

        With the hypotheses C of `avoiding` in force, the answer is log Z_C, P(avoid c | avoid C)
        and trajectories sampled from pi_C.

        Raises:
          ValueError: if walks of all lengths have no finite sum, no walk arrives, or more than a
            few walks are longer than the horizon.
        """
        walks, start, ends = self._walks(avoiding), self._start(task), self._ends(task)
        values = walks.values(ends)
        log_ratio = self._log_ratio(task, walks, start, ends)
        kept = self._sample(task, walks, start, ends, generator)
        advance(1.0)
        return ExactAnswer(float(np.log(values[start])), log_ratio, kept)

    def log_ratio(self, tasks: Task, avoiding: Sequence[int] = ()) -> np.ndarray:
        """Return log P(avoid c | avoid C) [K, H] of tasks, starts [K, n] and goals [K, g], nats."""
        walks, rows = self._walks(avoiding), []
        for place in zip(*tasks, strict=True):
            task = Task(*place)
            rows.append(self._log_ratio(task, walks, self._start(task), self._ends(task)))
        return np.array(rows).reshape(-1, len(self.problem.hypotheses))

    def _log_ratio(self, task: Task, walks: Walks, start: int, ends: Ends) -> np.ndarray:
        total = walks.values(ends)[start]
        if not total > SMALLEST:
            raise ValueError(
                f"{_of(task)}: no walk has any weight, Z = {total:.3g}: known constraints "
                f"are in the way, or beta {self.problem.beta:g} is too large for such a distance"
            )
        with np.errstate(divide="ignore"):
            return np.log(walks.avoiding(start, ends) / total)

    def _walks(self, avoiding: Sequence[int]) -> Walks:
        """Return the walks that avoid some hypotheses; the last NUM_FOUND sets are kept."""
        key = tuple(sorted(avoiding))
        pack_sets([key], len(self.problem.hypotheses))  # raises unless these are indices
        walks = self._found.pop(key, None) or self._walks_of(key)
        self._found[key] = walks
        while len(self._found) > NUM_FOUND:
            del self._found[next(iter(self._found))]
        return walks

    def _walks_of(self, avoiding: tuple[int, ...]) -> Walks:
        problem, steps = self.problem, self._steps
        offset = -np.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
        weight = np.exp(problem.beta * self._rewards.ravel()[self._numbers] + offset)
        for index in avoiding:
            weight[steps.entering[index]] = 0.0
        walks = Walks(steps, weight)
        try:
            _ = walks.green
        except ValueError as error:
            raise ValueError(
                f"beta {problem.beta:g} with the {problem.measure} measure: {error}. Raise beta, "
                "or take a solver whose horizon ends walks, such as 'discrete'"
            ) from error
        return walks

    @cached_property
    def _numbers(self) -> np.ndarray:
        """[M] numbers of the allowed steps, among all S * A."""
        return np.flatnonzero(self.table.allowed)

    @cached_property
    def _bits(self) -> np.ndarray:
        """[M, B] packed bits of the hypotheses that each allowed step enters."""
        problem, (steps, actions) = self.problem, self.table.steps
        return problem.hypotheses.violations(
            steps[self._numbers],
            problem.mdp.space,
            problem.between_states,
            actions._replace(values=actions.values[self._numbers]),
        )

    @cached_property
    def _states(self) -> np.ndarray:
        """[P] the states, among all S, that steps leave or reach."""
        successors = self.table.table.successors
        sources = self._numbers // successors.shape[1]
        states = np.union1d(sources, successors.ravel()[self._numbers])
        if not len(states):
            raise ValueError("no step is allowed: known constraints are everywhere")
        if len(states) > MAX_STATES:
            raise ValueError(
                f"soft-paths: expected at most {MAX_STATES:,} states that can be entered, got "
                f"{len(states):,}: take wider cells"
            )
        return states

    @cached_property
    def _steps(self) -> Steps:
        successors, numbers = self.table.table.successors, self._numbers
        sources = np.searchsorted(self._states, numbers // successors.shape[1])
        targets = np.searchsorted(self._states, successors.ravel()[numbers])
        num_hypotheses = len(self.problem.hypotheses)
        entering: list[np.ndarray] = []
        for first in range(0, num_hypotheses, COLUMNS):
            stop = min(first + COLUMNS, num_hypotheses)
            enters = unpack_range(self._bits, first, stop)
            entering += [np.flatnonzero(column) for column in enters.T]
        return Steps(sources, targets, len(self._states), entering)

    @cached_property
    def _rewards(self) -> np.ndarray:
        """[S, A] the rewards of steps, whatever the goal."""
        return self.table.rewards(np.zeros(len(self.problem.mdp.goal_names)))

    def _start(self, task: Task) -> int:
        """Return the number of the state, among the P, nearest to a start.

        Raises:
          ValueError: if every state is further from the start than the longest step is long.
        """
        own = np.searchsorted(self._states, number := self.table.start(task))
        if own < len(self._states) and self._states[own] == number:
            return int(own)
        space, states = self.problem.mdp.space, self.table.table.states[self._states]
        steps = self._steps
        far = space.relative_distance(states[steps.source], states[steps.target]).max()
        away = space.relative_distance(states, np.asarray(task.start, float))
        if away.min() > far:
            raise ValueError(f"{_of(task)}: no step can be taken near the start: correct it")
        return int(away.argmin())

    def _ends(self, task: Task) -> Ends:
        """Return where episodes of a task end.

        Raises:
          ValueError: if episodes end nowhere, terminal rewards are finite elsewhere, or rewards
            depend on the goal.
        """
        if (self.table.rewards(task.goal) != self._rewards)[self.table.allowed].any():
            raise ValueError(
                "soft-paths: expected rewards that do not depend on the goal, such as distances; "
                f"the rewards of {type(self.problem.mdp).__name__} depend on it: use another solver"
            )
        terminal, ended = (values[self._states] for values in self.table.ends(task.goal))
        if np.isfinite(terminal[~ended]).any():
            raise ValueError(
                "soft-paths: expected a terminal_reward of -inf where an episode has not ended, "
                "since walks may have any length; the terminal_reward of "
                f"{type(self.problem.mdp).__name__} is finite there: use another solver"
            )
        states = np.flatnonzero(ended & np.isfinite(terminal))
        if not len(states):
            raise ValueError(f"{_of(task)}: no state that can be entered is at the goal")
        return Ends(states, np.exp(self.problem.beta * terminal[states]))

    def _sample(
        self, task: Task, walks: Walks, start: int, ends: Ends, generator: np.random.Generator
    ) -> KeptTrajectories:
        """Sample trajectories from pi_0, without the few that are longer than the horizon."""
        num_steps = self.problem.mdp.num_steps
        late = walks.longer(start, ends, num_steps)
        if late > LATE:
            raise ValueError(
                f"{_of(task)}: {late:.2g} of the walks are longer than the horizon of {num_steps} "
                f"steps, expected at most {LATE:g}: raise num_steps, or beta"
            )
        steps, length = walks.sample(start, ends, NUM_KEPT, num_steps, generator)
        taken = np.arange(num_steps) < length[:, None]
        path = np.concatenate([np.full((NUM_KEPT, 1), start), walks.steps.target[steps]], axis=1)
        last = np.take_along_axis(path, length[:, None], axis=1)
        path = np.where(np.arange(num_steps + 1) <= length[:, None], path, last)
        numbers, terminal = self._numbers[steps], self.table.ends(task.goal)[0][self._states]
        walked = np.split(steps[taken], np.cumsum(length)[:-1])
        entered = [np.bitwise_or.reduce(self._bits[part], axis=0) for part in walked]
        return KeptTrajectories(
            states=self.table.table.states[self._states[path]],
            total_reward=np.where(taken, self._rewards.ravel()[numbers], 0.0).sum(axis=1)
            + terminal[last[:, 0]],
            length=length,
            violations=np.stack(entered),
        )


def _of(task: Task) -> str:
    start, goal = (np.asarray(part, float).round(4).tolist() for part in task)
    return f"from {start} to {goal}"
