"""Define the gridworld of Scobee & Sastry (2019): cells, walls, features, moves and a goal.

    R(xi) = step_reward * (moves taken),    and every trajectory must reach its goal.

A move that would leave the world or enter a wall is not offered. Reaching the goal ends the
episode.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import whole_number
from swerve.base.space import Task
from swerve.constraints.base import Constraint, Union
from swerve.constraints.boxes import ActionBox, Box
from swerve.problem.problem import Problem
from swerve.systems.tabular import NOWHERE, TabularMDP

Cell = tuple[int, int]
MOVES = {
    "left": (-1, 0),
    "right": (1, 0),
    "up": (0, 1),
    "down": (0, -1),
    "up-left": (-1, 1),
    "up-right": (1, 1),
    "down-left": (-1, -1),
    "down-right": (1, -1),
}


def _cells(cells: Iterable[Cell]) -> tuple[Cell, ...]:
    """Return cells as pairs of whole numbers."""
    try:
        pairs = [(operator.index(x), operator.index(y)) for x, y in cells]
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"Gridworld: expected cells as pairs of whole numbers, ((4, 4), (5, 4)), got {cells!r}"
        ) from error
    return tuple(pairs)


def _features(
    features: Mapping[str, Iterable[Cell]] | Iterable[tuple[str, Iterable[Cell]]],
) -> tuple[tuple[str, tuple[Cell, ...]], ...]:
    """Return features as pairs of a name and cells."""
    pairs: list[Any] = list(features.items() if isinstance(features, Mapping) else features)
    for pair in pairs:
        if isinstance(pair, str) or len(pair) != 2 or not isinstance(pair[0], str):
            raise ValueError(
                "Gridworld: cell_features: expected names and their cells, "
                f'{{"wet": ((2, 1), (3, 1))}}, got {features!r}'
            )
    return tuple((name, _cells(cells)) for name, cells in pairs)


class Gridworld(TabularMDP):
    """A world of width x height cells in which a walker takes one of eight moves at a time.

    Cell (x, y) is state y * width + x, the square of side 1 around the point (x, y).

    Attributes:
      width: number of columns.
      height: number of rows.
      num_steps: T, the largest number of moves.
      step_reward: reward of a move, straight or diagonal.
      walls: cells (x, y) that cannot be entered.
      cell_features: a dictionary of names and their cells, or (name, cells) pairs; all cells of a
        feature together are one hypothesis.
    """

    width: int = eqx.field(static=True, default=9)
    height: int = eqx.field(static=True, default=9)
    num_steps: int = eqx.field(static=True, default=24)
    step_reward: float = -1.0
    walls: tuple[Cell, ...] = eqx.field(static=True, default=(), converter=_cells)
    cell_features: tuple[tuple[str, tuple[Cell, ...]], ...] = eqx.field(
        static=True, default=(), converter=_features
    )

    state_names = ("x", "y")
    action_names = ("dx", "dy")
    actions = np.array(list(MOVES.values()), np.float32)

    def __check_init__(self) -> None:
        """Raise ValueError where the world has no cell, or a given cell is not in the world."""
        for name in ("width", "height"):
            whole_number(getattr(self, name), f"Gridworld: {name}", 1)
        if np.isnan(self.step_reward) or self.step_reward == np.inf:
            raise ValueError(f"Gridworld: step_reward: expected a number, got {self.step_reward}")
        for name, cells in (("walls", self.walls), *self.cell_features):
            for cell in cells:
                if not (0 <= cell[0] < self.width and 0 <= cell[1] < self.height):
                    raise ValueError(
                        f"Gridworld: {name}: cell {cell} is not in the world of {self.width} x "
                        f"{self.height} cells"
                    )

    @property
    def shape(self) -> tuple[int, ...]:
        """Columns and rows."""
        return (self.width, self.height)

    @property
    def successors(self) -> np.ndarray:
        """[S, A] the cell that each move leads to, NOWHERE where the move is not offered."""
        return _successors(self.width, self.height, self.walls)

    @property
    def rewards(self) -> np.ndarray:
        """[S, A] the reward of each move."""
        return np.full((self.num_states, len(MOVES)), self.step_reward)

    def terminated(self, state: Any, goal: Any) -> Any:
        """Return whether the walker is at the goal."""
        return self.state_index(state) == self.state_index(goal)

    def terminal_reward(self, state: Any, goal: Any) -> Any:
        """Return -inf where the goal was not reached."""
        return jnp.where(self.terminated(state, goal), 0.0, -jnp.inf)

    def sample_task(self, key: Any) -> Task:
        """Sample a start and a goal, two different cells that are not walls."""
        start, step = jax.random.split(key)
        blocked = [y * self.width + x for x, y in self.walls]
        free = jnp.asarray(np.delete(self.states, blocked, axis=0), jnp.float32)
        first = jax.random.randint(start, (), 0, len(free), jnp.int32)
        second = (first + jax.random.randint(step, (), 1, len(free), jnp.int32)) % len(free)
        return Task(free[first], free[second])

    def hypotheses(self) -> list[Constraint]:
        """Return every feature, every cell and every move as a constraint, in this order."""
        return [
            *(
                Union(name, [cell_box(cell) for cell in cells])
                for name, cells in self.cell_features
            ),
            *(cell_box((int(x), int(y))) for x, y in self.states),
            *(move_box(name) for name in MOVES),
        ]


@functools.lru_cache(maxsize=8)
def _successors(width: int, height: int, walls: tuple[Cell, ...]) -> np.ndarray:
    """Return the cell [S, A] that each move leads to, NOWHERE where the move is not offered."""
    y, x = np.divmod(np.arange(width * height), width)
    dx, dy = np.array(list(MOVES.values())).T
    x, y = x[:, None] + dx, y[:, None] + dy
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    index = np.where(inside, y * width + x, NOWHERE)
    blocked = [wall_y * width + wall_x for wall_x, wall_y in walls]
    found = np.where(np.isin(index, blocked), NOWHERE, index).astype(np.int32)
    found[blocked] = NOWHERE  # walls offer no move
    found.flags.writeable = False  # the cache shares the array among all callers
    return found


def cell_box(cell: Cell) -> Box:
    """Return a cell as a constraint."""
    x, y = cell
    return Box(x=(x - 0.5, x + 0.5), y=(y - 0.5, y + 0.5))


def move_box(name: str) -> ActionBox:
    """Return a move, such as "up-left", as a constraint."""
    dx, dy = MOVES[name]
    return ActionBox(dx=(dx - 0.5, dx + 0.5), dy=(dy - 0.5, dy + 0.5))


def gridworld(
    width: int = 9, height: int = 9, num_steps: int = 24, step_reward: float = -1.0
) -> Problem:
    """Return the problem `gridworld`, with every cell and every move as a hypothesis.

    Args:
      width: number of columns.
      height: number of rows.
      num_steps: the largest number of moves.
      step_reward: reward of a move.
    """
    mdp = Gridworld(width, height, num_steps, step_reward)
    return Problem(mdp, mdp.hypotheses(), measure="counting", between_states=False)
