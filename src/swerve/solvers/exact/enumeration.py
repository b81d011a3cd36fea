"""All action sequences of a short horizon: pi_0 exactly, whatever the dynamics.

    Z_0 = sum_xi m(xi) exp(beta R(xi)),    Z_c = sum_xi m(xi) exp(beta R(xi)) 1[xi avoids c],

over the A^T action sequences. Sequences that differ only after the end of an episode are one
trajectory. Sequences that begin alike form a tree. A node of the tree is a path so far. All actions
expand a node at once: the reward of the step is added to the reward of the path, and the hypotheses
that the new segment enters are added to the hypotheses that the path has entered. Nodes are
expanded in blocks, breadth first while there are few nodes and depth first afterwards, so that
memory does not grow with A^T. The code of a path is the number whose digits to base A are its
actions.

Shapes: N nodes or leaves, A actions, T steps, n states, H hypotheses, B = ceil(H / 8) bytes,
M = NUM_KEPT trajectories sampled, S sets of hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from swerve.base.arguments import whole_number
from swerve.base.solver_kinds import suggested_solver
from swerve.base.space import Actions, Task
from swerve.evidence import estimators
from swerve.evidence.exact import ExactAnswer, KeptTrajectories
from swerve.evidence.samples import NUM_KEPT
from swerve.hypotheses.bits import enters_set, no_bits, pack_sets
from swerve.problem.boundary import actions_of
from swerve.problem.problem import Problem
from swerve.problem.tasks import checked_task
from swerve.simulation.compiled import of_problem, padded
from swerve.simulation.trajectory import Step, take_step
from swerve.solvers.base import LearnOptions, Solver

BLOCK = 1 << 14  # paths that are made at once: few enough to stay in cache
BLOCK_BYTES = 1 << 28  # bytes for judging a block of paths, at most
PRODUCT = 1 << 17
"""Trajectories times hypotheses that are weighed at once. A larger matrix product is shared among
threads, which wait for one another: 50 times slower where the cores are busy."""
LEAST_PADDED = 512  # nodes in the smallest batch that a step is compiled for
MAX_SEQUENCES = 2**63 - 1  # action sequences that the 64 bits of a code can tell apart


@dataclass(frozen=True)
class Enumeration(Solver["EnumerationNominal"]):
    """Solver: go through every action sequence, for horizons of about ten steps.

    Attributes:
      max_sequences: problems with more sequences, A^T, are refused. Ten million of them take about
        a minute.
    """

    max_sequences: int = 50_000_000

    name = "enumeration"

    def __post_init__(self) -> None:
        limit = whole_number(self.max_sequences, "Enumeration: max_sequences", 1)
        if limit > MAX_SEQUENCES:
            raise ValueError(
                f"Enumeration: max_sequences: expected at most {MAX_SEQUENCES:,}, got {limit:,}"
            )
        object.__setattr__(self, "max_sequences", limit)

    def _learn(self, problem: Problem, options: LearnOptions) -> EnumerationNominal:
        return EnumerationNominal(problem, self)

    def check(self, problem: Problem) -> None:
        """Raise ValueError where there are too many action sequences, before any work."""
        num_actions, num_steps = problem.mdp.num_actions, problem.mdp.num_steps
        digits = num_steps * math.log10(num_actions)
        # a power with more digits than a float holds is not computed
        num_sequences = num_actions**num_steps if digits < 20 else math.inf
        if num_sequences > self.max_sequences:
            size = f"{num_sequences:,}" if digits < 20 else f"10^{digits:.0f}"
            space = problem.mdp.space
            other = suggested_solver(space.is_lattice, len(space.names))
            raise ValueError(
                f"the enumeration solver would go through {num_actions}^{num_steps} = {size} "
                f"action sequences, at most {self.max_sequences:,} are allowed (max_sequences): "
                f"shorten num_steps, or use solver {other!r}"
            )


@dataclass(frozen=True, eq=False)
class EnumerationNominal:
    """pi_0 by summation over all action sequences, computed when a task is asked for."""

    problem: Problem
    solver: Enumeration

    def arrays(self) -> dict[str, np.ndarray]:
        """Return no arrays: nothing is learned."""
        return {}

    def answer(
        self,
        task: Task,
        generator: np.random.Generator,
        advance: Callable[[float], None] = lambda share: None,
        avoiding: Sequence[int] = (),
    ) -> ExactAnswer:
        """Return log Z_0, Z_c / Z_0 and trajectories from pi_0; see `ExactNominal`.

        Where no trajectory is allowed, log Z_0 is -inf, Z_c / Z_0 is NaN, and none is kept.

        Raises:
          ValueError: if the MDP returns NaN, an infinite state or a reward of +inf.
        """
        num_hypotheses = len(self.problem.hypotheses)
        size = PRODUCT // min(num_hypotheses + 7, 8 * estimators.BLOCK)
        log_mass = np.full(1 + num_hypotheses, -np.inf)  # Z_0 and every Z_c so far
        kept = _weighed(self.problem, 0, _root(self.problem, task.start).at(slice(0)))
        [mask] = pack_sets([avoiding], num_hypotheses)
        for leaves in _walk(self.problem, task, advance, mask):
            for first in range(0, len(leaves.code), size):
                part = leaves.at(slice(first, first + size))
                log_mass = np.logaddexp(log_mass, _log_masses(part, num_hypotheses))
            share = math.exp(np.logaddexp.reduce(leaves.log_weight) - log_mass[0])
            kept = _resampled(kept, leaves, share, generator)
        with np.errstate(invalid="ignore"):  # where no trajectory is allowed
            log_ratio = np.minimum(log_mass[1:] - log_mass[0], 0.0)
        states = _replay(self.problem, task, kept)
        sampled = KeptTrajectories(states, kept.total_reward, kept.length, kept.violations)
        return ExactAnswer(float(log_mass[0]), log_ratio, sampled)

    def log_partition(self, task: Task, avoiding: Sequence[Sequence[int]]) -> np.ndarray:
        """Return log Z_C for sets C of hypotheses, over trajectories that avoid all in the set.

        Args:
          task: start [n] and goal [g].
          avoiding: S sets, each the indices of its hypotheses; an empty set gives log Z_0.

        Returns:
          [S] in nats, -inf where no trajectory avoids the set.

        Raises:
          ValueError: if the task or an index does not fit the problem, or as for `answer`.
        """
        task = checked_task(self.problem, task)
        masks = pack_sets(avoiding, len(self.problem.hypotheses))
        log_mass = np.full(len(masks), -np.inf)
        none = np.zeros_like(masks[:1]).reshape(-1)
        for leaves in _walk(self.problem, task, lambda share: None, none):
            for k, mask in enumerate(masks):
                avoids = ~enters_set(leaves.violations, mask)
                log_mass[k] = np.logaddexp.reduce(leaves.log_weight[avoids], initial=log_mass[k])
        return log_mass


class _Nodes(NamedTuple):
    """Paths of the same number of steps.

    Attributes:
      state: [N, n] last states, float32.
      total_reward: [N] R so far.
      violations: [N, B] packed bits of the hypotheses entered so far.
      code: [N] codes of the actions.
    """

    state: np.ndarray
    total_reward: np.ndarray
    violations: np.ndarray
    code: np.ndarray

    def at(self, rows: np.ndarray | slice) -> _Nodes:
        """Return the paths of some rows."""
        return _Nodes(*(column[rows] for column in self))


class _Leaves(NamedTuple):
    """Finished trajectories.

    Attributes:
      length: [N] steps taken.
      code: [N] codes of the actions.
      total_reward: [N] R(xi).
      violations: [N, B] packed bits.
      log_weight: [N] beta R + log m, nats.
    """

    length: np.ndarray
    code: np.ndarray
    total_reward: np.ndarray
    violations: np.ndarray
    log_weight: np.ndarray

    def at(self, rows: np.ndarray | slice) -> _Leaves:
        """Return the trajectories of some rows."""
        return _Leaves(*(column[rows] for column in self))


def _walk(
    problem: Problem, task: Task, advance: Callable[[float], None], avoiding: np.ndarray
) -> Iterator[_Leaves]:
    """Yield all allowed trajectories, block by block.

    Trajectories that enter a hypothesis of `avoiding`, packed bits [B], are left out.
    """
    num_actions, num_hypotheses = problem.mdp.num_actions, len(problem.hypotheses)
    bytes_a_path = 8 * (num_hypotheses + 100)  # generous, for judging a path
    size = max(1, min(BLOCK, BLOCK_BYTES // bytes_a_path) // num_actions)
    waiting = [(0, _root(problem, task.start))]
    while waiting:
        step, nodes = waiting.pop()
        children, ended = _expand(problem, task.goal, step, nodes)
        if avoiding.any():
            avoids = ~enters_set(children.violations, avoiding)
            children, ended = children.at(avoids), ended[avoids]
        if ended.any():
            yield _weighed(problem, step + 1, children.at(ended))
        going_on = children.at(~ended)
        num_left = len(going_on.code)
        waiting += [
            (step + 1, going_on.at(slice(first, first + size)))
            for first in range(0, num_left, size)
        ]
        advance((len(nodes.code) * num_actions - num_left) / num_actions ** (step + 1))


def _root(problem: Problem, start: np.ndarray) -> _Nodes:
    """Return the start as a path; a hypothesis around the start is entered with the first step."""
    bits = no_bits(1, len(problem.hypotheses))
    return _Nodes(np.asarray(start, np.float32)[None], np.zeros(1), bits, np.zeros(1, np.int64))


def _expand(
    problem: Problem, goal: np.ndarray, step: int, nodes: _Nodes
) -> tuple[_Nodes, np.ndarray]:
    """Return the allowed paths that are one step longer, and whether each [N] has ended."""
    mdp, hypotheses = problem.mdp, problem.hypotheses
    states, rewards, endings = _take_steps(problem, nodes.state, step, goal)
    wrong = ~np.isfinite(states).all(axis=-1) | np.isnan(rewards) | np.isposinf(rewards)
    if wrong.any():
        n, a = np.argwhere(wrong)[0]
        segment = np.stack([nodes.state[n], states[n, a]])
        raise ValueError(_blame(problem, segment, a, goal, step))
    parent, action = np.nonzero(~np.isneginf(rewards))
    state, reward, ended = (column[parent, action] for column in (states, rewards, endings))
    segments = np.stack([nodes.state[parent], state], axis=1)
    actions = None
    if hypotheses.about_actions:
        values = np.asarray(mdp.actions, np.float64)[action]
        actions = Actions(tuple(mdp.action_names), values[:, None])
    entered = hypotheses.violations(segments, mdp.space, problem.between_states, actions)
    children = _Nodes(
        state,
        nodes.total_reward[parent] + reward,
        nodes.violations[parent] | entered,
        nodes.code[parent] * mdp.num_actions + action,
    )
    return children, ended


def _take_steps(
    problem: Problem, states: np.ndarray, step: int, goal: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return next states, rewards and endings [N, A, ...] of all actions in states [N, n]."""
    batch = jnp.asarray(padded(states, LEAST_PADDED))
    taken = _take_all(problem, batch, jnp.int32(step), jnp.asarray(goal, jnp.float32))
    return tuple(np.asarray(column)[: len(states)] for column in taken)


