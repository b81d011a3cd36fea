"""Tabular maximum likelihood constraint inference (Scobee & Sastry, 2019): exact, no sampling.

`Tabular` reads the tables of a tabular MDP; `Discrete` makes a table of continuous dynamics. Both
give a `TableNominal`.

Shapes: S states, A actions, n state dimensions, m action dimensions, T steps, H hypotheses,
B = ceil(H / 8) bytes, M trajectories.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.pickling import PickledByFields
from swerve.base.space import Actions, Task
from swerve.constraints.base import violates
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.exact import ExactAnswer, KeptTrajectories
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import enters_set, num_bytes, pack_sets, unpack_range
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_task
from swerve.solvers.base import LearnOptions, Solver
from swerve.solvers.exact.table import Table
from swerve.systems.tabular import TabularMDP

BLOCK = 1 << 22  # (step, hypothesis) pairs that are carried forward at once, to bound memory
MEMORY_BYTES = 8 << 30  # bytes: larger tables are refused
SMALLEST = 1e-280  # least mass that float64 carries forward with all its digits


@dataclass(frozen=True)
class Tabular(Solver["TableNominal"]):
    """Solver: exact dynamic programming on the states of a tabular MDP."""

    name = "tabular"

    def _learn(self, problem: Problem, options: LearnOptions) -> TableNominal:
        mdp = problem.mdp
        assert isinstance(mdp, TabularMDP)
        return TableNominal(
            problem,
            self,
            States(mdp.states, mdp.successors, mdp.num_steps, mdp.state_index, mdp.dt),
            partial(_same_rewards, mdp),
        )

    def check(self, problem: Problem) -> None:
        """Raise ValueError if the MDP is not tabular, or its tables would not fit memory."""
        mdp = problem.mdp
        if not isinstance(mdp, TabularMDP):
            raise ValueError(
                f"the tabular solver needs a tabular MDP, such as Gridworld or a result of "
                f"swerve.tabular, got {type(mdp).__name__}: use solver 'discrete', which makes a "
                "table of the MDP, or another solver"
            )
        check_size(mdp.num_states, mdp.num_actions, mdp.num_steps, len(problem.hypotheses))


def _same_rewards(mdp: TabularMDP, goal: np.ndarray) -> np.ndarray:
    """Return the rewards [S, A] of a tabular MDP, whatever the goal."""
    return mdp.rewards


def check_size(num_states: int, num_actions: int, num_steps: int, num_hypotheses: int) -> None:
    """Raise ValueError where tables would not fit memory."""
    values = 8 * num_states * (num_steps + 1)
    steps = num_states * num_actions
    bits = steps * num_bytes(num_hypotheses) + 100 * steps
    if values + bits > MEMORY_BYTES:
        raise ValueError(
            f"{num_states:,} states, {num_actions} actions, {num_steps} steps and "
            f"{num_hypotheses:,} hypotheses need {(values + bits) / 2**30:.1f} GiB, more than "
            f"{MEMORY_BYTES / 2**30:.0f} GiB: take fewer of one of them"
        )


class States(NamedTuple):
    """The states of a table.

    Attributes:
      states: [S, n] where they lie.
      successors: [S, A] the state that each action leads to, negative for actions not offered.
      num_steps: T.
      number: maps states [..., n] to the numbers [...] of the nearest states of the table.
      step: duration of an action, seconds.
    """

    states: np.ndarray
    successors: np.ndarray
    num_steps: int
    number: Callable[[Any], Any]
    step: float


@dataclass(frozen=True, eq=False)
class TableNominal(PickledByFields):
    """pi_0 on a table of states, exactly.

    Attributes:
      problem: problem that was learned; its hypotheses and known constraints are judged at the
        states of the table, and on the straight lines between them if the problem says so.
      solver: solver that made the table.
      table: the states.
      rewards: maps a goal [g] to the rewards [S, A] of all steps.
    """

    problem: Problem
    solver: Any
    table: States
    rewards: Callable[[np.ndarray], np.ndarray]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return no arrays: everything is computed from the problem."""
        return {}

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
        """
        start, goal_table = self.start(task), self.goal_table(task.goal, avoiding)
        log_partition = float(goal_table.values[0, start])
        num_hypotheses = len(self.problem.hypotheses)
        avoid = np.full(num_hypotheses, np.nan)
        block = max(8, BLOCK // self.bits.shape[0] // 8 * 8)
        for first in range(0, num_hypotheses if np.isfinite(log_partition) else 0, block):
            some = slice(first, min(first + block, num_hypotheses))
            share = (some.stop - some.start) / num_hypotheses
            enters = unpack_range(self.bits, some.start, some.stop)
            avoid[some] = goal_table.avoid_probability(
                start, enters, lambda part, share=share: advance(share * part)
            )
        kept = self._sample(task, start, goal_table, generator)
        log_ratio = self._log_ratio(task, avoid, log_partition, avoiding)
        return ExactAnswer(log_partition, log_ratio, kept, self.table.step)

    def _log_ratio(
        self, task: Task, avoid: np.ndarray, log_partition: float, avoiding: Sequence[int]
    ) -> np.ndarray:
        """Return log Z_c / Z_0 [H]; ratios below SMALLEST are computed anew with c in force."""
        tiny = np.flatnonzero(avoid < SMALLEST)
        log_ratio = np.log(np.clip(avoid, SMALLEST, 1.0))
        sets = [(*avoiding, int(index)) for index in tiny]
        log_ratio[tiny] = self._log_partitions(task, sets) - log_partition
        return log_ratio

    def log_partition(self, task: Task, avoiding: Sequence[Sequence[int]]) -> np.ndarray:
        """Return log Z_C, over the trajectories that avoid all hypotheses of a set C, nats.

        Args:
          task: start [n] and goal [g].
          avoiding: sets of hypotheses, by index; an empty set gives log Z_0.

        Raises:
          ValueError: if the task or an index does not fit the problem.
        """
        pack_sets(avoiding, len(self.problem.hypotheses))  # raises unless these are indices
        return self._log_partitions(checked_task(self.problem, task), avoiding)

    def _log_partitions(self, task: Task, avoiding: Sequence[Sequence[int]]) -> np.ndarray:
        start = self.start(task)
        return np.array([self.goal_table(task.goal, c).values[0, start] for c in avoiding])

    def start(self, task: Task) -> int:
        """Return the number of the state where a task starts."""
        return int(self.table.number(np.asarray(task.start, float)))

    def snapped(self, demonstration: Demonstration) -> Demonstration:
        """Return a demonstration moved to the states of the table, its start too.

        A state that the demonstration stays in is kept once. Actions and times are kept where the
        demonstration goes on to another state.
        """
        number = self.table.number(demonstration.states)
        leaves = np.flatnonzero(np.diff(number))
        kept = np.append(leaves, len(number) - 1)
        if not len(leaves):  # all in one state: a demonstration has two states at least
            leaves, kept = np.zeros(1, int), np.array([0, len(number) - 1])
        states = self.table.states[number[kept]]
        return Demonstration(
            demonstration.name,
            states,
            Task(states[0], demonstration.task.goal),
            None if demonstration.times is None else demonstration.times[kept],
            None if demonstration.actions is None else demonstration.actions[leaves],
        )

    def goal_table(self, goal: np.ndarray, avoiding: Sequence[int] = ()) -> Table:
        """Return the table of one goal, in nats, with the allowed steps alone.

        Steps that enter a known constraint, or a hypothesis of `avoiding`, are left out.
        """
        [members] = pack_sets([avoiding], len(self.problem.hypotheses))
        allowed = self.allowed & ~enters_set(self.bits, members).reshape(self.allowed.shape)
        problem, beta = self.problem, self.problem.beta
        offset = -np.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0
        terminal, ended = self.ends(goal)
        rewards = self.rewards(goal)
        self._check_rewards("reward", np.where(allowed, rewards, 0.0))
        self._check_rewards("terminal_reward", terminal)
        return Table(
            successors=np.maximum(self.table.successors, 0),
            reward=np.where(allowed, _scaled(rewards, beta) + offset, -np.inf),
            terminal=_scaled(terminal, beta),
            ended=ended,
            num_steps=self.table.num_steps,
        )

    def _check_rewards(self, method: str, values: np.ndarray) -> None:
        """Raise ValueError where a reward [S, ...] is NaN or +inf."""
        wrong = np.argwhere(np.isnan(values) | np.isposinf(values))
        if len(wrong):
            state = self.table.states[wrong[0][0]].tolist()
            raise ValueError(
                f"{type(self.problem.mdp).__name__}.{method} is {values[tuple(wrong[0])]} in state "
                f"{state}: expected a number, or -inf for what is not allowed"
            )

    def ends(self, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return r_T [S] and whether episodes end [S] at each state."""
        terminal, ended = self._at_states(jnp.asarray(goal, jnp.float32))
        return np.asarray(terminal, float), np.asarray(ended)

    @cached_property
    def _at_states(self) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
        """Maps a goal [g] to r_T [S] and `terminated` [S] at the states."""
        mdp, states = self.problem.mdp, jnp.asarray(self.table.states, jnp.float32)

        @jax.jit
        def at_states(goal: jax.Array) -> tuple[jax.Array, jax.Array]:
            terminal = jax.vmap(mdp.terminal_reward, (0, None))(states, goal)
            return terminal, jax.vmap(mdp.terminated, (0, None))(states, goal)

        return at_states

    @cached_property
    def steps(self) -> tuple[np.ndarray, Actions]:
        """[S * A, 2, n] all steps, and their actions [S * A, 1, m]."""
        problem, states = self.problem, self.table.states
        num_actions = problem.mdp.num_actions
        ends = states[np.maximum(self.table.successors, 0)]
        starts = np.broadcast_to(states[:, None], ends.shape)
        steps = np.stack([starts, ends], axis=2).reshape(-1, 2, states.shape[1])
        actions = np.tile(np.asarray(problem.mdp.actions, float), (len(states), 1))
        assert len(actions) == len(states) * num_actions
        return steps, Actions(tuple(problem.mdp.action_names), actions[:, None])

    @cached_property
    def bits(self) -> np.ndarray:
        """[S * A, B] packed bits of the hypotheses that a step enters."""
        problem, (steps, actions) = self.problem, self.steps
        return problem.hypotheses.violations(
            steps, problem.mdp.space, problem.between_states, actions
        )

    @cached_property
    def allowed(self) -> np.ndarray:
        """[S, A] whether an action is offered and enters no known constraint."""
        problem, (steps, actions) = self.problem, self.steps
        allowed = self.table.successors.ravel() >= 0
        for constraint in problem.known:
            allowed &= ~violates(
                constraint, steps, problem.mdp.space, problem.between_states, actions
            )
        return allowed.reshape(self.table.successors.shape)

    def _sample(
        self, task: Task, start: int, goal_table: Table, generator: np.random.Generator
    ) -> KeptTrajectories:
        """Sample trajectories from pi_0; none where no trajectory is allowed."""
        num = NUM_KEPT if np.isfinite(goal_table.values[0, start]) else 0
        states, actions, length = goal_table.sample(start, num, generator)
        rewards, (terminal, _) = self.rewards(task.goal), self.ends(task.goal)
        taken = np.arange(goal_table.num_steps) < length[:, None]
        bits = self.bits.reshape(*goal_table.reward.shape, -1)[states[:, :-1], actions]
        return KeptTrajectories(
            states=self.table.states[states],
            total_reward=np.where(taken, rewards[states[:, :-1], actions], 0.0).sum(axis=1)
            + terminal[states[:, -1]],
            length=length,
            violations=np.bitwise_or.reduce(np.where(taken[..., None], bits, 0), axis=1),
        )


def _scaled(rewards: np.ndarray, beta: float) -> np.ndarray:
    """Return rewards in nats; -inf stays -inf, whatever beta."""
    return np.where(np.isneginf(rewards), -np.inf, beta * np.where(np.isinf(rewards), 0.0, rewards))
