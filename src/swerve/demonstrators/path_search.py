"""Search for the local optima of one task: solve from several guesses, then around obstacles.

The program of `transcription` has many local optima: an angle may turn either way, an obstacle may
be passed on either side. So each guess is first solved with nothing in the way. Where the solution
enters an obstacle, its path is pushed out by each side of the obstacle in turn and solved again.

Shapes: T steps, n state dimensions, m action dimensions.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import numbers, positive_number, whole_number
from swerve.base.space import TWO_PI, Actions, Task
from swerve.constraints.base import Constraint, violates
from swerve.demonstrators.obstacles import Obstacle, Path, obstacles_of
from swerve.problem.problem import Problem

if TYPE_CHECKING:
    from swerve.demonstrators.transcription import Solution, Transcription

NUM_GUESSES = 8  # guesses by default; more guesses find better optima and take longer
GOAL_TOLERANCE = 0.05  # in the states' units, Euclidean: farthest end from the goal, by default
TURNS = (0, 1, -1, 2, -2)  # full turns of each angle that guesses add to its shorter arc
NUM_WAVES = 3  # sine waves that a random guess adds to the straight line
SWING = 0.2  # standard deviation of a wave's height, as a share of the extent of the state
NEAR = 0.25 * TWO_PI  # rad: images of an obstacle count this far beyond the angles of a path
EARLY, UNLIKE = "Ends_Early", "Unlike_Dynamics"  # faults of a solution, beside IPOPT's statuses
DEFECT = 1e-3  # share of the extent of a state by which a step may miss the dynamics (float32)
ROUNDS = 3  # rounds, at most, of adding the images of obstacles that a solution has come near


class Search(NamedTuple):
    """Settings of a search; see the arguments of `optimal_control`."""

    limits: tuple[float, float] | None = None
    num_steps: int | None = None
    num_guesses: int = NUM_GUESSES
    goal_tolerance: float = GOAL_TOLERANCE


class Found(NamedTuple):
    """Result of the search for one task.

    Attributes:
      solutions: the local optima that avoid every constraint, also those that miss the goal.
      endings: how often each status of the solver, or each fault of its solution, occurred.
    """

    solutions: list[Solution]
    endings: Counter[str]


class PathSearch:
    """The search, prepared once for all tasks of a problem.

    Args:
      problem: the model, with its known constraints.
      constraint: c, to avoid as well.
      search: the settings.

    Raises:
      ImportError: if CasADi is not installed.
      ValueError: if a setting is out of range, or the constraint has no sides.
    """

    def __init__(self, problem: Problem, constraint: Constraint, search: Search) -> None:
        mdp, names = problem.mdp, tuple(problem.mdp.action_names)
        num_steps = mdp.num_steps if search.num_steps is None else search.num_steps
        self.num_steps = whole_number(num_steps, "num_steps", 1)
        self.num_guesses = whole_number(search.num_guesses, "num_guesses", 1)
        self.goal_tolerance = positive_number(search.goal_tolerance, "goal_tolerance")
        self.mdp, self._limits = mdp, _checked_limits(search.limits, problem)
        self.avoided = (constraint, *problem.known)
        goals, states = tuple(mdp.goal_names), tuple(mdp.state_names)
        self._goal_columns = [states.index(goal) for goal in goals] if {*goals} <= {*states} else []
        spread = np.ptp(np.asarray(mdp.actions), axis=0)
        unit = np.concatenate([mdp.space.extent, np.where(spread > 0.0, spread, 1.0)])
        transcription = _transcription()
        self._obstacles = [
            obstacle
            for avoided in self.avoided
            for obstacle in obstacles_of(avoided, mdp.space, names, unit)
        ]
        self._transcription = transcription(mdp, self.num_steps, self._limits)

    def find(self, task: Task, generator: np.random.Generator) -> Found:
        """Return the local optima that the guesses lead to."""
        endings: Counter[str] = Counter()
        found: list[Solution] = []
        for guess in self._guesses(task, generator):
            for solution in self._solutions(task, guess, found):
                fault = self._fault(task, solution)
                endings[fault or solution.status] += 1
                if not fault:
                    found.append(solution)
        return Found(found, endings)

    def missed(self, task: Task, path: Path) -> float:
        """Return the distance of a path's end from its goal; 0 where goals are not states."""
        end = path.states[-1]
        return float(np.linalg.norm(self.mdp.space.difference(end, self._at_goal(end, task))))

    def _guesses(self, task: Task, generator: np.random.Generator) -> Iterator[Path]:
        """Yield the guesses: straight lines, one for each turn of the angles, then wavy lines."""
        mdp, share = self.mdp, np.linspace(0.0, 1.0, self.num_steps + 1)[:, None]
        is_finite = np.isfinite(self._limits).all(axis=0)
        action = np.where(is_finite, self._limits, 0.0).mean(axis=0)
        actions = np.tile(action, (self.num_steps, 1))
        ends = self._ends(task, action)
        waves = np.sin(np.pi * np.arange(1, NUM_WAVES + 1) * share)
        for k in range(self.num_guesses):
            states = task.start + share * (ends[k % len(ends)] - task.start)
            if k >= len(ends):
                size = SWING * mdp.space.extent
                states = states + waves @ generator.normal(size=(NUM_WAVES, len(size))) * size
            yield Path(states, actions)

    def _ends(self, task: Task, action: np.ndarray) -> list[np.ndarray]:
        """Return the ends of guesses: the goal at each turn of its angles.

        Where goals are not states, the only end is the state that a constant action leads to.
        """
        space = self.mdp.space
        if not self._goal_columns:
            actions = np.tile(action, (self.num_steps, 1))
            return [self._transcription.follow(task.start, actions)[-1]]
        end = task.start + space.difference(task.start, self._at_goal(task.start, task))
        turns = [TURNS if is_angle else (0,) for is_angle in space.is_angle]
        counts = sorted(itertools.product(*turns), key=lambda count: np.abs(count).sum())
        return [end + TWO_PI * np.array(count) for count in counts]

    def _solutions(self, task: Task, guess: Path, found: list[Solution]) -> Iterator[Solution]:
        """Yield the solutions of a guess: with nothing in the way, or around the obstacles."""
        free = self._transcription.solve(task, [], guess)
        if not (free.is_optimal and self._enters(free.path)):
            yield free
            return
        arriving = (one for one in found if self.missed(task, one.path) <= self.goal_tolerance)
        if free.reward <= max((one.reward for one in arriving), default=-np.inf):
            return  # a way around obstacles seldom earns more than the same guess without them
        for obstacle in self._near(free.path):
            for pushed in obstacle.pushed(free.path):
                yield self._around(task, pushed)

    def _around(self, task: Task, guess: Path) -> Solution:
        """Return the solution around the obstacles, at each turn that the path comes near."""
        near = self._near(guess)
        solution = self._transcription.solve(task, near, guess)
        for _ in range(ROUNDS):
            before, near = len(near), self._near(solution.path)
            if not solution.is_optimal or len(near) <= before:
                break
            solution = self._transcription.solve(task, near, solution.path)
        return solution

    def _near(self, path: Path) -> list[Obstacle]:
        """Return the obstacles, at every turn of their angles that a path comes near."""
        low, high = path.states.min(axis=0) - NEAR, path.states.max(axis=0) + NEAR
        return [image for obstacle in self._obstacles for image in obstacle.images(low, high)]

    def _fault(self, task: Task, solution: Solution) -> str:
        """Return the fault of a solution; "" for a local optimum that avoids every constraint."""
        if not solution.is_optimal:
            return solution.status
        if self._enters(solution.path):
            return "Enters_Constraint"
        if self._ends_early(solution.path, task.goal):
            return EARLY
        return UNLIKE if self._is_unlike(solution.path) else ""

    def _is_unlike(self, path: Path) -> bool:
        """Return whether a step differs from the MDP's dynamics for the same state and action."""
        states, actions = (jnp.asarray(values, jnp.float32) for values in path)
        after = np.asarray(jax.vmap(self.mdp.dynamics)(states[:-1], actions))
        missed = np.abs(self.mdp.space.difference(path.states[1:], after))
        return bool((missed > DEFECT * self.mdp.space.extent).any())

    def _enters(self, path: Path) -> bool:
        """Return whether a path enters a constraint, at a state or between two."""
        actions = Actions(tuple(self.mdp.action_names), path.actions)
        return any(
            bool(violates(constraint, path.states, self.mdp.space, True, actions))
            for constraint in self.avoided
        )

    def _ends_early(self, path: Path, goal: np.ndarray) -> bool:
        """Return whether the episode is over before the last state."""
        states = jnp.asarray(path.states[:-1], jnp.float32)
        over = jax.vmap(self.mdp.terminated, (0, None))(states, jnp.asarray(goal, jnp.float32))
        return bool(over.any())

    def _at_goal(self, state: np.ndarray, task: Task) -> np.ndarray:
        """Return a state [n] with the dimensions that the goal names moved to the goal."""
        moved = np.array(state, float)
        if self._goal_columns:
            moved[self._goal_columns] = task.goal
        return moved


def _checked_limits(limits: tuple[float, float] | None, problem: Problem) -> np.ndarray:
    """Return the least and largest actions [2, m]."""
    table = np.asarray(problem.mdp.actions, float)
    if limits is None:
        return np.stack([table.min(axis=0), table.max(axis=0)])
    pair = numbers(limits, 2)
    if pair is None or not pair[0] < pair[1]:
        raise ValueError(
            f"limits: expected the least and the largest action, as in (-10.0, 10.0), or None for "
            f"the range of the discretised actions, got {limits!r}"
        )
    return np.repeat(np.array(pair)[:, None], table.shape[1], axis=1)


def _transcription() -> type[Transcription]:
    """Return the class `Transcription`.

    Raises:
      ImportError: if CasADi is not installed.
    """
    try:
        from swerve.demonstrators.transcription import Transcription
    except ModuleNotFoundError as error:
        if error.name != "casadi":
            raise
        raise ImportError(
            "optimal control needs CasADi and its solver IPOPT, which are not installed: "
            "pip install 'swerve[control]'"
        ) from None
    return Transcription
