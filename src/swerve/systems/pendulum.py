"""Define the torque-controlled pendulum of the paper, section IV.

    theta'' = (g / l) sin(theta) + u,    g / l = 1,

theta = 0 upright, theta = pi hanging. The reward is for being at the goal after 5 s with little
torque, r_T = -80 |s_T - goal|^2 (the angle's difference wrapped) and r = -0.05 u^2 dt.
"""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from swerve.base.space import TWO_PI, Task
from swerve.hypotheses.grid import grid
from swerve.problem.mdp import MDP, rk4
from swerve.problem.problem import Problem

TERMINAL_WEIGHT = 80.0
TORQUE_WEIGHT = 0.05
MAX_START_SPEED = 2.0  # rad/s: largest speed of starts and goals of tasks
MAX_SPEED = 6.0  # rad/s: largest speed of exploring starts


class Pendulum(MDP):
    """A pendulum with state (theta [rad], omega [rad/s]) and normalised torque u.

    Attributes:
      max_torque: largest torque; the torques are evenly spaced on [-max_torque, max_torque]. The
        paper states 1; the demonstrations of its authors need 10.
      num_torques: A, the number of torques.
      dt: duration of a step [s].
      num_steps: T.
    """

    max_torque: float = 1.0
    num_torques: int = eqx.field(default=5, static=True)
    dt: float = eqx.field(default=1.0 / 60.0, static=True)
    num_steps: int = eqx.field(default=300, static=True)
    state_names = ("theta", "omega")
    action_names = ("torque",)
    angles = ("theta",)
    bounds = ((0.0, TWO_PI), (-8.0, 8.0))

    @property
    def actions(self) -> Float[Array, "A 1"]:
        """The torques."""
        return self.max_torque * jnp.linspace(-1.0, 1.0, self.num_torques)[:, None]

    def dynamics(self, state: Float[Array, "2"], action: Float[Array, "1"]) -> Float[Array, "2"]:
        """Return the state one Runge-Kutta step later."""

        def derivative(state: Array) -> Array:
            return jnp.stack([state[1], jnp.sin(state[0]) + action[0]])

        return rk4(derivative, state, self.dt)

    def reward(
        self,
        state: Float[Array, "2"],
        action: Float[Array, "1"],
        next_state: Float[Array, "2"],
        goal: Float[Array, "2"],
    ) -> Float[Array, ""]:
        """Return -0.05 u^2 dt."""
        return -TORQUE_WEIGHT * action[0] ** 2 * self.dt

    def terminal_reward(
        self, state: Float[Array, "2"], goal: Float[Array, "2"]
    ) -> Float[Array, ""]:
        """Return -80 |s - goal|^2, the angle's difference along the shorter arc."""
        return -TERMINAL_WEIGHT * jnp.sum(self.space.difference(state, goal) ** 2)

    def features(
        self, state: Float[Array, "2"], step: Int[Array, ""], goal: Float[Array, "2"]
    ) -> Float[Array, "20"]:
        """Return smooth features, among them the accelerations needed to still reach the goal.

        `miss` is the difference between the goal and the angle after coasting to the end. `turn`
        and `gain` are the accelerations, in units of the largest torque, that would close this
        difference and the difference in speed.
        """
        to_go = (self.num_steps - jnp.asarray(step, jnp.float32)) * self.dt
        angle, gap = goal[0] - state[0], goal[1] - state[1]
        miss = angle - to_go * state[1]
        soon = to_go + 0.1
        turn = jnp.sin(miss) / soon**2 / self.max_torque
        gain = gap / soon / self.max_torque
        return jnp.stack(
            [
                *(jnp.sin(state[0]), jnp.cos(state[0]), state[1] / 4.0),
                *(jnp.sin(goal[0]), jnp.cos(goal[0]), goal[1] / 2.0),
                *(jnp.sin(angle), jnp.cos(angle), gap / 4.0),
                *(jnp.sin(miss), jnp.cos(miss)),
                *(to_go / 2.5 - 1.0, jnp.log(soon)),
                *(jnp.exp(-to_go / 0.2), jnp.exp(-to_go / 0.8)),
                *(jnp.tanh(turn / 0.3), jnp.tanh(turn / 1.5)),
                *(jnp.tanh(gain / 0.3), jnp.tanh(gain / 1.5)),
                jnp.tanh(6.0 * turn - 2.0 * gain),
            ]
        )

    def sample_state(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        """Sample a state with any angle and at most 6 rad/s."""
        low, high = jnp.array([0.0, -MAX_SPEED]), jnp.array([TWO_PI, MAX_SPEED])
        return jax.random.uniform(key, (2,), jnp.float32, low, high)

    def sample_task(self, key: Key[Array, ""]) -> Task:
        """Sample start and goal with any angle and at most 2 rad/s."""
        low, high = jnp.array([0.0, -MAX_START_SPEED]), jnp.array([TWO_PI, MAX_START_SPEED])
        start, goal = jax.random.uniform(key, (2, 2), jnp.float32, low, high)
        return Task(start, goal)


def pendulum(
    max_torque: float = 1.0,
    beta: float = 0.67,
    measure: str = "uniform",
    between_states: bool = True,
) -> Problem:
    """Return the pendulum with the paper's 10 x 10 cells of theta and omega as hypotheses.

    Args:
      max_torque: torques are -1, -1/2, 0, 1/2 and 1 times this number.
      beta: inverse temperature of the demonstrator.
      measure: "uniform" or "counting"; both give the same here, since all episodes have 300 steps.
      between_states: whether crossing a cell between two states counts as entering it.
    """
    if not (math.isfinite(max_torque) and max_torque > 0):
        raise ValueError(f"pendulum: expected max_torque > 0, got {max_torque}")
    cells = grid(theta=(0.0, TWO_PI, 10), omega=(-6.0, 6.0, 10))
    return Problem(
        Pendulum(max_torque), cells, beta=beta, measure=measure, between_states=between_states
    )
