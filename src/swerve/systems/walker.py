"""Define people who walk to a goal, by soft shortest paths over the floor of a room.

    s' = s + a,   r(s, a) = -|a|,   r_T = 0 within reach of the goal, -inf elsewhere,

s = (x, y) [m] is the position and a is one of 16 displacements on a square lattice, the moves of a
king and of a knight in chess: 16 headings, 18 to 27 degrees apart. So R is minus the distance
walked.

The number of steps is free. With the counting measure each step multiplies the number of walks, so
the weights of the walks of all lengths have a finite sum only where

    sum_a exp(-beta |a|) < 1.

For beta near this limit, people make the longest detours with which they still arrive. For a far
larger beta, people take the shortest way.
"""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from swerve.base.arguments import positive_number
from swerve.problem.mdp import MDP

KING_AND_KNIGHT = tuple((i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1)
SPEED = 1.2  # m/s, a usual walking speed
NUM_HALVINGS = 60  # halvings of the interval around the least beta: to the last digit of a float64


def _bounds(bounds: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    return tuple((float(low), float(high)) for low, high in bounds)


class Walker(MDP):
    """A person who walks over a floor to a goal, a position (x, y) [m].

    The MDP contains no walls: give walls as known constraints (see `Occupancy`).

    Attributes:
      bounds: [2, 2] bounds of x and y [m].
      spacing: distance between neighbours on the lattice of positions [m].
      reach: distance to the goal [m] within which the walker has arrived.
      num_steps: T, the largest number of steps.
    """

    bounds: tuple[tuple[float, float], ...] = eqx.field(
        static=True, default=((-5.0, 5.0), (-5.0, 5.0)), converter=_bounds
    )
    spacing: float = eqx.field(static=True, default=0.25)
    reach: float = eqx.field(static=True, default=0.3)
    num_steps: int = eqx.field(static=True, default=1000)

    is_timed = False  # people take their time, and the moves differ in length
    state_names = ("x", "y")
    action_names = ("dx", "dy")

    def __check_init__(self) -> None:
        """Raise ValueError where a length is not a positive number."""
        for name in ("spacing", "reach"):
            positive_number(getattr(self, name), f"Walker: {name}")

    @property
    def dt(self) -> float:
        """Duration [s] of a step at walking speed, on average over the actions."""
        return float(np.linalg.norm(KING_AND_KNIGHT, axis=1).mean()) * self.spacing / SPEED

    @property
    def actions(self) -> Float[Array, "16 2"]:
        """The displacements [m]."""
        return self.spacing * jnp.array(KING_AND_KNIGHT, jnp.float32)

    @property
    def num_cells(self) -> tuple[int, int]:
        """Numbers of cells along x and y; the centres of the cells are the lattice points."""
        x, y = (max(1, round((high - low) / self.spacing)) for low, high in self.bounds)
        return x, y

    @property
    def least_beta(self) -> float:
        """The beta [nats/m] above which the weights of walks of all lengths have a finite sum."""
        lengths = self.spacing * np.linalg.norm(KING_AND_KNIGHT, axis=1)
        low, high = 0.0, math.log(len(lengths)) / self.spacing
        for _ in range(NUM_HALVINGS):
            middle = 0.5 * (low + high)
            is_finite = np.exp(-middle * lengths).sum() < 1.0
            low, high = (low, middle) if is_finite else (middle, high)
        return high

    def dynamics(self, state: Float[Array, "2"], action: Float[Array, "2"]) -> Float[Array, "2"]:
        """Return the position one step later."""
        return state + action

    def reward(
        self,
        state: Float[Array, "2"],
        action: Float[Array, "2"],
        next_state: Float[Array, "2"],
        goal: Float[Array, "2"],
    ) -> Float[Array, ""]:
        """Return minus the length of the step [m]."""
        return -jnp.linalg.norm(action)

    def terminal_reward(
        self, state: Float[Array, "2"], goal: Float[Array, "2"]
    ) -> Float[Array, ""]:
        """Return -inf where the goal was not reached."""
        return jnp.where(self.terminated(state, goal), 0.0, -jnp.inf)

    def terminated(self, state: Float[Array, "2"], goal: Float[Array, "2"]) -> Bool[Array, ""]:
        """Return whether the goal is within reach."""
        return jnp.linalg.norm(state - goal) < self.reach