@of_problem
def _take_all(
    problem: Problem, states: Float[Array, "N n"], step: Array, goal: Float[Array, " g"]
) -> Step:
    by_action = jax.vmap(partial(take_step, problem), (None, 0, None, None))
    actions = jnp.arange(problem.mdp.num_actions, dtype=jnp.int32)
    return jax.vmap(lambda state: by_action(state, actions, step, goal))(states)


def _blame(problem: Problem, segment: np.ndarray, action: int, goal: np.ndarray, step: int) -> str:
    """Return a message that names the method of the MDP which failed on a segment [2, n]."""
    mdp, taken = problem.mdp, actions_of(problem.mdp)[action]
    where = f"at step {step} from state {segment[0].tolist()} by action {taken.tolist()}"
    before, after, target = (jnp.asarray(x, jnp.float32) for x in (*segment, goal))
    value, method = float(mdp.reward(before, taken, after, target)), "reward"
    expected = "a finite number, or -inf for what is not allowed"
    if not np.isfinite(segment[1]).all():
        value, method, expected = segment[1].tolist(), "dynamics", "finite numbers"
    elif math.isfinite(value) or value == -math.inf:
        value, method = float(mdp.terminal_reward(after, target)), "terminal_reward"
        where += f" to state {segment[1].tolist()}"
    return f"{type(mdp).__name__}.{method} returned {value} {where}: expected {expected}"


