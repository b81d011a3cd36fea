"""Define the car of the paper, section V: a unicycle that swerves on a straight track.

    x' = v sin(psi),   y' = v cos(psi),   psi' = turn rate,   v' = acceleration,

with x [m] across and y [m] along the track, the heading psi [rad], 0 along the track, and the speed
v [m/s].

    r = -(100 |x| + 0.05 |y - 8.5|) dt,   r_T = 100 past the goal line, -100 off the track.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from swerve.base.space import TWO_PI, Task
from swerve.hypotheses.grid import grid
from swerve.problem.mdp import MDP, rk4
from swerve.problem.problem import Problem

GOAL_LINE = 8.5  # m: y of the line that ends the task
TRACK = (-0.8, 0.2)  # m: x of the edges of the track
NUM_LANES, NUM_ROWS = 2, 14
TURN_RATES = (-0.5, 0.0, 0.5)  # rad/s
ACCELERATIONS = (-1.0, 0.0, 1.0)  # m/s2
CENTRE_WEIGHT, PROGRESS_WEIGHT, END_REWARD = 100.0, 0.05, 100.0
START_SPREAD = (0.1, 0.1, 0.1, 0.3)  # m, m, rad, m/s: half widths of starts around (0, 0, 0, 1)


class Car(MDP):
    """A car with state (x, y, heading, speed) whose task is to cross the goal line y = 8.5 m.

    The goal line is the same for all starts, so a goal has no components.

    Attributes:
      dt: duration of a step [s].
      num_steps: T, the largest number of steps.
    """

    dt: float = eqx.field(default=0.05, static=True)
    num_steps: int = eqx.field(default=500, static=True)
    state_names = ("x", "y", "heading", "speed")
    action_names = ("turn_rate", "acceleration")
    goal_names = ()
    angles = ("heading",)
    bounds = ((-1.0, 0.4), (-1.0, 9.0), (0.0, TWO_PI), (-1.0, 4.0))

    @property
    def actions(self) -> Float[Array, "9 2"]:
        """Every turn rate [rad/s] with every acceleration [m/s2]."""
        turn, push = jnp.meshgrid(jnp.array(TURN_RATES), jnp.array(ACCELERATIONS), indexing="ij")
        return jnp.stack([turn.ravel(), push.ravel()], axis=1)

    def dynamics(self, state: Float[Array, "4"], action: Float[Array, "2"]) -> Float[Array, "4"]:
        """Return the state one Runge-Kutta step later."""

        def derivative(state: Array) -> Array:
            _, _, heading, speed = state
            along = jnp.stack([jnp.sin(heading), jnp.cos(heading)])
            return jnp.concatenate([speed * along, action])

        return rk4(derivative, state, self.dt)

    def reward(
        self,
        state: Float[Array, "4"],
        action: Float[Array, "2"],
        next_state: Float[Array, "4"],
        goal: Float[Array, "0"],
    ) -> Float[Array, ""]:
        """Return -(100 |x| + 0.05 |y - 8.5|) dt."""
        off, short = jnp.abs(state[0]), jnp.abs(state[1] - GOAL_LINE)
        return -(CENTRE_WEIGHT * off + PROGRESS_WEIGHT * short) * self.dt

    def terminal_reward(
        self, state: Float[Array, "4"], goal: Float[Array, "0"]
    ) -> Float[Array, ""]:
        """Return 100 past the goal line, -100 off the track."""
        arrived = jnp.where(state[1] >= GOAL_LINE, END_REWARD, 0.0)
        return jnp.where(_is_off(state), -END_REWARD, arrived)

    def terminated(self, state: Float[Array, "4"], goal: Float[Array, "0"]) -> Bool[Array, ""]:
        """Return whether the car has crossed the line or left the track."""
        return _is_off(state) | (state[1] >= GOAL_LINE)

    def features(
        self, state: Float[Array, "4"], step: Int[Array, ""], goal: Float[Array, "0"]
    ) -> Float[Array, "13"]:
        """Return smooth features, among them the distances to the edges and the time left."""
        x, y, heading, speed = state
        to_go = (self.num_steps - jnp.asarray(step, jnp.float32)) * self.dt
        drift = speed * jnp.sin(heading)
        left, right = x - TRACK[0], TRACK[1] - x
        return jnp.stack(
            [
                *(x / 0.4, jnp.abs(x) / 0.2, jnp.tanh(x / 0.05)),
                *(y / 4.0 - 1.0, jnp.exp(-jnp.abs(GOAL_LINE - y))),
                *(jnp.sin(heading), jnp.cos(heading), speed - 1.0, drift),
                *(jnp.tanh(left / 0.1), jnp.tanh(right / 0.1)),
                *(to_go / 12.0 - 1.0, jnp.exp(-to_go / 2.0)),
            ]
        )

    def goal_of(self, states: np.ndarray) -> np.ndarray:
        """Return the goal [0] of a finished demonstration: it has no components."""
        return states[-1, :0]

    def sample_state(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        """Sample a state on the track with a heading within 0.8 rad of the track's direction."""
        low = jnp.array([TRACK[0], -0.5, -0.8, 0.0])
        high = jnp.array([TRACK[1], GOAL_LINE, 0.8, 3.0])
        return jax.random.uniform(key, (4,), jnp.float32, low, high)

    def sample_task(self, key: Key[Array, ""]) -> Task:
        """Sample a start near (0, 0) at about 1 m/s along the track."""
        middle, half = jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.array(START_SPREAD)
        start = middle + jax.random.uniform(key, (4,), jnp.float32, -half, half)
        return Task(start, jnp.zeros(0))


def _is_off(state: Float[Array, "4"]) -> Bool[Array, ""]:
    return (state[0] < TRACK[0]) | (state[0] > TRACK[1])


def car(beta: float = 0.3, measure: str = "uniform", between_states: bool = True) -> Problem:
    """Return the car with the paper's 2 x 14 regions of the track as hypotheses.

    Args:
      beta: inverse temperature of the demonstrator; 200 in the paper.
      measure: "uniform" or "counting"; with "counting" no car would arrive.
      between_states: whether crossing a region between two states counts as entering it.
    """
    cells = grid(x=(*TRACK, NUM_LANES), y=(0.0, GOAL_LINE, NUM_ROWS))
    return Problem(Car(), cells, beta=beta, measure=measure, between_states=between_states)
