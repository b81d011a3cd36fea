"""A double pendulum with a torque at its first joint.

Two massless rods of length 1 with unit masses at their ends; theta_1 and theta_2 are measured from
hanging down, both against the vertical, and g = 1:

    2 theta_1'' + cos(d) theta_2'' = u - sin(d) omega_2^2 - 2 sin(theta_1),
    cos(d) theta_1'' + theta_2''   =     sin(d) omega_1^2 -   sin(theta_2),

with d = theta_1 - theta_2.

The reward asks to be at the goal after 3 s with little torque.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from swerve.hypotheses import grid
from swerve.mdp import MDP, rk4
from swerve.problem import Problem
from swerve.space import TWO_PI, Task

TERMINAL_WEIGHT = 10.0
TORQUE_WEIGHT = 0.5
MAX_SPEED = 3.0  # rad/s, of exploring starts
NEAR = (1.0, 1.0, 1.0, 1.0)  # half of the ranges around hanging down of starts and goals


class DoublePendulum(MDP):
    """A double pendulum with state (theta_1, theta_2 [rad], omega_1, omega_2 [rad/s]).

    Attributes:
      max_torque: torques are evenly spaced on [-max_torque, max_torque].
      num_torques: A, how many torques.
      dt: duration of a step [s].
      num_steps: T.
    """

    max_torque: float = 2.0
    num_torques: int = eqx.field(default=5, static=True)
    dt: float = eqx.field(default=0.03, static=True)
    num_steps: int = eqx.field(default=100, static=True)
    state_names = ("theta_1", "theta_2", "omega_1", "omega_2")
    action_names = ("torque",)
    angles = ("theta_1", "theta_2")
    bounds = ((0.0, TWO_PI), (0.0, TWO_PI), (-4.0, 4.0), (-4.0, 4.0))

    @property
    def actions(self) -> Float[Array, "A 1"]:
        """The torques."""
        return self.max_torque * jnp.linspace(-1.0, 1.0, self.num_torques)[:, None]

    def dynamics(self, state: Float[Array, "4"], action: Float[Array, "1"]) -> Float[Array, "4"]:
        """Return the state one Runge-Kutta step later."""
        return rk4(lambda state: _derivative(state, action[0]), state, self.dt)

    def reward(
        self,
        state: Float[Array, "4"],
        action: Float[Array, "1"],
        next_state: Float[Array, "4"],
        goal: Float[Array, "4"],
    ) -> Float[Array, ""]:
        """Return -0.5 u^2 dt."""
        return -TORQUE_WEIGHT * action[0] ** 2 * self.dt

    def terminal_reward(
        self, state: Float[Array, "4"], goal: Float[Array, "4"]
    ) -> Float[Array, ""]:
        """Return -10 |s - goal|^2, the angles' differences along the shorter arc."""
        return -TERMINAL_WEIGHT * jnp.sum(self.space.difference(state, goal) ** 2)

    def sample_state(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        """Draw a state with any angles and at most 3 rad/s."""
        low = jnp.array([0.0, 0.0, -MAX_SPEED, -MAX_SPEED])
        high = jnp.array([TWO_PI, TWO_PI, MAX_SPEED, MAX_SPEED])
        return jax.random.uniform(key, (4,), minval=low, maxval=high)

    def sample_task(self, key: Key[Array, ""]) -> Task:
        """Draw start and goal within 1 rad and 1 rad/s of hanging at rest."""
        half = jnp.array(NEAR)
        start, goal = jax.random.uniform(key, (2, 4), minval=-half, maxval=half)
        return Task(start, goal)


def _derivative(state: Float[Array, "4"], torque: Float[Array, ""]) -> Float[Array, "4"]:
    first, second, speed, other = state
    sine, cosine = jnp.sin(first - second), jnp.cos(first - second)
    push = torque - sine * other**2 - 2.0 * jnp.sin(first)
    pull = sine * speed**2 - jnp.sin(second)
    determinant = 2.0 - cosine**2
    return jnp.stack(
        [
            speed,
            other,
            (push - cosine * pull) / determinant,
            (2.0 * pull - cosine * push) / determinant,
        ]
    )


def double_pendulum(
    max_torque: float = 2.0,
    beta: float = 1.0,
    measure: str = "uniform",
    between_states: bool = True,
) -> Problem:
    """Return the double pendulum with 10 x 10 cells of the two angles as hypotheses.

    Args:
      max_torque: torques are -1, -1/2, 0, 1/2 and 1 times this.
      beta: inverse temperature of the demonstrator.
      measure: "uniform" or "counting"; the same here, since all episodes have 100 steps.
      between_states: whether crossing a cell between two states counts as entering it.
    """
    cells = grid(theta_1=(-1.5, 1.5, 10), theta_2=(-1.5, 1.5, 10))
    mdp = DoublePendulum(max_torque)
    return Problem(mdp, cells, beta=beta, measure=measure, between_states=between_states)