def _weighed(problem: Problem, length: int, nodes: _Nodes) -> _Leaves:
    """Return paths that have ended as trajectories with their weights."""
    log_weight = problem.beta * nodes.total_reward
    if problem.measure == "uniform":
        log_weight = log_weight - length * math.log(problem.mdp.num_actions)
    lengths = np.full(len(nodes.code), length)
    return _Leaves(lengths, nodes.code, nodes.total_reward, nodes.violations, log_weight)


def _log_masses(leaves: _Leaves, num_hypotheses: int) -> np.ndarray:
    """Return the log-weight [1 + H] of all leaves, and of the leaves that avoid each hypothesis."""
    found = estimators.avoid_probability(leaves.log_weight, leaves.violations, num_hypotheses)
    shares = np.concatenate([[1.0], found.avoid_probability])
    with np.errstate(divide="ignore"):  # where none of these trajectories avoids a hypothesis
        return np.logaddexp.reduce(leaves.log_weight) + np.log(shares)


def _resampled(
    kept: _Leaves, leaves: _Leaves, share: float, generator: np.random.Generator
) -> _Leaves:
    """Replace each of M trajectories, with probability `share`, by a new one sampled by weight.

    If `share` is the share of the new trajectories in the total weight so far, the results are
    samples by weight from all trajectories so far.
    """
    cumulative = np.cumsum(estimators.normalise(leaves.log_weight))
    points = cumulative[-1] * generator.random(NUM_KEPT)
    sampled = leaves.at(np.searchsorted(cumulative, points, side="right"))
    if not len(kept.code):
        return sampled
    changes = generator.random(NUM_KEPT) < share
    rows = np.arange(NUM_KEPT) + np.where(changes, NUM_KEPT, 0)
    return _Leaves(*(np.concatenate(pair)[rows] for pair in zip(kept, sampled, strict=True)))


def _replay(problem: Problem, task: Task, kept: _Leaves) -> np.ndarray:
    """Return the states [M, T+1, n] of trajectories, found by taking their actions again."""
    num_actions, rows = problem.mdp.num_actions, np.arange(len(kept.code))
    state = np.repeat(np.asarray(task.start, np.float32)[None], len(rows), axis=0)
    states = [state]
    for step in range(problem.mdp.num_steps):
        actions_after = np.maximum(kept.length - 1 - step, 0)
        action = kept.code // np.int64(num_actions) ** actions_after % num_actions
        following = _take_steps(problem, state, step, task.goal)[0][rows, action]
        state = np.where((step < kept.length)[:, None], following, state)
        states.append(state)
    return np.stack(states, axis=1)
