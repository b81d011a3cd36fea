"""Soft dynamic programming on a grid of states: pi_0 without learning, for n <= 3.

(For the grid of hypothesised cells see `hypotheses.grid`.)

    V_t(s) = log mean_a exp(beta r(s, a, s') + V_{t+1}(s'))    (sum for the counting measure)

holds at the nodes. Between nodes V is interpolated; where an episode has ended, V = beta r_T
exactly. The policy is the one-step look-ahead

    log pi(a | s, t) = beta r(s, a, s') + V_{t+1}(s') - logsumexp over a,

evaluated at the state itself, not at a node, so interpolation errors enter V alone. Dynamics do
not depend on time nor on the goal, so interpolation at all successors of all nodes is one sparse
matrix, and tasks with the same goal share one backward pass.

Steps into a known constraint are left out of the sum. A node is closed if every step from the node
is forbidden, or leads to a place with only closed nodes around. V at a state is interpolated from
nodes that are open and in sight, not behind a wall.

Shapes: S nodes, A actions, T steps, n state dimensions, G goals solved at once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from swerve.base.arguments import whole_number
from swerve.base.pickling import PickledByFields
from swerve.problem.problem import Problem
from swerve.simulation.policies import CLOSED, FORBIDDEN, LookAhead, is_open, log_measure
from swerve.solvers.base import AdaptingSolver, LearnOptions
from swerve.solvers.grid.interpolation import STENCIL, StateGrid, choose_smooth
from swerve.solvers.grid.model import (
    CLIFF,
    Successors,
    clear_cells,
    find_successors,
    goal_model,
    in_sight,
)

DEFAULT_POINTS = {1: 1001, 2: 361, 3: 61}  # nodes along a straight axis; an angle has half as many
VALUES_BYTES = 1 << 30  # bytes of soft values held at once; more goals are solved in blocks
MATRIX_BYTES = 8 << 30  # bytes: a grid that needs more for a matrix or for values is refused


@dataclass(frozen=True)
class Grid(AdaptingSolver["GridNominal"]):
    """Solver: soft dynamic programming on a state grid, then one-step look-ahead.

    Attributes:
      num_points: nodes along each axis, or 0 for the default resolution: 361 nodes in two
        dimensions (angles 180), 1001 in one, 61 in three. In a text: "grid?num_points=180,361".
    """

    num_points: tuple[int, ...] | int = 0

    name = "grid"

    def __post_init__(self) -> None:
        if isinstance(self.num_points, Iterable):
            points = tuple(whole_number(x, "Grid: num_points", STENCIL) for x in self.num_points)
            object.__setattr__(self, "num_points", points)
        else:
            whole_number(self.num_points, "Grid: num_points", 0)

    def _learn(self, problem: Problem, options: LearnOptions) -> GridNominal:
        return GridNominal(problem, dataclasses.replace(self, num_points=self._resolution(problem)))

    def adapted(self, nominal: GridNominal, problem: Problem, seed: int) -> Iterator[GridNominal]:
        """Yield the nominal distribution of a problem with more known constraints."""
        yield GridNominal(problem, self)

    def check(self, problem: Problem) -> None:
        """Raise ValueError if the grid does not suit the problem, or would not fit memory."""
        self._resolution(problem)

    def _resolution(self, problem: Problem) -> tuple[int, ...]:
        """Return the nodes along each axis, checked against dimensions and memory."""
        space = problem.mdp.space
        n = len(space.names)
        self.check_dimensions(problem)
        if self.num_points == 0:
            points = DEFAULT_POINTS[len(space.names)]
            resolution = tuple(points // 2 if angle else points for angle in space.is_angle)
        elif isinstance(self.num_points, int):
            resolution = (self.num_points,) * len(space.names)
        else:
            resolution = self.num_points
        num_nodes = StateGrid(space, resolution).num_nodes
        # 8 bytes an entry, twice while the actions' parts are joined
        matrix = 2 * 8 * num_nodes * problem.mdp.num_actions * (4**n + 2**n)
        values = 4 * num_nodes * (problem.mdp.num_steps + 1)
        if max(matrix, values) > MATRIX_BYTES:
            raise ValueError(
                f"a grid of {' x '.join(map(str, resolution))} nodes needs "
                f"{matrix / 2**30:.1f} GiB for its interpolation matrix and "
                f"{values / 2**30:.1f} GiB a goal for values, more than "
                f"{MATRIX_BYTES / 2**30:.0f} GiB: pass fewer num_points"
            )
        return resolution


class GridPolicy(LookAhead):
    """The look-ahead policy of one goal, with values interpolated between nodes.

    Attributes:
      values: [T+1, S] beta-weighted soft values at the nodes, nats.
      clear: [S] cells with no known constraint around, see `clear_cells`.
    """

    problem: Problem = eqx.field(static=True)
    grid: StateGrid = eqx.field(static=True)
    values: Float[Array, "T+1 S"]
    clear: Bool[Array, " S"] | None

    def value(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return V at a state from V at the nodes that are open and in sight."""
        values = self.values[step]
        if self.clear is None:
            return self.grid.interpolate(values, state)
        cubic, (nodes, weights) = self.grid.cubic(state), in_sight(self.problem, self.grid, state)
        weights = jnp.where(is_open(values[nodes]), weights, 0.0)
        reach = jnp.sum(weights)
        linear = jnp.sum(values[nodes] * weights) / jnp.maximum(reach, 1e-9)
        around = values[cubic.nodes]
        smooth = jnp.sum(jnp.where(is_open(around), around, CLIFF) * cubic.weights)
        value = jnp.where(self.clear[nodes[0]], choose_smooth(jnp, smooth, linear), linear)
        return jnp.where(reach > 0.0, value, CLOSED)


