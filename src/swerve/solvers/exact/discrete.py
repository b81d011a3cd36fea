"""Discretised dynamics (Stocking et al., 2021): a table of cells for the tabular method.

A state is a cell of a regular grid over the bounds. An action is held for a few steps of the MDP,
from the centre of the cell; the cell where the action ends is the successor. Answers are exact for
the table, not for the MDP: cells are wide, choices are few, and a state that does not leave its
cell stays there for ever. So the number of cells and the time that an action is held matter: try
several of both.

Shapes: S cells, A actions, n state dimensions, P points of a cell, g goal dimensions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import whole_number
from swerve.base.pickling import PickledByFields
from swerve.base.progress import progress_bar
from swerve.base.space import TWO_PI, StateSpace
from swerve.problem.boundary import actions_of
from swerve.problem.problem import Problem
from swerve.solvers.base import LearnOptions, Solver
from swerve.solvers.exact.tabular import States, TableNominal, check_size

RULES = ("centre", "majority")
DEFAULT_CELLS = {1: 400, 2: 60, 3: 24, 4: 12}  # cells along each axis, by number of dimensions
DEFAULT_STEPS = 50  # choices of an action in an episode, about
ROUNDING = 1e-6  # rad by which the range of an angle may differ from a full turn


@dataclass(frozen=True)
class Discrete(Solver[TableNominal]):
    """Solver: tabular inference on a grid of cells; each action is held for several steps.

    Attributes:
      num_cells: cells along each axis, or 0 for 400, 60, 24 or 12 in 1, 2, 3 or 4 dimensions.
      hold: steps of the MDP for which an action is held, or 0 for about 50 choices an episode.
      low: where the grid begins along each axis; () for the bounds, and a full turn of angles.
      high: where the grid ends. A state beyond the grid counts as one of the cell at the edge.
      rule: "centre": the successor is the cell that the centre of a cell leads to; "majority": the
        cell that most of 2^n + 1 points of a cell lead to.
    """

    num_cells: tuple[int, ...] | int = 0
    hold: int = 0
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    rule: str = "centre"

    name = "discrete"

    def __post_init__(self) -> None:
        if isinstance(self.num_cells, Iterable):
            cells = tuple(whole_number(x, "Discrete: num_cells", 1) for x in self.num_cells)
            object.__setattr__(self, "num_cells", cells)
        else:
            whole_number(self.num_cells, "Discrete: num_cells", 0)
        whole_number(self.hold, "Discrete: hold", 0)
        for name in ("low", "high"):  # settings from a file are lists
            values = getattr(self, name)
            if not isinstance(values, Iterable) or not all(map(np.isfinite, values)):
                raise ValueError(
                    f"Discrete: {name}: expected a finite number for each state, or none for the "
                    f"bounds of the MDP, got {values!r}"
                )
            object.__setattr__(self, name, tuple(float(x) for x in values))
        if self.rule not in RULES:
            raise ValueError(f"Discrete: rule: expected one of {RULES}, got {self.rule!r}")

    def _learn(self, problem: Problem, options: LearnOptions) -> TableNominal:
        cells = Cells(problem.mdp.space, self._shape(problem), self._limits(problem))
        hold = self._hold(problem)
        rewards = HeldRewards(problem, cells.centres, hold)
        with progress_bar("making the table", 1.0, options.progress):
            successors = _successors(cells, rewards.held, problem, self.rule)
        step = hold * problem.mdp.dt
        table = States(cells.centres, successors, self._num_steps(problem), cells.number, step)
        return TableNominal(problem, self, table, rewards)

    def check(self, problem: Problem) -> None:
        """Raise ValueError if the grid does not suit the problem, or would not fit memory."""
        mdp, n = problem.mdp, len(problem.mdp.state_names)
        self.check_dimensions(problem)
        shape = self._shape(problem)
        if len(shape) != n:
            raise ValueError(
                f"Discrete: num_cells: expected one number for each of the states "
                f"{', '.join(mdp.state_names)}, got {shape}"
            )
        low, high = self._limits(problem)
        if low.shape != (n,) or high.shape != (n,) or not (low < high).all():
            raise ValueError(
                f"Discrete: low, high: expected where the grid begins and ends for each of the "
                f"states {', '.join(mdp.state_names)}, got {self.low} and {self.high}"
            )
        if (high - low > TWO_PI + ROUNDING)[mdp.space.is_angle].any():
            raise ValueError(
                f"Discrete: low, high: expected at most a full turn of each angle, got {self.low} "
                f"and {self.high}"
            )
        if self.hold > mdp.num_steps:
            raise ValueError(
                f"Discrete: hold: expected at most the {mdp.num_steps} steps of an episode, got "
                f"{self.hold}"
            )
        num_steps = self._num_steps(problem)
        check_size(math.prod(shape), mdp.num_actions, num_steps, len(problem.hypotheses))

    def _shape(self, problem: Problem) -> tuple[int, ...]:
        n = len(problem.mdp.state_names)
        if isinstance(self.num_cells, int):
            return (self.num_cells or DEFAULT_CELLS[n],) * n
        return self.num_cells

    def _limits(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return where the grid begins [n] and ends [n]."""
        space = problem.mdp.space
        low = np.where(space.is_angle, 0.0, space.bounds[:, 0])
        high = np.where(space.is_angle, TWO_PI, space.bounds[:, 1])
        return (np.array(self.low) if self.low else low, np.array(self.high) if self.high else high)

    def _hold(self, problem: Problem) -> int:
        return self.hold or max(1, round(problem.mdp.num_steps / DEFAULT_STEPS))

    def _num_steps(self, problem: Problem) -> int:
        """Return the number of choices that lasts about as long as an episode of the MDP."""
        return max(1, round(problem.mdp.num_steps / self._hold(problem)))


