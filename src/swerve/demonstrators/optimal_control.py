"""Demonstrations by constrained optimal control, as the paper made them (section IV).

    max  sum_t r(s_t, a_t, s_{t+1}) + r_T(s_T)    such that the path keeps out of c

over continuous actions, by direct transcription (see `transcription`). The program has many local
optima: an angle may turn either way, an obstacle be passed on either side. So it is solved from
several guesses, first with nothing in the way; what then enters the obstacle is pushed out of it by
each of its sides in turn and solved again. The best that keeps out, between states too, is taken.

Shapes: T steps, n state dimensions, m action dimensions, K tasks.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import numbers, positive_number, whole_number
from swerve.base.progress import progress_bar
from swerve.base.space import TWO_PI, Actions, Task
from swerve.constraints.base import Constraint, violates
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrators.obstacles import Obstacle, Path, obstacles_of
from swerve.problem.problem import Problem
from swerve.problem.tasks import named_tasks

if TYPE_CHECKING:
    from swerve.demonstrators.transcription import Solution, Transcription

NUM_GUESSES, GOAL_TOLERANCE = 8, 0.05
SPARE = 2  # times as many tasks to draw as optima are wanted, since not all of them can be done
TURNS = (0, 1, -1, 2, -2)  # of each angle, beyond the shorter arc, that guesses make
NUM_WAVES = 3  # sines that a random guess swings by
SWING = 0.2  # of the extent of a state, their standard deviation
NEAR = 0.25 * TWO_PI  # rad, beyond the angles of a path, how far images of obstacles count
SAME = 1e-5  # relative: rewards closer than this are those of one optimum
EARLY, UNLIKE = "Ends_Early", "Unlike_Dynamics"  # what else may be the matter with an optimum
DEFECT = 1e-3  # of the extent of a state, by which a step may be off the dynamics
ROUNDS = 3  # times that turns of an obstacle are added which a solution has come to


class NoPathError(ValueError):
    """No path was found that keeps out and reaches its goal."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """A demonstration that is a local optimum.

    Attributes:
      demonstration: the best path that was found, with its actions.
      reward: its reward.
      rewards: those of all local optima that were found and reach the goal, the best first. Guesses
        that are no better with nothing in the way are not followed, so there may be more.
      num_guesses: from how many guesses.
      endings: how often the solver ended how, in its own words.
    """

    demonstration: Demonstration
    reward: float
    rewards: tuple[float, ...]
    num_guesses: int
    endings: dict[str, int]


class Search(NamedTuple):
    """What is looked for; see `optimal_control`."""

    limits: tuple[float, float] | None = None
    num_steps: int | None = None
    num_guesses: int = NUM_GUESSES
    goal_tolerance: float = GOAL_TOLERANCE


def optimal_control(
    problem: Problem,
    constraint: Constraint,
    tasks: Task | Sequence[Task],
    *,
    names: Sequence[str] | None = None,
    limits: tuple[float, float] | None = None,
    num_steps: int | None = None,
    num_guesses: int = NUM_GUESSES,
    goal_tolerance: float = GOAL_TOLERANCE,
    seed: int = 0,
    progress: bool = False,
) -> list[Optimum]:
    """Make a demonstration of each task that is a local optimum under a constraint.

    Args:
      problem: the model; its hypotheses do not matter.
      constraint: c, what to keep out of, made of boxes, balls, half-spaces and polygons, or of
        actions (`ActionBox`, `StateAction`). What the problem knows is kept out of as well.
      tasks: one task, a list of them, or a `Task` of arrays with a leading axis.
      names: what to call the demonstrations; demo_000 and so on if None.
      limits: least and largest action, infinite where there is none; those of the discretised
        actions if None.
      num_steps: T; the problem's horizon if None. Give it where episodes end early.
      num_guesses: from how many paths to begin; more find better optima.
      goal_tolerance: how far from its goal a demonstration may end, where the names of goals are
        names of states, such as a position [Euclidean, in the states' units].
      seed: of the guesses.
      progress: whether to show a progress bar.

    Returns:
      K optima, of which the demonstrations enter nothing that they are to keep out of, neither at
      a state nor between two.

    Raises:
      ImportError: if CasADi is not installed.
      NoPathError: if no guess leads to a path that reaches the goal and keeps out; a ValueError.
      ValueError: if a start lies inside the constraint, or an argument is of the wrong kind or
        range.
    """
    seed = whole_number(seed, "seed", 0)
    batch, labels = named_tasks(problem, constraint, tasks, names)
    search = Search(limits, num_steps, num_guesses, goal_tolerance)
    planner = _Planner(problem, constraint, search)
    found = []
    with progress_bar("demonstrating", len(labels), progress) as advance:
        for k, (label, *task) in enumerate(zip(labels, *batch, strict=True)):
            found.append(planner.plan(Task(*task), label, np.random.default_rng([seed, k])))
            advance(1)
    return found


def first_optima(
    problem: Problem,
    constraint: Constraint,
    tasks: Task,
    num: int,
    search: Search,
    *,
    seed: int = 0,
    progress: bool = False,
) -> list[Optimum]:
    """Return optima, as `optimal_control` does, of the first tasks that can be done.

    Args:
      problem: the model.
      constraint: what to keep out of.
      tasks: [K] of which some may be impossible.
      num: how many; their names are demo_000 and so on.
      search: what is looked for.
      seed: of the guesses.
      progress: whether to show a progress bar.

    Raises:
      NoPathError: if there are not so many.
    """
    batch, _ = named_tasks(problem, constraint, tasks, None)
    planner = _Planner(problem, constraint, search)
    found: list[Optimum] = []
    reason = "all of them could"
    with progress_bar("demonstrating", num, progress) as advance:
        for k, task in enumerate(zip(*batch, strict=True)):
            label, generator = f"demo_{len(found):03d}", np.random.default_rng([seed, k])
            try:
                found.append(planner.plan(Task(*task), label, generator))
            except NoPathError as error:
                reason = str(error)
                continue
            advance(1)
            if len(found) == num:
                return found
    raise NoPathError(
        f"only {len(found)} of {len(batch.start)} tasks can be done, {num} were asked for; the "
        f"last that could not: {reason}"
    )


def _checked_limits(limits: tuple[float, float] | None, problem: Problem) -> np.ndarray:
    """Return the least and largest actions [2, m]."""
    table = np.asarray(problem.mdp.actions, float)
    if limits is None:
        return np.stack([table.min(axis=0), table.max(axis=0)])
    pair = numbers(limits, 2)
    if pair is None or not pair[0] < pair[1]:
        raise ValueError(
            f"limits: expected the least and the largest action, as in (-10.0, 10.0), or None for "
            f"those of the discretised actions, got {limits!r}"
        )
    return np.repeat(np.array(pair)[:, None], table.shape[1], axis=1)


class _Planner:
    """What is the same for all tasks."""

    def __init__(self, problem: Problem, constraint: Constraint, search: Search) -> None:
        mdp, names = problem.mdp, tuple(problem.mdp.action_names)
        num_steps = mdp.num_steps if search.num_steps is None else search.num_steps
        self._num_steps = whole_number(num_steps, "num_steps", 1)
        self._num_guesses = whole_number(search.num_guesses, "num_guesses", 1)
        self._goal_tolerance = positive_number(search.goal_tolerance, "goal_tolerance")
        self._mdp, self._limits = mdp, _checked_limits(search.limits, problem)
        self._avoided = (constraint, *problem.known)
        goals, states = tuple(mdp.goal_names), tuple(mdp.state_names)
        self._goal_columns = [states.index(goal) for goal in goals] if {*goals} <= {*states} else []
        spread = np.ptp(np.asarray(mdp.actions), axis=0)
        unit = np.concatenate([mdp.space.extent, np.where(spread > 0.0, spread, 1.0)])
        transcription = _transcription()
        self._obstacles = [
            obstacle
            for avoided in self._avoided
            for obstacle in obstacles_of(avoided, mdp.space, names, unit)
        ]
        self._transcription = transcription(mdp, self._num_steps, self._limits)

    def plan(self, task: Task, name: str, generator: np.random.Generator) -> Optimum:
        """Return the best path that is found.

        Raises:
          NoPathError: if none is, or it ends too far from the goal.
        """
        endings: Counter[str] = Counter()
        found: list[Solution] = []
        for guess in self._guesses(task, generator):
            for solution in self._solutions(task, guess, found):
                fault = self._fault(task, solution)
                endings[fault or solution.status] += 1
                if not fault:
                    found.append(solution)
        tried = ", ".join(f"{count} {how}" for how, count in endings.most_common())
        where = f"{name}: from start {task.start.tolist()} to goal {task.goal.tolist()}"
        if not found:
            avoided = ", ".join(constraint.name for constraint in self._avoided)
            raise NoPathError(
                f"{where} no path was found that keeps out of {avoided}, from {self._num_guesses} "
                f"guesses ({tried}): {self._remedy(endings)}"
            )
        missed = [self._missed(task, solution.path) for solution in found]
        near = [
            one for one, miss in zip(found, missed, strict=True) if miss <= self._goal_tolerance
        ]
        if not near:
            raise NoPathError(
                f"{where} the nearest path that was found ends {min(missed):.3g} from the goal, "
                f"more than goal_tolerance = {self._goal_tolerance:g} ({tried}): choose another "
                "task, wider limits of actions or a larger goal_tolerance"
            )
        best = max(near, key=lambda solution: solution.reward)
        times = np.arange(self._num_steps + 1) * self._mdp.dt
        states, actions = best.path
        demonstration = Demonstration(name, states, task, times=times, actions=actions)
        rewards = tuple(_distinct(sorted((solution.reward for solution in near), reverse=True)))
        return Optimum(demonstration, best.reward, rewards, self._num_guesses, dict(endings))

    def _guesses(self, task: Task, generator: np.random.Generator) -> Iterator[Path]:
        """Yield paths to begin with: straight ones, by turns of the angles, then swinging ones."""
        mdp, share = self._mdp, np.linspace(0.0, 1.0, self._num_steps + 1)[:, None]
        is_finite = np.isfinite(self._limits).all(axis=0)
        action = np.where(is_finite, self._limits, 0.0).mean(axis=0)
        actions = np.tile(action, (self._num_steps, 1))
        ends = self._ends(task, action)
        waves = np.sin(np.pi * np.arange(1, NUM_WAVES + 1) * share)
        for k in range(self._num_guesses):
            states = task.start + share * (ends[k % len(ends)] - task.start)
            if k >= len(ends):
                size = SWING * mdp.space.extent
                states = states + waves @ generator.normal(size=(NUM_WAVES, len(size))) * size
            yield Path(states, actions)

    def _ends(self, task: Task, action: np.ndarray) -> list[np.ndarray]:
        """Return where guesses end: at the goal, by turns of angles, or where one would coast."""
        space = self._mdp.space
        if not self._goal_columns:
            actions = np.tile(action, (self._num_steps, 1))
            return [self._transcription.follow(task.start, actions)[-1]]
        end = task.start + space.difference(task.start, self._at_goal(task.start, task))
        turns = [TURNS if is_angle else (0,) for is_angle in space.is_angle]
        counts = sorted(itertools.product(*turns), key=lambda count: np.abs(count).sum())
        return [end + TWO_PI * np.array(count) for count in counts]

    def _solutions(self, task: Task, guess: Path, found: list[Solution]) -> Iterator[Solution]:
        """Yield what a guess leads to, with nothing in the way and then around what is."""
        free = self._transcription.solve(task, [], guess)
        if not (free.is_optimal and self._enters(free.path)):
            yield free
            return
        arriving = (one for one in found if self._missed(task, one.path) <= self._goal_tolerance)
        if free.reward <= max((one.reward for one in arriving), default=-np.inf):
            return  # going around seldom makes it better than with nothing in the way
        for obstacle in self._near(free.path):
            for guess in obstacle.pushed(free.path):
                yield self._around(task, guess)

    def _around(self, task: Task, guess: Path) -> Solution:
        """Return what a guess leads to with obstacles in the way, at all turns it comes near."""
        near = self._near(guess)
        solution = self._transcription.solve(task, near, guess)
        for _ in range(ROUNDS):
            before, near = len(near), self._near(solution.path)
            if not solution.is_optimal or len(near) <= before:
                break
            solution = self._transcription.solve(task, near, solution.path)
        return solution

    def _near(self, path: Path) -> list[Obstacle]:
        """Return the obstacles, angles at every turn that the path comes near."""
        low, high = path.states.min(axis=0) - NEAR, path.states.max(axis=0) + NEAR
        return [image for obstacle in self._obstacles for image in obstacle.images(low, high)]

    def _remedy(self, endings: Counter[str]) -> str:
        """Return what to try, by how the solver ended."""
        if EARLY in endings:
            return f"choose fewer num_steps than {self._num_steps}, after which the episode is over"
        if UNLIKE in endings:
            return "write dynamics with arithmetic, jnp.where and loops of a fixed length"
        return "choose another task, wider limits of actions, other num_steps or more num_guesses"

    def _fault(self, task: Task, solution: Solution) -> str:
        """Return what speaks against a solution; nothing if it is an optimum that keeps out."""
        if not solution.is_optimal:
            return solution.status
        if self._enters(solution.path):
            return "Enters_Constraint"
        if self._ends_early(solution.path, task.goal):
            return EARLY
        return UNLIKE if self._is_unlike(solution.path) else ""

    def _is_unlike(self, path: Path) -> bool:
        """Return whether a step is not what the dynamics of the MDP make of its action."""
        states, actions = (jnp.asarray(values, jnp.float32) for values in path)
        after = np.asarray(jax.vmap(self._mdp.dynamics)(states[:-1], actions))
        missed = np.abs(self._mdp.space.difference(path.states[1:], after))
        return bool((missed > DEFECT * self._mdp.space.extent).any())

    def _enters(self, path: Path) -> bool:
        actions = Actions(tuple(self._mdp.action_names), path.actions)
        return any(
            bool(violates(constraint, path.states, self._mdp.space, True, actions))
            for constraint in self._avoided
        )

    def _ends_early(self, path: Path, goal: np.ndarray) -> bool:
        """Return whether the episode is over before the last state."""
        states = jnp.asarray(path.states[:-1], jnp.float32)
        over = jax.vmap(self._mdp.terminated, (0, None))(states, jnp.asarray(goal, jnp.float32))
        return bool(over.any())

    def _missed(self, task: Task, path: Path) -> float:
        """Return how far from its goal a path ends, 0 where goals are no states."""
        end = path.states[-1]
        return float(np.linalg.norm(self._mdp.space.difference(end, self._at_goal(end, task))))

    def _at_goal(self, state: np.ndarray, task: Task) -> np.ndarray:
        """Return a state [n] moved to the goal, where goals are states or some of their names."""
        moved = np.array(state, float)
        if self._goal_columns:
            moved[self._goal_columns] = task.goal
        return moved


def _distinct(rewards: list[float]) -> list[float]:
    """Return rewards in descending order, of those that are nearly the same the first."""
    kept: list[float] = []
    for reward in rewards:
        if not kept or kept[-1] - reward > SAME * (1.0 + abs(reward)):
            kept.append(reward)
    return kept


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
