"""Optimal control by direct transcription: all states and actions of a path are unknowns.

    maximise   sum_t r(s_t, a_t, s_{t+1}) + r_T(s_T)
    such that  s_0 = start,   s_{t+1} = f(s_t, a_t),   every step avoids every obstacle

is a nonlinear program. It is sparse, since each of its conditions concerns one step, and IPOPT
solves it with exact first and second derivatives. The weights of obstacles (see `obstacles`) are
unknowns too.

Shapes: T steps, n state dimensions, m action dimensions, K obstacles, F sides of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi
import numpy as np

from swerve.base.space import Task
from swerve.demonstrators.obstacles import Obstacle, Path
from swerve.demonstrators.symbolic import as_casadi
from swerve.problem.mdp import MDP

GAP = 1e-5  # distance from obstacles, in the units of `obstacles_of`; above IPOPT's tolerance
MAX_ITERATIONS = 200  # of IPOPT for one program
OPTIONS = {
    "print_time": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "max_iter": MAX_ITERATIONS,
        "tol": 1e-7,
        "constr_viol_tol": 1e-8,
        "mu_strategy": "adaptive",
    },
}


class Solution(NamedTuple):
    """Last iterate of the solver.

    Attributes:
      path: the path.
      reward: reward of the path.
      is_optimal: whether the path is a local optimum, to IPOPT's tolerance.
      status: IPOPT's return status.
    """

    path: Path
    reward: float
    is_optimal: bool
    status: str


class Transcription:
    """The optimal control problem of an MDP, for any task.

    Args:
      mdp: the system; `dynamics`, `reward` and `terminal_reward` are differentiated twice.
      num_steps: T.
      limits: [2, m] least and largest actions, which may be infinite.

    Raises:
      ValueError: if one of these methods cannot be differentiated.
    """

    def __init__(self, mdp: MDP, num_steps: int, limits: np.ndarray) -> None:
        n, m, g = len(mdp.state_names), len(mdp.action_names), len(mdp.goal_names)
        name = type(mdp).__name__
        self._dynamics = as_casadi(mdp.dynamics, (n, m), f"{name}.dynamics")
        self._reward = as_casadi(mdp.reward, (n, m, n, g), f"{name}.reward")
        self._terminal_reward = as_casadi(mdp.terminal_reward, (n, g), f"{name}.terminal_reward")
        self._sizes, self._num_steps, self._limits = (n, m, g), num_steps, limits
        self._solvers: dict[tuple, tuple[casadi.Function, np.ndarray]] = {}

    def solve(self, task: Task, obstacles: Sequence[Obstacle], guess: Path) -> Solution:
        """Return the local optimum that a guess leads to.

        Args:
          task: start and goal.
          obstacles: the obstacles to avoid.
          guess: path to begin with; it need neither follow the dynamics nor avoid obstacles.
        """
        solver, limits = self._solver(obstacles)
        (n, m, _), num_steps = self._sizes, self._num_steps
        weights = [obstacle.weights(guess) for obstacle in obstacles]
        first = [guess.states.copy(), guess.actions, *weights]
        low, high = ([np.full_like(part, sign * np.inf) for part in first] for sign in (-1, 1))
        low[0][0] = high[0][0] = first[0][0] = task.start
        low[1][:], high[1][:] = self._limits
        for part, obstacle in zip(low[2:], obstacles, strict=True):
            part[:] = -np.inf if obstacle.radius > 0.0 else 0.0
        found = solver(
            x0=_joined(first),
            lbx=_joined(low),
            ubx=_joined(high),
            lbg=limits[0],
            ubg=limits[1],
            p=np.concatenate([task.goal, *(obstacle.offset for obstacle in obstacles)]),
        )
        values, status = found["x"].full().ravel(), str(solver.stats()["return_status"])
        split = (num_steps + 1) * n
        path = Path(
            values[:split].reshape(-1, n), values[split : split + num_steps * m].reshape(-1, m)
        )
        return Solution(path, -float(found["f"]), status == "Solve_Succeeded", status)

    def follow(self, start: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Return the states [T+1, n] that actions [T, m] lead to from a start."""
        states = [np.asarray(start, float)]
        for action in actions:
            states.append(self._dynamics(states[-1], action).full().ravel())
        return np.array(states)

    def _solver(self, obstacles: Sequence[Obstacle]) -> tuple[casadi.Function, np.ndarray]:
        """Return the solver for obstacles of these kinds, and the limits of its conditions."""
        key = tuple(obstacle.kind for obstacle in obstacles)
        if key not in self._solvers:
            self._solvers[key] = self._built(obstacles)
        return self._solvers[key]

    def _built(self, obstacles: Sequence[Obstacle]) -> tuple[casadi.Function, np.ndarray]:
        """Return a new solver, with places as parameters, and the limits [2, conditions]."""
        (n, m, g), num_steps = self._sizes, self._num_steps
        states = casadi.SX.sym("states", n, num_steps + 1)
        actions = casadi.SX.sym("actions", m, num_steps)
        goal = casadi.SX.sym("goal", g)
        offsets = [casadi.SX.sym("offset", len(item.offset)) for item in obstacles]
        weights = [casadi.SX.sym("weights", len(item.offset), num_steps) for item in obstacles]
        cost = -self._terminal_reward(states[:, -1], goal)
        conditions: list[tuple[casadi.SX, float, float]] = []
        for t in range(num_steps):
            state, action, after = states[:, t], actions[:, t], states[:, t + 1]
            cost -= self._reward(state, action, after, goal)
            conditions.append((self._dynamics(state, action) - after, 0.0, 0.0))
            for item, offset, weight in zip(obstacles, offsets, weights, strict=True):
                ends = (state, after) if item.on_segments else (state,)
                points = [casadi.vertcat(end, action) for end in ends]
                conditions += _separating(item, offset, weight[:, t], points)
        unknowns = [states, actions, *weights]
        program = {
            "x": casadi.vertcat(*(casadi.vec(part) for part in unknowns)),
            "p": casadi.vertcat(goal, *offsets),
            "f": cost,
            "g": casadi.vertcat(*(value for value, _, _ in conditions)),
        }
        limits = np.concatenate(
            [np.full((2, value.numel()), [[low], [high]]) for value, low, high in conditions],
            axis=1,
        )
        return casadi.nlpsol("solver", "ipopt", program, OPTIONS), limits


def _separating(
    obstacle: Obstacle, offset: casadi.SX, weight: casadi.SX, points: Sequence[casadi.SX]
) -> list[tuple[casadi.SX, float, float]]:
    """Return the conditions (value, low, high) for weights to separate points from a set."""
    conditions = []
    for point in points:
        beyond = casadi.DM(obstacle.normal) @ point[list(obstacle.columns)] - offset
        conditions.append((casadi.dot(weight, beyond), obstacle.radius + GAP, np.inf))
    if obstacle.radius > 0.0:
        conditions.append((casadi.sumsqr(weight), -np.inf, 1.0))
    else:
        conditions.append((casadi.sum1(weight), 1.0, 1.0))
    return conditions


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays joined into one vector of unknowns."""
    return np.concatenate([part.ravel() for part in parts])