class Cells:
    """A regular grid of cells; an angle wraps if the grid covers a full turn of the angle.

    Args:
      space: names and angles of the states.
      shape: cells along each axis.
      limits: where the grid begins [n] and ends [n].
    """

    def __init__(
        self, space: StateSpace, shape: tuple[int, ...], limits: tuple[np.ndarray, np.ndarray]
    ) -> None:
        self.shape = shape
        self.low, high = limits
        self.width = (high - self.low) / np.array(shape)
        self.goes_round = space.is_angle & (high - self.low > TWO_PI - ROUNDING)
        self.is_part = space.is_angle & ~self.goes_round

    @property
    def centres(self) -> np.ndarray:
        """[S, n] the centres of the cells, the last axis fastest."""
        index = np.unravel_index(np.arange(math.prod(self.shape)), self.shape)
        return self.low + (np.stack(index, axis=-1) + 0.5) * self.width

    def number(self, states: np.ndarray) -> np.ndarray:
        """Return the cell [...] of states [..., n]; the cell at the edge for states beyond it."""
        middle = self.low + 0.5 * self.width * np.array(self.shape)
        nearest = middle + (states - middle + math.pi) % TWO_PI - math.pi
        states = np.where(self.is_part, nearest, states)
        index = np.floor((states - self.low) / self.width).astype(np.int64)
        size = np.array(self.shape)
        index = np.where(self.goes_round, index % size, np.clip(index, 0, size - 1))
        return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), self.shape))


Held = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
"""Maps states [S, n] and a goal [g] to next states [S, A, n] and total rewards [S, A]."""


def _held(problem: Problem, hold: int) -> Held:
    """Return the function that holds an action for `hold` steps, or until the episode ends."""
    mdp = problem.mdp

    def hold_action(state: jax.Array, action: jax.Array, goal: jax.Array) -> tuple:
        def one(carry: tuple, _: None) -> tuple[tuple, None]:
            state, earned, ended = carry
            following = mdp.dynamics(state, action)
            reward = mdp.reward(state, action, following, goal)
            earned = earned + jnp.where(ended, 0.0, reward)
            state = jnp.where(ended, state, following)
            return (state, earned, ended | mdp.terminated(following, goal)), None

        start = (state, jnp.float32(0.0), jnp.zeros((), bool))
        (state, earned, _), _ = jax.lax.scan(one, start, length=hold)
        return state, earned

    over_actions = jax.vmap(hold_action, (None, 0, None))
    over_states = jax.vmap(over_actions, (0, None, None))
    return jax.jit(lambda states, goal: over_states(states, actions_of(mdp), goal))


@dataclass(frozen=True, eq=False)
class HeldRewards(PickledByFields):
    """The rewards of actions that are held for some steps, as a function of the goal.

    Attributes:
      problem: problem that was learned.
      centres: [S, n] centres of the cells.
      hold: steps for which an action is held.
    """

    problem: Problem
    centres: np.ndarray
    hold: int

    def __call__(self, goal: np.ndarray) -> np.ndarray:
        """Return the total rewards [S, A] for a goal [g].

        Raises:
          ValueError: if actions are held, and where episodes end depends on the goal.
        """
        target, mdp = jnp.asarray(goal, jnp.float32), self.problem.mdp
        if self.hold > 1 and (self._ends(target) != self._ends_anywhere).any():
            raise ValueError(
                f"Discrete: where episodes of {type(mdp).__name__} end depends on the goal, so an "
                f"action cannot be held for {self.hold} steps: set hold=1"
            )
        return np.asarray(self.held(jnp.asarray(self.centres, jnp.float32), target)[1], float)

    @cached_property
    def held(self) -> Held:
        """Function that holds every action in every state."""
        return _held(self.problem, self.hold)

    @cached_property
    def _ends_anywhere(self) -> np.ndarray:
        return self._ends(jnp.zeros(len(self.problem.mdp.goal_names), jnp.float32))

    def _ends(self, goal: jax.Array) -> np.ndarray:
        """Return [S] where episodes with a goal [g] end."""
        states = jnp.asarray(self.centres, jnp.float32)
        return np.asarray(jax.vmap(self.problem.mdp.terminated, (0, None))(states, goal))


def _successors(cells: Cells, held: Held, problem: Problem, rule: str) -> np.ndarray:
    """Return the cell [S, A] that each action leads to."""
    mdp = problem.mdp
    goal = jnp.zeros(len(mdp.goal_names), jnp.float32)
    n = len(cells.shape)
    offsets = [np.zeros(n)]
    if rule == "majority":
        offsets += [cells.width / 3.0 * corner for corner in itertools.product((-1, 1), repeat=n)]
    found = []
    for offset in offsets:
        ends = np.asarray(held(jnp.asarray(cells.centres + offset, jnp.float32), goal)[0], float)
        bad = np.argwhere(~np.isfinite(ends).all(axis=-1))
        if len(bad):
            state, action = bad[0]
            raise ValueError(
                f"{type(mdp).__name__}.dynamics leads from {cells.centres[state].tolist()} by "
                f"action {np.asarray(mdp.actions)[action].tolist()} to "
                f"{ends[state, action].tolist()}: expected finite states everywhere in the bounds"
            )
        found.append(cells.number(ends))
    candidates = np.stack(found)  # [P, S, A]
    votes = np.zeros(candidates.shape)
    for candidate in candidates:
        votes += candidates == candidate
    votes[0] += 0.5  # where cells have equally many votes, the cell that the centre leads to wins
    return np.take_along_axis(candidates, votes.argmax(axis=0)[None], axis=0)[0]
