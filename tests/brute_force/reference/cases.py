"""Random problems from a seed: a world, regions, tasks, demonstrations, and what is assumed.

Shapes: K tasks, N trajectories of a task, H hypotheses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from brute_force.reference.cells import CellWorld, in_cells
from brute_force.reference.geometry import AmbiguousError, is_inside
from brute_force.reference.layouts import Layout, Maker, random_grid, random_windows
from brute_force.reference.paths import Paths, all_paths
from brute_force.reference.recordings import Recording, sampled
from brute_force.reference.regions import NothingLeftError, Region
from brute_force.reference.worlds import (
    SmoothWorld,
    TableWorld,
    random_smooth_world,
    random_table_world,
)

SIZES = ((2, 6), (2, 5), (2, 4), (3, 4), (3, 3), (3, 5), (4, 3), (4, 4), (4, 2))  # A, T
ATTEMPTS = 60  # at a part of a problem that passes no edge too closely
Part = TypeVar("Part")


@dataclass(frozen=True)
class Assumptions:
    """What an inference assumes; see `swerve.infer`."""

    prior: float | np.ndarray | None = None
    tolerance: float = 0.0
    margin: dict[str, float] | None = None
    clearance: float | None = None
    score: str = "likelihood"

    def full_prior(self, num: int) -> np.ndarray:
        """Return the prior [H + 1], P(no constraint) first."""
        none = 0.5 if self.prior is None else self.prior
        if np.ndim(none):
            return np.asarray(none, float)
        return np.r_[none, np.full(num, (1.0 - float(none)) / num)]


@dataclass(frozen=True, eq=False)
class Case:
    """A random problem, with its tasks and demonstrations.

    Attributes:
      seed: what it was made from.
      world: dynamics and rewards.
      layout: the hypotheses.
      known: regions that nobody enters.
      beta: nats per unit of reward.
      measure: "uniform" or "counting".
      between: whether segments between states count.
      starts: [K, n].
      goals: [K, g].
      paths: for each task, all trajectories that obey what is known.
      entered_by: for each task [N, H]; see `Paths.entered_by`.
      recordings: the demonstrations.
      judged: [D, H] True where a demonstration enters a hypothesis less the margin.
      is_counted: [K, H] True where a task tells something about a hypothesis.
      assumed: what the inference assumes.
    """

    seed: int
    world: SmoothWorld | TableWorld
    layout: Layout
    known: tuple[Region, ...]
    beta: float
    measure: str
    between: bool
    starts: np.ndarray
    goals: np.ndarray
    paths: list[Paths]
    entered_by: list[np.ndarray]
    recordings: tuple[Recording, ...]
    judged: np.ndarray
    is_counted: np.ndarray
    assumed: Assumptions

    @cached_property
    def entered(self) -> list[np.ndarray]:
        """For each task [N, H] True where a trajectory enters a hypothesis."""
        return [by < self.world.num_steps + 2 for by in self.entered_by]

    @cached_property
    def log_weights(self) -> list[np.ndarray]:
        """For each task [N] beta R + log m, nats."""
        return [paths.log_weight(self.beta, self.measure) for paths in self.paths]

    @property
    def task_of(self) -> np.ndarray:
        """[D] the tasks of the demonstrations."""
        return np.array([recording.task for recording in self.recordings], int)


def random_case(seed: int, kind: str = "any", sizes: tuple = SIZES) -> Case:
    """Return the random problem of a seed.

    Args:
      seed: the same seed gives the same problem.
      kind: "any"; "smooth", without tables; or "cells", a smooth world seen through cells.
      sizes: what the numbers of actions and of steps are chosen from.
    """
    generator = np.random.default_rng([24, seed])
    return _retried(lambda: _attempt(seed, generator, kind, sizes))


def _world(
    generator: np.random.Generator, kind: str, num_actions: int, num_steps: int
) -> SmoothWorld | TableWorld:
    if generator.random() < 0.15 and kind == "any":
        return random_table_world(generator, num_steps, num_actions)
    world = random_smooth_world(generator, num_steps, num_actions)
    return in_cells(world, generator) if kind == "cells" else world


def _retried(make: Callable[[], Part]) -> Part:
    """Return what a function makes, once it passes no edge too closely."""
    for _ in range(ATTEMPTS):
        try:
            return make()
        except AmbiguousError:
            continue
    raise AmbiguousError("every attempt passed an edge too closely")


def _attempt(seed: int, generator: np.random.Generator, kind: str, sizes: tuple) -> Case:
    world = _world(generator, kind, *sizes[int(generator.integers(len(sizes)))])
    between = bool(generator.random() < (0.2 if isinstance(world, TableWorld) else 0.65))
    starts, goals = _tasks(generator, world)
    paths = [all_paths(world, *task) for task in zip(starts, goals, strict=True)]
    _check_turns(paths)
    maker = _maker(generator, world, paths)
    known: tuple[Region, ...] = ()
    if generator.random() < 0.35:
        known = (_retried(lambda: _known(maker, paths, between)),)
    paths = [one.obeying(known, between) for one in paths]
    layout, entered_by = _layout(maker, paths, between)
    beta = float(np.exp(generator.uniform(np.log(0.2), np.log(4.0))))
    measure = ("uniform", "counting")[int(generator.integers(2))]

    def recordings() -> tuple[tuple[Recording, ...], np.ndarray]:
        made = _recordings(generator, world, paths, beta, entered_by)
        judged = [[r.enters(c, world, between) for c in layout.regions] for r in made]
        for region in known:
            if any(recording.enters(region, world, between) for recording in made):
                raise AmbiguousError("a row between two states lies in a known region")
        return made, np.array(judged, bool).reshape(len(made), len(layout.regions))

    made, judged = _retried(recordings)
    counted = np.ones((len(starts), len(layout.regions)), bool)
    case = Case(
        seed, world, layout, known, beta, measure, between, starts, goals, paths, entered_by,
        made, judged, counted, Assumptions(),
    )  # fmt: skip
    return _retried(lambda: assuming(case, _assumptions(generator, case)))


def _check_turns(paths: list[Paths]) -> None:
    """Refuse steps that turn so far that the shorter arc is in doubt, or states far away."""
    for one in paths:
        one.axes.steps(one.steps.starts.copy(), one.steps.ends)
        if np.abs(one.steps.ends).max() > 12.0 or not len(one.reward):
            raise AmbiguousError("states lie far away, or no trajectory is allowed")


def _tasks(
    generator: np.random.Generator, world: SmoothWorld | TableWorld
) -> tuple[np.ndarray, np.ndarray]:
    """Return one to three starts and goals, in numbers that float32 holds."""
    num, n = int(generator.choice([1, 1, 2, 3])), len(world.axes.names)
    if isinstance(world, TableWorld):
        size = len(world.absorbing) - 1
        return generator.permutation(size)[:num, None].astype(float), np.zeros((num, 0))
    starts = np.round(generator.uniform(-1.0, 1.0, (num, n)) * 64) / 64
    if isinstance(world, CellWorld):
        starts = world.centres(starts + 1e-3)
    elif np.isfinite(world.limit):
        starts[:, 0] = np.minimum(starts[:, 0], np.floor(64 * (world.limit - 0.2)) / 64)
    if (starts @ world.ending > world.limit).any():
        raise AmbiguousError("an episode is over before it begins")
    num_goal = len(world.goal_columns)  # within the bounds of the library's state space
    goals = np.round(generator.uniform(-1.5, 1.5, (num, num_goal)) * 64) / 64
    return starts, goals


def _maker(
    generator: np.random.Generator, world: SmoothWorld | TableWorld, paths: list[Paths]
) -> Maker:
    """Return a maker of regions at states that trajectories reach."""
    ends = np.concatenate([one.steps.ends for one in paths])
    spread = 0.0 if isinstance(world, TableWorld) else 0.3

    def place() -> np.ndarray:
        end = ends[int(generator.integers(len(ends)))]
        return end + generator.normal(0.0, spread, len(end)) if spread else end

    return Maker(generator, world, place)


def _known(maker: Maker, paths: list[Paths], between: bool) -> Region:
    """Return a region that bars the way of some trajectories of a task, and not of most."""
    region = maker.region()
    for one in paths:
        share = one.enters(region, between).mean()
        if region.entered_at_start(one.start, one.axes) or share > 0.7:
            raise AmbiguousError("hardly any trajectory is left")
    return region


def _layout(maker: Maker, paths: list[Paths], between: bool) -> tuple[Layout, list[np.ndarray]]:
    """Return hypotheses, and when each trajectory enters them."""
    kind = str(maker.generator.choice(["list", "list", "grid", "windows"]))
    judge = lambda region: [one.entered_by(region, between) for one in paths]  # noqa: E731
    if kind == "list":

        def one_more() -> tuple[Region, list[np.ndarray]]:
            region = maker.region()
            return region, judge(region)

        num = int(maker.generator.integers(2, 9))
        found = [_retried(one_more) for _ in range(num)]
        layout = Layout("list", tuple(region for region, _ in found), {})
        by = [entered for _, entered in found]
    else:
        make = random_grid if kind == "grid" else random_windows

        def whole() -> tuple[Layout, list[list[np.ndarray]]]:
            layout = make(maker)
            return layout, [judge(region) for region in layout.regions]

        layout, by = _retried(whole)
    return layout, [np.stack(columns, axis=1) for columns in zip(*by, strict=True)]


def _recordings(
    generator: np.random.Generator,
    world: SmoothWorld | TableWorld,
    paths: list[Paths],
    beta: float,
    entered_by: list[np.ndarray],
) -> tuple[Recording, ...]:
    """Return up to five demonstrations; some are the same twice."""
    made: list[Recording] = []
    for _ in range(int(generator.choice([0, 1, 1, 2, 3, 4, 5]))):
        if made and generator.random() < 0.15:
            made.append(made[int(generator.integers(len(made)))])
            continue
        k = int(generator.integers(len(paths)))
        entered = entered_by[k] < world.num_steps + 2
        log_weight = paths[k].log_weight(beta, "uniform")
        made.append(sampled(generator, k, world, paths[k], log_weight, entered))
    return tuple(made)


def _assumptions(generator: np.random.Generator, case: Case) -> Assumptions:
    """Return what an inference assumes: mostly nothing, sometimes everything at once."""
    num = len(case.layout.regions)
    prior = None
    if generator.random() < 0.2:
        prior = float(generator.choice([0.0, 0.05, 0.9, 1.0]))
    elif generator.random() < 0.3:
        prior = generator.dirichlet(np.ones(num + 1))
        prior[generator.random(num + 1) < 0.15] = 0.0
        prior = prior / prior.sum() if prior.sum() > 0.0 else None
    has_shape = all(region.has_shape for region in case.layout.regions)
    names = case.world.axes.names
    is_smooth = isinstance(case.world, SmoothWorld)
    margin = {
        name: float(generator.uniform(0.0, 0.06)) for name in names if generator.random() < 0.7
    }
    return Assumptions(
        prior=prior,
        tolerance=float(generator.uniform(0.001, 0.4)) if generator.random() < 0.3 else 0.0,
        margin=margin if margin and has_shape and is_smooth and generator.random() < 0.35 else None,
        clearance=float(generator.uniform(0.02, 0.4))
        if has_shape and generator.random() < 0.25
        else None,
        score="average" if generator.random() < 0.15 else "likelihood",
    )


def assuming(case: Case, assumed: Assumptions) -> Case:
    """Return a case with other assumptions, and its demonstrations judged by these."""
    world, regions = case.world, case.layout.regions
    try:
        less = [c if assumed.margin is None else c.less(assumed.margin) for c in regions]
    except NothingLeftError:
        raise AmbiguousError("the margin leaves nothing") from None
    judged = [[r.enters(c, world, case.between) for c in less] for r in case.recordings]
    counted = np.ones((len(case.starts), len(regions)), bool)
    are_states = isinstance(world, SmoothWorld) and world.goals_are_states
    for ends in [case.starts, case.goals] if are_states else [case.starts]:
        for h, (region, inner) in enumerate(zip(regions, less, strict=True)):
            if assumed.clearance is not None:
                gap = region.gap(ends, world.axes) - assumed.clearance
                counted[:, h] &= is_inside(gap)
            if assumed.margin is not None:
                grazes = region.holds(ends, world.axes) & ~inner.holds(ends, world.axes)
                counted[:, h] &= ~grazes
    return replace(
        case,
        judged=np.array(judged, bool).reshape(len(case.recordings), len(regions)),
        is_counted=counted,
        assumed=assumed,
    )
