"""Evaluate an MDP for dynamic programming on a grid: successors, rewards and endings.

Everything here is evaluated once, at the nodes. Dynamics depend neither on time nor on the goal, so
one sparse matrix interpolates V at all successors of all nodes.

Shapes: S nodes, A actions, n state dimensions, G goals solved at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from swerve.problem.boundary import actions_of
from swerve.problem.problem import Problem
from swerve.simulation.policies import CLOSED, is_open
from swerve.simulation.trajectory import enters
from swerve.solvers.grid.interpolation import StateGrid, Stencil, choose_smooth

CLIFF = -1e6  # nats, V of a closed node in a cubic: so low that the linear value is taken
BATCH = 4096  # cells whose surroundings are judged at once, to bound memory


@dataclass(frozen=True)
class Successors:
    """All successors of all nodes, in order of action then node.

    Attributes:
      states: [A*S, n].
      cubic: [A*S, S] sparse matrix: times values at nodes, it gives values at successors.
      linear: [A*S, S] the same matrix for linear interpolation, from nodes in sight alone.
      forbidden: [A*S] whether the step to the successor enters a known constraint.
      clear: [A*S] whether no known constraint is near the successor; None if none is known.
    """

    states: np.ndarray
    cubic: Any
    linear: Any
    forbidden: np.ndarray
    clear: np.ndarray | None

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Return V at the successors [A*S, G] from V at the nodes [S, G]."""
        if self.clear is None:
            return choose_smooth(np, self.cubic @ values, self.linear @ values)
        opened = is_open(values)
        reach = self.linear @ opened.astype(np.float32)
        linear = self.linear @ np.where(opened, values, np.float32(0.0))
        np.divide(linear, reach, out=linear, where=reach > 0.0)
        smooth = self.cubic @ np.where(opened, values, np.float32(CLIFF))
        value = np.where(self.clear[:, None], choose_smooth(np, smooth, linear), linear)
        return np.where(reach > 0.0, value, np.float32(CLOSED))


def in_sight(problem: Problem, grid: StateGrid, state: Float[Array, " n"]) -> Stencil:
    """Return the linear stencil of a state with weight 0 for nodes behind a known constraint."""
    nodes, weights = grid.linear(state)
    places = jnp.asarray(grid.nodes(), jnp.float32)[nodes]
    hidden = jax.vmap(
        lambda place: enters(problem.known, state, place, problem.mdp, problem.between_states)
    )(places)
    return Stencil(nodes, jnp.where(hidden, 0.0, weights))


def clear_cells(problem: Problem, grid: StateGrid) -> np.ndarray | None:
    """Return for each cell whether all nodes of its cubic stencil are in sight of its corners.

    In the other cells a known constraint is near, and a cubic would interpolate through it.

    Returns:
      [S] booleans, each at the number of the cell's lowest corner; None if no constraint is known.
    """
    if not problem.known:
        return None
    nodes = jnp.asarray(grid.nodes(), jnp.float32)
    half = jnp.asarray(grid.spacing, jnp.float32) / 2

    def is_clear(corner: Array) -> Array:
        middle = corner + half
        corners, around = nodes[grid.linear(middle).nodes], nodes[grid.cubic(middle).nodes]

        def hidden(a: Array, b: Array) -> Array:
            return enters(problem.known, a, b, problem.mdp, problem.between_states)

        return ~jax.vmap(lambda a: jax.vmap(lambda b: hidden(a, b))(around))(corners).any()

    return np.asarray(jax.jit(lambda x: jax.lax.map(is_clear, x, batch_size=BATCH))(nodes))


@dataclass(frozen=True)
class GoalModel:
    """Rewards and endings of G goals: [S, G] at nodes, [A*S, G] at successors, in nats."""

    node_terminal: np.ndarray
    node_ended: np.ndarray
    successor_terminal: np.ndarray
    successor_ended: np.ndarray
    reward: np.ndarray


