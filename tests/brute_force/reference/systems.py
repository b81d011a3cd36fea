"""The systems that ship, by their published formulas, in double precision.

Shapes: n state dimensions, S cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from brute_force.reference.geometry import TURN, wrapped

Derivative = Callable[[np.ndarray], np.ndarray]


def integrated(derivative: Derivative, state: np.ndarray, duration: float) -> np.ndarray:
    """Return the state [n] after a duration, by the classical Runge-Kutta method."""
    k1 = derivative(state)
    k2 = derivative(state + duration / 2 * k1)
    k3 = derivative(state + duration / 2 * k2)
    k4 = derivative(state + duration * k3)
    return state + duration * (k1 / 6 + k2 / 3 + k3 / 3 + k4 / 6)


def exactly_integrated(derivative: Derivative, state: np.ndarray, duration: float) -> np.ndarray:
    """Return the state [n] after a duration, in a hundred Runge-Kutta steps."""
    for _ in range(100):
        state = integrated(derivative, state, duration / 100)
    return state


def pendulum(state: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Return (theta', omega')."""
    return np.array([state[1], math.sin(state[0]) + action[0]])


def double_pendulum(state: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Return the derivative by solving the two equations of motion."""
    first, second, speed, other = state
    apart = first - second
    mass = np.array([[2.0, math.cos(apart)], [math.cos(apart), 1.0]])
    force = np.array(
        [
            action[0] - math.sin(apart) * other**2 - 2.0 * math.sin(first),
            math.sin(apart) * speed**2 - math.sin(second),
        ]
    )
    return np.concatenate([[speed, other], np.linalg.solve(mass, force)])


def car(state: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Return the derivative of a unicycle."""
    _, _, heading, speed = state
    return np.array([speed * math.sin(heading), speed * math.cos(heading), *action])


def pendulum_reward(action: np.ndarray, dt: float) -> float:
    """Return -0.05 u^2 dt."""
    return -0.05 * action[0] ** 2 * dt


def pendulum_end(state: np.ndarray, goal: np.ndarray) -> float:
    """Return -80 |s - goal|^2."""
    angle, speed = state - goal
    return -80.0 * (float(wrapped(np.array(angle))) ** 2 + speed**2)


def double_pendulum_end(state: np.ndarray, goal: np.ndarray) -> float:
    """Return -10 |s - goal|^2."""
    away = state - goal
    away[:2] = wrapped(away[:2])
    return -10.0 * float(away @ away)


def car_reward(state: np.ndarray, dt: float) -> float:
    """Return -(100 |x| + 0.05 |y - 8.5|) dt."""
    return -(100.0 * abs(state[0]) + 0.05 * abs(state[1] - 8.5)) * dt


def car_end(state: np.ndarray) -> tuple[bool, float]:
    """Return whether the episode is over, and r_T."""
    is_off = state[0] < -0.8 or state[0] > 0.2
    has_arrived = state[1] >= 8.5
    return is_off or has_arrived, -100.0 if is_off else 100.0 if has_arrived else 0.0


MOVES = ((-1, 0), (1, 0), (0, 1), (0, -1), (-1, 1), (1, 1), (-1, -1), (1, -1))


def gridworld(width: int, height: int, walls: set[tuple[int, int]]) -> np.ndarray:
    """Return the successors [S, 8] of the cells; -1 for moves out of the world or into a wall."""
    found = np.full((width * height, len(MOVES)), -1)
    for x in range(width):
        for y in range(height):
            for k, (dx, dy) in enumerate(MOVES):
                to = x + dx, y + dy
                is_inside = 0 <= to[0] < width and 0 <= to[1] < height
                if is_inside and to not in walls and (x, y) not in walls:
                    found[y * width + x, k] = to[1] * width + to[0]
    return found


def shorter_arc(start: float, end: float) -> float:
    """Return the smallest of end - start + 2 pi k, in absolute value."""
    return min((end - start + k * TURN for k in range(-20, 21)), key=abs)
