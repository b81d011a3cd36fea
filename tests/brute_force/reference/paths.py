"""Every trajectory of a task, one after another: all action sequences of a short horizon.

    Z_0 = sum_xi m(xi) exp(beta R(xi)),    m = A^-length ("uniform") or 1 ("counting"),

over the trajectories that enter no known region; sequences that differ only after the end of an
episode are one trajectory. Trajectories that begin alike share their first steps, each of which is
taken, and judged, once.

Shapes: N trajectories, E steps of all together, T steps of one, n state dimensions, H regions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from brute_force.reference.geometry import Axes
from brute_force.reference.regions import Region, Steps
from brute_force.reference.worlds import World


@dataclass(frozen=True, eq=False)
class Paths:
    """The trajectories of one task.

    Attributes:
      steps: all E steps.
      step_of: [N, T] the steps of each trajectory; -1 after its end.
      actions: [N, T] numbers of actions; -1 after the end.
      reward: [N] R(xi).
      start: [n].
      axes: names and angles of the states.
      num_actions: A.
    """

    steps: Steps
    step_of: np.ndarray
    actions: np.ndarray
    reward: np.ndarray
    start: np.ndarray
    axes: Axes
    num_actions: int

    @property
    def length(self) -> np.ndarray:
        """[N] steps taken."""
        return (self.step_of >= 0).sum(axis=1)

    @property
    def states(self) -> np.ndarray:
        """[N, T+1, n]; a trajectory that has ended repeats its last state."""
        last = self.length - 1
        places = np.minimum(np.arange(self.step_of.shape[1]), last[:, None])
        ends = self.steps.ends[np.take_along_axis(self.step_of, places, axis=1)]
        starts = np.broadcast_to(self.start, (len(ends), 1, len(self.start)))
        return np.concatenate([starts, ends], axis=1)

    def log_measure(self, measure: str) -> np.ndarray:
        """Return log m [N], nats."""
        return -self.length * (math.log(self.num_actions) if measure == "uniform" else 0.0)

    def log_weight(self, beta: float, measure: str) -> np.ndarray:
        """Return beta R + log m [N], nats."""
        return beta * self.reward + self.log_measure(measure)

    def among(self, rows: np.ndarray) -> Paths:
        """Return some of the trajectories."""
        return replace(
            self,
            step_of=self.step_of[rows],
            actions=self.actions[rows],
            reward=self.reward[rows],
        )

    def entered_by(self, region: Region, between: bool) -> np.ndarray:
        """Return [N] how many states it takes to enter a region, from 1; T+2 if it never is.

        Raises:
          AmbiguousError: if a step passes an edge of the region too closely.
        """
        never = self.step_of.shape[1] + 2
        if region.entered_at_start(self.start, self.axes):
            return np.ones(len(self.reward), int)
        enters = np.append(region.entered(self.steps, self.axes, between), False)[self.step_of]
        return np.where(enters.any(axis=1), enters.argmax(axis=1) + 2, never)

    def enters(self, region: Region, between: bool) -> np.ndarray:
        """Return [N] True where a trajectory enters a region."""
        return self.entered_by(region, between) < self.step_of.shape[1] + 2

    def obeying(self, known: Sequence[Region], between: bool) -> Paths:
        """Return the trajectories that enter no known region."""
        obeys = np.ones(len(self.reward), bool)
        for region in known:
            obeys &= ~self.enters(region, between)
        return self.among(obeys)


def all_paths(world: World, start: np.ndarray, goal: np.ndarray) -> Paths:
    """Return every trajectory of a task.

    Raises:
      AmbiguousError: if an episode ends too closely at its limit.
    """
    start, num_actions = np.asarray(start, float), len(world.actions)
    states, reward = start[None], np.zeros(1)
    step_of = actions = np.zeros((1, 0), int)
    steps, finished, num = [], [], 0
    for step in range(world.num_steps):
        parts = []
        for action in range(num_actions):
            moved = world.moves(states, action, goal)
            over = moved.ended | (step == world.num_steps - 1)
            earned = reward + moved.rewards + np.where(over, moved.terminal, 0.0)
            taken = np.repeat(world.actions[action][None], len(over), axis=0)
            steps.append((states, moved.states, taken))
            numbers = num + np.arange(len(over))
            num += len(over)
            columns = (np.c_[step_of, numbers], np.c_[actions, np.full(len(over), action)])
            parts.append((moved.states, *columns, earned, over))
        states, step_of, actions, reward, over = map(np.concatenate, zip(*parts, strict=True))
        allowed = np.isfinite(reward)
        done, left = allowed & over, allowed & ~over
        pad = ((0, 0), (0, world.num_steps - step - 1))
        numbers = [np.pad(x[done], pad, constant_values=-1) for x in (step_of, actions)]
        finished.append((*numbers, reward[done]))
        states, step_of, actions, reward = (x[left] for x in (states, step_of, actions, reward))
    columns = [np.concatenate(part) for part in zip(*steps, strict=True)]
    found = [np.concatenate(part) for part in zip(*finished, strict=True)]
    together = Steps(*columns, action_names=world.action_names)
    return Paths(together, *found, start=start, axes=world.axes, num_actions=num_actions)


def log_sum(values: np.ndarray) -> float:
    """Return log sum exp of values; -inf for none."""
    largest = np.max(values, initial=-np.inf)
    if np.isneginf(largest):
        return -math.inf
    return float(largest + np.log(np.exp(values - largest).sum()))
