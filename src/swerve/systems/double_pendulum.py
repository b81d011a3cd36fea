"""Define a double pendulum with a torque at its first joint.

Two massless rods of length 1 have unit masses at their ends. Both angles, theta_1 and theta_2, are
measured from the downward vertical, and g = 1:

    2 theta_1'' + cos(d) theta_2'' = u - sin(d) omega_2^2 - 2 sin(theta_1),
    cos(d) theta_1'' + theta_2''   =     sin(d) omega_1^2 -   sin(theta_2),

with d = theta_1 - theta_2.

The reward is for being at the goal after 3 s with little torque.
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

TERMINAL_WEIGHT = 10.0
TORQUE_WEIGHT = 0.5
FREQUENCIES = tuple(math.sqrt(2.0 + sign * math.sqrt(2.0)) for sign in (-1.0, 1.0))  # rad/s
NEAR = (1.0, 1.0, 1.0, 1.0)  # rad, rad, rad/s, rad/s: half widths of starts and goals around 0
REACH = (1.8, 1.8, 2.5, 2.5)  # rad, rad, rad/s, rad/s: half widths of exploring starts around 0


class DoublePendulum(MDP):
    """A double pendulum with state (theta_1, theta_2 [rad], omega_1, omega_2 [rad/s]).

    Attributes:
      max_torque: largest torque; the torques are evenly spaced on [-max_torque, max_torque].
      num_torques: A, the number of torques.
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

    def features(
        self, state: Float[Array, "4"], step: Int[Array, ""], goal: Float[Array, "4"]
    ) -> Float[Array, "32"]:
        """Return the default features, and the distance to the goal after coasting to the end.

        Small swings are the sum of two modes, in phase and in opposition, each a rotation of
        (q, q' / w). The differences of both modes to the goal are features. The same differences,
        divided by the time left and bounded by tanh at two scales, are features too.
        """
        to_go = (self.num_steps - jnp.asarray(step, jnp.float32)) * self.dt
        miss = _modes(goal) - _coasted(_modes(state), to_go)
        gain = miss / (to_go + 0.1) / self.max_torque
        return jnp.concatenate(
            [
                super().features(state, step, goal),
                *(miss, jnp.tanh(gain / 0.3), jnp.tanh(gain / 1.5)),
                jnp.stack([jnp.exp(-to_go / 0.2), jnp.exp(-to_go / 0.8)]),
            ]
        )

    def sample_state(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        """Sample a state within 1.8 rad and 2.5 rad/s of hanging at rest, wider than tasks."""
        half = jnp.array(REACH)
        return jax.random.uniform(key, (4,), jnp.float32, -half, half)

    def sample_task(self, key: Key[Array, ""]) -> Task:
        """Sample start and goal within 1 rad and 1 rad/s of hanging at rest."""
        half = jnp.array(NEAR)
        start, goal = jax.random.uniform(key, (2, 4), jnp.float32, -half, half)
        return Task(start, goal)


def _modes(state: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return (q, q' / w) of the two modes of small swings, theta_2 = +-sqrt(2) theta_1."""
    angles = (state[:2] + math.pi) % TWO_PI - math.pi
    both = jnp.stack([angles[0], state[2]]), jnp.stack([angles[1], state[3]]) / math.sqrt(2.0)
    scale = [jnp.array([1.0, 1.0 / frequency], jnp.float32) for frequency in FREQUENCIES]
    return 0.5 * jnp.concatenate([(both[0] + both[1]) * scale[0], (both[0] - both[1]) * scale[1]])


def _coasted(modes: Float[Array, "4"], duration: Float[Array, ""]) -> Float[Array, "4"]:
    """Return the modes after a duration [s] without a torque."""
    parts = []
    for k, frequency in enumerate(FREQUENCIES):
        place, speed = modes[2 * k], modes[2 * k + 1]
        sine, cosine = jnp.sin(frequency * duration), jnp.cos(frequency * duration)
        parts += [cosine * place + sine * speed, cosine * speed - sine * place]
    return jnp.stack(parts)


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
      max_torque: torques are -1, -1/2, 0, 1/2 and 1 times this number.
      beta: inverse temperature of the demonstrator.
      measure: "uniform" or "counting"; both give the same here, since all episodes have 100 steps.
      between_states: whether crossing a cell between two states counts as entering it.
    """
    cells = grid(theta_1=(-1.5, 1.5, 10), theta_2=(-1.5, 1.5, 10))
    mdp = DoublePendulum(max_torque)
    return Problem(mdp, cells, beta=beta, measure=measure, between_states=between_states)