@dataclass(frozen=True, eq=False)
class GridNominal(PickledByFields):
    """pi_0 by dynamic programming; the policy of a goal is computed when it is asked for."""

    problem: Problem
    solver: Grid

    @cached_property
    def grid(self) -> StateGrid:
        """The grid of states."""
        assert isinstance(self.solver.num_points, tuple)
        return StateGrid(self.problem.mdp.space, self.solver.num_points)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return no arrays: the values of a goal are cheaper to compute than to keep."""
        return {}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[GridPolicy]:
        """Yield the policy of each goal [G, g] in turn, in blocks that fit memory."""
        bytes_a_goal = 4 * self.grid.num_nodes * (self.problem.mdp.num_steps + 1)
        block = max(1, VALUES_BYTES // bytes_a_goal)
        clear = None if self._clear is None else jnp.asarray(self._clear)
        for first in range(0, len(goals), block):
            for values in self.backward(goals[first : first + block], advance):
                yield GridPolicy(self.problem, self.grid, jnp.asarray(values, jnp.float32), clear)

    def backward(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> np.ndarray:
        """Return the soft values [G, T+1, S] at the nodes for goals [G, g], nats."""
        problem, successors = self.problem, self._successors
        mdp, num_nodes = problem.mdp, self.grid.num_nodes
        model = goal_model(problem, self.grid.nodes(), successors, goals)
        values = np.empty((len(goals), mdp.num_steps + 1, num_nodes), np.float32)
        value, following = model.node_terminal, model.successor_terminal.copy()
        values[:, mdp.num_steps] = value.T
        for step in range(mdp.num_steps - 1, -1, -1):
            if step < mdp.num_steps - 1:
                following = successors.interpolate(value)
                np.copyto(following, model.successor_terminal, where=model.successor_ended)
            following += model.reward
            following[successors.forbidden] = FORBIDDEN
            value = _log_sum_exp(following.reshape(mdp.num_actions, num_nodes, len(goals)))
            value -= log_measure(problem)
            np.copyto(value, model.node_terminal, where=model.node_ended)
            values[:, step] = value.T
            advance(len(goals) / mdp.num_steps)
        return values

    @cached_property
    def _successors(self) -> Successors:
        return find_successors(self.problem, self.grid, self._clear)

    @cached_property
    def _clear(self) -> np.ndarray | None:
        return clear_cells(self.problem, self.grid)


def _log_sum_exp(action_values: np.ndarray) -> np.ndarray:
    """Return log sum exp over the first axis of [A, ...], overwriting its argument."""
    largest = action_values.max(axis=0)
    action_values -= largest
    np.exp(action_values, out=action_values)
    total = action_values.sum(axis=0)
    np.log(total, out=total)
    total += largest
    return total
