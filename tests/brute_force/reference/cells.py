"""A smooth world seen through the cells of a grid, and walks of any length on a table.

In a cell world, an action is held for a few steps from the centre of a cell; the next state is the
centre of the cell where that ends. On a table, the walks from s of all lengths weigh

    Z(s) = sum_a exp(beta r(s, a) + log m) Z(s'),    Z(s) = exp(beta r_T(s)) where walks end.

Shapes: N states, n dimensions of one, S states of a table, A actions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from brute_force.reference.geometry import NEAR, TURN, AmbiguousError
from brute_force.reference.regions import Region, Steps
from brute_force.reference.worlds import Moves, SmoothWorld, TableWorld

SWEEPS = 4000  # far more than the sums over walks need


@dataclass(frozen=True, eq=False)
class CellWorld(SmoothWorld):
    """A smooth world on the centres of cells.

    Attributes:
      low: [n] where the grid begins.
      high: [n] where it ends; a full turn away for angles.
      num_cells: [n].
      hold: steps for which an action is held.
    """

    low: np.ndarray
    high: np.ndarray
    num_cells: np.ndarray
    hold: int

    @property
    def mdp_steps(self) -> int:
        return self.num_steps * self.hold

    def centres(self, states: np.ndarray) -> np.ndarray:
        """Return the centres [N, n] of the cells of states; the nearest cell for those beyond."""
        width = (self.high - self.low) / self.num_cells
        place, found = (states - self.low) / width, np.empty_like(states)
        if (np.abs(place - np.rint(place)) < NEAR).any():
            raise AmbiguousError("a state lies between two cells")
        for k, name in enumerate(self.axes.names):
            cell = np.floor(place[:, k])
            num = self.num_cells[k]
            cell = cell % num if name in self.axes.angles else np.clip(cell, 0, num - 1)
            found[:, k] = self.low[k] + (cell + 0.5) * width[k]
        return found

    def moves(self, states: np.ndarray, action: int, goal: np.ndarray) -> Moves:
        now, earned = states, np.zeros(len(states))
        over = np.zeros(len(states), bool)
        for _ in range(self.hold):
            moved = super().moves(now, action, goal)
            earned = earned + np.where(over, 0.0, moved.rewards)
            now = np.where(over[:, None], now, moved.states)
            over = over | moved.ended
        ends = self.centres(now)
        beyond = ends @ self.ending - self.limit
        if (np.abs(beyond) < NEAR).any():
            raise AmbiguousError("the centre of a cell lies on the limit")
        terminal = -self.off(ends, goal, self.final) - self.penalty * (beyond > 0.0)
        return Moves(ends, earned, beyond > 0.0, terminal)


def in_cells(world: SmoothWorld, generator: np.random.Generator) -> CellWorld:
    """Return a world as it is seen through random cells."""
    n = len(world.axes.names)
    is_angle = np.array([name in world.axes.angles for name in world.axes.names])
    low = np.where(is_angle, 0.0, generator.uniform(-2.6, -2.0, n))
    high = np.where(is_angle, TURN, generator.uniform(2.0, 2.6, n))
    numbers = {field.name: getattr(world, field.name) for field in fields(SmoothWorld)}
    num_cells = generator.integers(5, 9, n)
    hold = int(generator.integers(1, 3))
    return CellWorld(**numbers, low=low, high=high, num_cells=num_cells, hold=hold)


def walk_weights(
    world: TableWorld, beta: float, measure: str, region: Region | None = None
) -> np.ndarray:
    """Return log Z(s) [S] of the walks of all lengths that enter a region nowhere, nats."""
    num, num_actions = world.successors.shape
    offset = -math.log(num_actions) if measure == "uniform" else 0.0
    ends = np.where(world.absorbing, np.exp(beta * world.terminal), 0.0)
    weight = np.where(world.successors < 0, 0.0, np.exp(beta * world.rewards + offset))
    if region is not None:
        states = np.arange(num, dtype=float)[:, None]
        for action in range(num_actions):
            to = np.maximum(world.successors[:, action], 0)[:, None].astype(float)
            taken = np.repeat(world.actions[action][None], num, axis=0)
            steps = Steps(states, to, taken, world.action_names)
            enters = region.entered(steps, world.axes, False) | region.holds(states, world.axes)
            weight[enters, action] = 0.0
    value = ends
    for _ in range(SWEEPS):
        onwards = (weight * value[np.maximum(world.successors, 0)]).sum(axis=1)
        value = np.where(world.absorbing, ends, onwards)
    with np.errstate(divide="ignore"):
        return np.log(value)


def longest_share(world: TableWorld, beta: float, measure: str, start: int) -> float:
    """Return the share of the walks from a start that take more steps than the horizon."""
    num_actions = world.successors.shape[1]
    offset = -math.log(num_actions) if measure == "uniform" else 0.0
    value = np.exp(walk_weights(world, beta, measure))
    weight = np.where(world.successors < 0, 0.0, np.exp(beta * world.rewards + offset))
    there = np.zeros(len(value))
    there[start] = 1.0
    for _ in range(world.num_steps):
        onwards = np.zeros(len(value))
        np.add.at(onwards, np.maximum(world.successors, 0), there[:, None] * weight)
        there = np.where(world.absorbing, 0.0, onwards)
    return float(there @ value / value[start])