def find_successors(problem: Problem, grid: StateGrid, clear: np.ndarray | None) -> Successors:
    """Take every action at every node, and find the weights that interpolate at the successors.

    Args:
      problem: the model.
      grid: the S nodes.
      clear: [S] result of `clear_cells`.
    """
    mdp = problem.mdp

    @jax.jit
    def successors_of(action: Array, nodes: Array) -> tuple[Array, Array, Array, Stencil, Stencil]:
        def step(state: Array) -> tuple[Array, Array, Array, Stencil, Stencil]:
            next_state = mdp.dynamics(state, action)
            forbidden = enters(
                problem.known, state, next_state, mdp, problem.between_states, action
            )
            linear = in_sight(problem, grid, next_state)
            return next_state, forbidden, linear.nodes[0], grid.cubic(next_state), linear

        return jax.vmap(step)(nodes)

    nodes = jnp.asarray(grid.nodes(), jnp.float32)
    parts = []
    for action in actions_of(mdp):
        states, forbidden, cell, *stencils = successors_of(action, nodes)
        _check_finite(np.asarray(states), grid, f"{type(mdp).__name__}.dynamics")
        matrices = [_sparse(stencil, grid.num_nodes) for stencil in stencils]
        parts.append((np.asarray(states), np.asarray(forbidden), np.asarray(cell), *matrices))
    states, forbidden, cells, cubic, linear = zip(*parts, strict=True)
    return Successors(
        states=np.concatenate(states),
        cubic=scipy.sparse.vstack(cubic, format="csr"),
        linear=scipy.sparse.vstack(linear, format="csr"),
        forbidden=np.concatenate(forbidden),
        clear=None if clear is None else clear[np.concatenate(cells)],
    )


def _sparse(stencil: Stencil, num_nodes: int) -> scipy.sparse.csr_matrix:
    """Return the sparse matrix of stencils, [R, K] nodes and weights, without its zeros."""
    nodes, weights = (np.asarray(part) for part in stencil)
    rows = np.arange(0, nodes.size + 1, nodes.shape[1])
    matrix = scipy.sparse.csr_matrix(
        (weights.ravel(), nodes.ravel(), rows), shape=(len(nodes), num_nodes), copy=True
    )
    matrix.eliminate_zeros()  # in place, hence the copy
    return matrix


def goal_model(
    problem: Problem, nodes: np.ndarray, successors: Successors, goals: np.ndarray
) -> GoalModel:
    """Evaluate rewards and endings at all nodes and successors, for every goal."""
    mdp, beta = problem.mdp, problem.beta

    @jax.jit
    def at_states(states: Array, goal: Array) -> tuple[Array, Array]:
        terminal = jax.vmap(mdp.terminal_reward, (0, None))(states, goal)
        return beta * terminal, jax.vmap(mdp.terminated, (0, None))(states, goal)

    @jax.jit
    def rewards(states: Array, next_states: Array, goal: Array) -> Array:
        def reward(action: Array, following: Array) -> Array:
            return jax.vmap(mdp.reward, (0, None, 0, None))(states, action, following, goal)

        return beta * jax.vmap(reward)(actions_of(mdp), next_states).reshape(-1)

    states = jnp.asarray(nodes, jnp.float32)
    next_states = jnp.asarray(successors.states).reshape(mdp.num_actions, *nodes.shape)
    columns = [
        (
            *at_states(states, goal),
            *at_states(next_states.reshape(-1, nodes.shape[1]), goal),
            rewards(states, next_states, goal),
        )
        for goal in jnp.asarray(goals, jnp.float32)
    ]
    model = GoalModel(*(np.stack(field, axis=-1) for field in zip(*columns, strict=True)))
    _check_rewards(problem, nodes, goals, model)
    return model


def _check_rewards(
    problem: Problem, nodes: np.ndarray, goals: np.ndarray, model: GoalModel
) -> None:
    """Raise ValueError naming the first reward that is not finite, and where it was returned."""
    mdp = problem.mdp
    for label, value in (("terminal_reward", model.node_terminal), ("reward", model.reward)):
        bad = np.argwhere(~np.isfinite(value))
        if len(bad):
            row, goal = bad[0]
            found = value[row, goal] / problem.beta
            where = f"from state {nodes[row % len(nodes)].tolist()}"
            if label == "reward":
                action = int(row // len(nodes))
                where += f" with action {action}, {np.asarray(mdp.actions)[action].tolist()},"
            raise ValueError(
                f"{type(mdp).__name__}.{label} returned {found:g} {where} "
                f"with goal {goals[goal].tolist()}: the grid solver needs finite rewards "
                "everywhere within the bounds"
            )


def _check_finite(states: np.ndarray, grid: StateGrid, origin: str) -> None:
    bad = np.flatnonzero(~np.isfinite(states).all(axis=1))
    if bad.size:
        node = grid.nodes()[bad[0] % grid.num_nodes]
        raise ValueError(
            f"{origin} returned {states[bad[0]].tolist()} from state {node.tolist()}: expected "
            "finite states everywhere within the bounds"
        )
