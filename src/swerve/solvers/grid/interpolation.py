"""Interpolation on a regular grid of states: cubic where the values are smooth, else linear.

The value at a point is a weighted sum over the 4 nearest nodes along each axis,

    V(x) = sum_k w_k(x) V(node_k),    w = product over axes of Lagrange weights,

so that interpolating at fixed points is one sparse matrix. Where the cubic and the linear value
differ by more than a tolerance there is a cliff, near which a cubic overshoots. In a recursion that
prefers high values the overshoot would grow without bound. So the linear value is taken there: it
cannot overshoot. Angles are periodic; on other axes, points beyond the outermost nodes are moved
onto these nodes.

Shapes: n state dimensions, S nodes in all, K = 4^n nodes a stencil.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from swerve.base.space import StateSpace

STENCIL = 4  # nodes of a cubic along one axis
SMOOTH = 1.0  # nats: where the cubic and the linear value differ by more, there is a cliff


class Stencil(NamedTuple):
    """Nodes and weights that interpolate at one point, over all axes or along one.

    Attributes:
      nodes: [K] indices of nodes.
      weights: [K] weights of the nodes, which sum to 1.
    """

    nodes: Int[Array, " K"]
    weights: Float[Array, " K"]


class StateGrid:
    """A regular grid of nodes over the bounds of a state space; angles go all the way round.

    Args:
      space: names, angles and bounds of the states.
      num_points: nodes along each of the n axes, at least 4.
    """

    def __init__(self, space: StateSpace, num_points: tuple[int, ...]) -> None:
        if len(num_points) != len(space.names) or min(num_points) < STENCIL:
            raise ValueError(
                f"num_points: expected at least {STENCIL} nodes for each of the states "
                f"{', '.join(space.names)}, got {num_points}"
            )
        self.num_points = tuple(num_points)
        self.periodic = tuple(bool(angle) for angle in space.is_angle)
        self.low = tuple(
            0.0 if angle else float(low)
            for angle, (low, _) in zip(self.periodic, space.bounds, strict=True)
        )
        self.spacing = tuple(
            2.0 * math.pi / points if angle else float(high - low) / (points - 1)
            for angle, points, (low, high) in zip(
                self.periodic, num_points, space.bounds, strict=True
            )
        )

    @property
    def num_nodes(self) -> int:
        """S, the number of nodes."""
        return math.prod(self.num_points)

    def nodes(self) -> np.ndarray:
        """Return the nodes [S, n], the last state varying fastest."""
        axes = [
            low + spacing * np.arange(points)
            for low, spacing, points in zip(self.low, self.spacing, self.num_points, strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(self.num_nodes, -1)

    def cubic(self, state: Float[Array, " n"]) -> Stencil:
        """Return the 4^n nodes around a state and their weights for cubic interpolation."""
        return self._product([Stencil(near, _cubic_weights(x)) for near, x in self._axes(state)])

    def linear(self, state: Float[Array, " n"]) -> Stencil:
        """Return the 2^n nodes around a state and their weights for linear interpolation."""
        axes = []
        for k, points in enumerate(self.num_points):
            position, last = self._position(state, k), points if self.periodic[k] else points - 1
            below = jnp.clip(jnp.floor(position), 0, last - 1)
            near = below.astype(jnp.int32) + jnp.arange(2, dtype=jnp.int32)
            x = position - below
            axes.append(Stencil(jnp.where(near < points, near, 0), jnp.stack([1.0 - x, x])))
        return self._product(axes)

    def interpolate(
        self, values: Float[Array, " S"], state: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """Return the value at one state from values at the nodes, summing axis by axis."""
        axes = self._axes(state)
        nodes = jnp.zeros((), jnp.int32)
        for points, (near, _) in zip(self.num_points, axes, strict=True):
            nodes = nodes[..., None] * points + near
        cubic = linear = values[nodes]
        for _, x in reversed(axes):
            cubic = jnp.sum(cubic * _cubic_weights(x), axis=-1)
            linear = jnp.sum(linear * _linear_weights(x), axis=-1)
        return choose_smooth(jnp, cubic, linear)

    def _product(self, axes: list[Stencil]) -> Stencil:
        nodes, weights = jnp.zeros(1, jnp.int32), jnp.ones(1, jnp.float32)
        for points, axis in zip(self.num_points, axes, strict=True):
            nodes = (nodes[:, None] * points + axis.nodes).reshape(-1)
            weights = (weights[:, None] * axis.weights).reshape(-1)
        return Stencil(nodes, weights)

    def _axes(self, state: Float[Array, " n"]) -> list[tuple[Int[Array, "4"], Float[Array, ""]]]:
        """Return for each axis 4 nodes, by their number on the axis, and the place of the state.

        The place is measured so that the 4 nodes lie at -1, 0, 1 and 2.
        """
        axes = []
        for k, points in enumerate(self.num_points):
            position = self._position(state, k)
            below = jnp.floor(position)
            if not self.periodic[k]:
                below = jnp.clip(below, 1.0, points - 3.0)
            near = below.astype(jnp.int32) + jnp.arange(-1, 3, dtype=jnp.int32)
            near = jnp.where(near < 0, near + points, jnp.where(near < points, near, near - points))
            axes.append((near, position - below))
        return axes

    def _position(self, state: Float[Array, " n"], axis: int) -> Float[Array, ""]:
        """Return where a state lies along an axis, in nodes from the first node."""
        points = self.num_points[axis]
        position = (state[axis] - self.low[axis]) / self.spacing[axis]
        if self.periodic[axis]:
            return position - points * jnp.floor(position / points)  # floor is vectorised, % is not
        return jnp.clip(position, 0.0, points - 1.0)


def choose_smooth(xp: Any, cubic: Any, linear: Any) -> Any:
    """Return the cubic value, or the linear value where the two are far apart."""
    return xp.where(abs(cubic - linear) > SMOOTH, linear, cubic)


def _cubic_weights(x: Float[Array, ""]) -> Float[Array, "4"]:
    """Return the cubic Lagrange weights at x of nodes at -1, 0, 1, 2."""
    return jnp.stack(
        [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ]
    )


def _linear_weights(x: Float[Array, ""]) -> Float[Array, "4"]:
    """Return the linear weights at x of nodes at -1, 0, 1, 2."""
    return jnp.maximum(0.0, 1.0 - jnp.abs(x - jnp.arange(-1.0, 3.0, dtype=jnp.float32)))
