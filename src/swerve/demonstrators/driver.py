"""Human-like drivers of the car: a model of people, not of the reward.

A driver steers towards a point of the lane that lies `preview` seconds ahead, acts on the state
of `reaction_time` ago, and corrects the course every `hold` seconds, with noise:

    turn = gain (atan2(x_aim - x, preview v) - heading),   executed (1 + noise e) turn + noise e',

e and e' standard normal. An obstacle comes into view at the distance `sight`. The driver then
brakes, begins to steer when `steering_time` is left, passes with some clearance, goes back to the
lane and speeds up again. A driver who is near the obstacle and not yet clear of it brakes hard.
Each driver has parameters of its own. A drive that hits the obstacle is repeated with new noise; a
drive that leaves the track ends there and is kept.

Lengths in m, times in s, angles in rad.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import instance, seed_number, whole_number
from swerve.base.space import Task
from swerve.constraints.base import violates
from swerve.constraints.boxes import Box
from swerve.demonstrations.demonstration import Demonstration
from swerve.systems.car import ACCELERATIONS, TRACK, TURN_RATES, Car

Step = Callable[[jax.Array, jax.Array], jax.Array]  # dynamics
TURN_GAIN = 2.5  # rad/s of turn rate per rad of heading error
SPEED_GAIN = 2.0  # m/s2 of acceleration per m/s of speed error
CREEP = 0.3  # m/s: speed to brake to when the obstacle is near and the way is not clear
TIGHT = 0.8  # s to the obstacle: a driver who is not clear of it by then brakes hard
START = (0.0, 0.0, 0.0, 1.0)  # m, m, rad, m/s: in the lane, along it
FAST = 1.2  # times the speed past the obstacle: a faster driver brakes before steering
LAST = 1.3  # m to the obstacle: nearer than this, a driver steers at any speed
MOST_TRIES = 50  # drives that hit the obstacle before it counts as impossible to pass
LEAST_PREVIEW = 0.25  # m: least distance of the point that is steered to
LEAST_GAP = 0.25  # m: least width of track beside the obstacle, for a driver to pass


@dataclass(frozen=True)
class Driver:
    """Parameters of one driver.

    Attributes:
      lane: x to keep to where nothing is in the way [m].
      speed: speed where nothing is in the way [m/s].
      slow: speed past the obstacle [m/s].
      sight: distance at which an obstacle is seen [m].
      reaction_time: age of the state that the driver acts on [s].
      hold: time between two corrections [s].
      preview: time ahead of the point that is steered to [s].
      steering_time: time to the obstacle at which steering begins [s].
      clearance: distance to keep from the obstacle's side [m].
      past: distance beyond the obstacle before going back to the lane [m].
      noise: standard deviation of each part of the noise: one is relative to the correction, the
        other to a tenth of the largest correction.
    """

    lane: float
    speed: float
    slow: float
    sight: float
    reaction_time: float
    hold: float
    preview: float
    steering_time: float
    clearance: float
    past: float
    noise: float


def random_driver(generator: np.random.Generator) -> Driver:
    """Return a driver with random parameters."""
    return Driver(
        lane=generator.normal(0.0, 0.02),
        speed=generator.uniform(0.9, 1.4),
        slow=generator.uniform(0.45, 0.75),
        sight=generator.uniform(2.5, 4.0),
        reaction_time=generator.uniform(0.2, 0.4),
        hold=generator.uniform(0.1, 0.3),
        preview=generator.uniform(0.7, 1.0),
        steering_time=generator.uniform(2.2, 3.2),
        clearance=generator.uniform(0.08, 0.2),
        past=generator.uniform(0.0, 0.3),
        noise=generator.uniform(0.1, 0.3),
    )


def drives(
    mdp: Car, obstacle: Box | None = None, num: int = 50, *, seed: int = 0
) -> list[Demonstration]:
    """Return drives along the track from START, each by another driver.

    Args:
      mdp: the car.
      obstacle: a box in x and y on the track; None for a free track.
      num: number of drives.
      seed: seed of the drivers and their noise.

    Returns:
      Demonstrations drive_00 and so on with times and actions (turn rates and accelerations within
      the car's limits), until the goal line, the edge of the track or the horizon is reached. No
      drive enters the obstacle.

    Raises:
      ValueError: if the obstacle is not a box in x and y, leaves no way past, or a driver hits it
        again and again.
    """
    instance(mdp, Car, "mdp", "drivers drive swerve.Car()")
    num, seed = whole_number(num, "num", 1), seed_number(seed)
    if obstacle is not None:
        _check_obstacle(obstacle)
    step, task = jax.jit(mdp.dynamics), Task(np.array(START), np.zeros(0))
    found = []
    for k in range(num):
        generator = np.random.default_rng([seed, k])
        states, actions = _safely(mdp, step, random_driver(generator), obstacle, generator)
        times = np.arange(len(states)) * mdp.dt
        name = f"drive_{k:0{len(str(num - 1))}d}"
        found.append(Demonstration(name, states, task, times=times, actions=actions))
    return found


def _check_obstacle(obstacle: Box) -> None:
    """Raise ValueError unless an obstacle is a box in x and y that leaves a way past."""
    if not isinstance(obstacle, Box) or set(obstacle.intervals) != {"x", "y"}:
        raise ValueError(
            f"obstacle: expected a box in x and y, as in swerve.Box(x=(-0.3, 0.2), y=(6.7, 7.4)), "
            f"got {getattr(obstacle, 'name', obstacle)}"
        )
    low, high = obstacle.intervals["x"]
    if max(low - TRACK[0], TRACK[1] - high) < LEAST_GAP:
        raise ValueError(
            f"obstacle: expected {LEAST_GAP} m of the track, {TRACK[0]} to {TRACK[1]} m, "
            f"left beside it, got {obstacle.name}: make it narrower"
        )


def _safely(
    mdp: Car, step: Step, driver: Driver, obstacle: Box | None, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return a drive that does not enter the obstacle."""
    for _ in range(MOST_TRIES):
        states, actions = _drive(mdp, step, driver, obstacle, generator)
        if obstacle is None or not violates(obstacle, states, mdp.space, True):
            return states, actions
    assert obstacle is not None
    raise ValueError(
        f"obstacle: expected one that drivers from {list(START)} can pass, got {obstacle.name}, "
        f"which one driver hit {MOST_TRIES} times: move it further along the track"
    )


def _drive(
    mdp: Car,
    step: Step,
    driver: Driver,
    obstacle: Box | None,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states [L, 4] and actions [L-1, 2] of one drive."""
    late = max(1, round(driver.reaction_time / mdp.dt))
    every = max(1, round(driver.hold / mdp.dt))
    states, actions = [np.array(START)], []
    seen = deque(states * (late + 1), maxlen=late + 1)
    limits = np.array([TURN_RATES[-1], ACCELERATIONS[-1]])
    action = np.zeros(2)
    for t in range(mdp.num_steps):
        if t % every == 0:
            meant = np.clip(_meant(driver, obstacle, seen[0]), -limits, limits)
            share, more = driver.noise * generator.normal(size=(2, 2))
            action = np.clip(meant * (1.0 + share) + 0.1 * limits * more, -limits, limits)
        actions.append(action)
        taken = (jnp.asarray(x, jnp.float32) for x in (states[-1], action))
        states.append(np.asarray(step(*taken), float))
        seen.append(states[-1])
        if bool(mdp.terminated(jnp.asarray(states[-1], jnp.float32), jnp.zeros(0, jnp.float32))):
            break
    return np.stack(states), np.stack(actions)


def _meant(driver: Driver, obstacle: Box | None, state: np.ndarray) -> np.ndarray:
    """Return the turn rate and acceleration that a driver means to take in a state."""
    aim, speed = driver.lane, driver.speed
    if obstacle is not None:
        aim, speed = _around(driver, obstacle, state)
    x, _, heading, now = state
    heading = (heading + math.pi) % (2.0 * math.pi) - math.pi
    towards = math.atan2(aim - x, max(driver.preview * now, LEAST_PREVIEW))
    return np.array([TURN_GAIN * (towards - heading), SPEED_GAIN * (speed - now)])


def _around(driver: Driver, obstacle: Box, state: np.ndarray) -> tuple[float, float]:
    """Return the x to aim for and the speed to have, with an obstacle on the track."""
    x, y, _, now = state
    (low, high), (front, back) = obstacle.intervals["x"], obstacle.intervals["y"]
    to_go = front - y
    if to_go > driver.sight or y > back + driver.past:
        return driver.lane, driver.speed
    is_left = low - TRACK[0] > TRACK[1] - high
    aim = low - driver.clearance if is_left else high + driver.clearance
    is_fast = now > FAST * driver.slow and to_go > LAST
    if is_fast or to_go > driver.steering_time * max(now, CREEP):
        return driver.lane, driver.slow
    is_clear = x < low if is_left else x > high
    is_tight = to_go < TIGHT * max(now, CREEP) and not is_clear
    return aim, CREEP if is_tight else driver.slow
