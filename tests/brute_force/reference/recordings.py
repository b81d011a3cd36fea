"""Demonstrations sampled from pi_0 or pi_c by the reference itself, and recorded in many ways.

Shapes: N trajectories, L states of a demonstration, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from brute_force.reference.cells import CellWorld
from brute_force.reference.geometry import TURN
from brute_force.reference.paths import Paths
from brute_force.reference.regions import Region, Steps
from brute_force.reference.worlds import SmoothWorld, TableWorld

World = SmoothWorld | TableWorld
WAYS = ("plain", "plain", "timed", "dense", "resting", "cut")


class Recording(NamedTuple):
    """A demonstration.

    Attributes:
      task: its number.
      states: [L, n].
      actions: [L-1, m].
      times: [L] seconds, or None.
      path: its number among the trajectories of the task.
      way: how it was recorded, one of WAYS.
    """

    task: int
    states: np.ndarray
    actions: np.ndarray
    times: np.ndarray | None
    path: int
    way: str

    def enters(self, region: Region, world: World, between: bool) -> bool:
        """Return whether the demonstration enters a region, by its own rows."""
        steps = Steps(self.states[:-1], self.states[1:], self.actions, world.action_names)
        if region.entered_at_start(self.states[0], world.axes):
            return True
        return bool(region.entered(steps, world.axes, between).any())


def sampled(
    generator: np.random.Generator,
    task: int,
    world: World,
    paths: Paths,
    log_weight: np.ndarray,
    entered: np.ndarray,
) -> Recording:
    """Sample one demonstration of a task, that obeys one of the hypotheses or none.

    Args:
      generator: source of randomness.
      task: number of the task.
      world: what is demonstrated in.
      paths: the N trajectories.
      log_weight: [N] nats.
      entered: [N, H] True where a trajectory enters a hypothesis.
    """
    weight = np.exp(log_weight - log_weight.max())
    avoidable = np.flatnonzero(~entered.all(axis=0))
    if len(avoidable) and generator.random() < 0.7:
        weight = weight * ~entered[:, generator.choice(avoidable)]
    path = int(generator.choice(len(weight), p=weight / weight.sum()))
    way = str(generator.choice(WAYS))
    if isinstance(world, TableWorld | CellWorld) and way in ("dense", "resting", "timed"):
        way = "plain"
    return recorded(generator, task, world, paths, path, way)


def recorded(
    generator: np.random.Generator, task: int, world: World, paths: Paths, path: int, way: str
) -> Recording:
    """Record a trajectory: row by row, with times, twice a step, going on at rest, or cut short."""
    length = int(paths.length[path])
    states = paths.states[path, : length + 1]
    actions = world.actions[paths.actions[path, :length]]
    times = None
    if way == "cut":
        length = int(generator.integers(1, length + 1))
        states, actions = states[: length + 1], actions[:length]
    elif way == "resting":
        left = world.num_steps - length
        states = np.concatenate([states, np.repeat(states[-1:], left, axis=0)])
        actions = np.concatenate([actions, np.repeat(world.actions[:1], left, axis=0)])
    elif way == "timed":
        times = world.dt * np.arange(length + 1) + 3.0
    elif way == "dense":
        along = world.axes.steps(states[:-1], states[1:])
        between = np.stack([states[:-1], states[:-1] + 0.5 * along], axis=1)
        states = np.concatenate([between.reshape(-1, states.shape[1]), states[-1:]])
        actions = np.repeat(actions, 2, axis=0)
        times = 0.5 * world.dt * np.arange(len(states))
    if generator.random() < 0.3:
        states = states.copy()
        for name in world.axes.angles:
            states[:, world.axes.column(name)] %= TURN
    return Recording(task, states, actions, times, path, way)
