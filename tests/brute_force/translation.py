"""The reference's problems in terms of the library."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from brute_force.reference import regions as reference
from brute_force.reference.cases import Case
from brute_force.reference.recordings import Recording
from brute_force.reference.worlds import SmoothWorld, TableWorld
from jaxtyping import Array

from swerve import (
    MDP,
    ActionBox,
    Ball,
    Box,
    Constraint,
    Demonstration,
    HalfSpace,
    HypothesisSet,
    Inference,
    Occupancy,
    Polygon,
    Predicate,
    Problem,
    StateAction,
    Task,
    Union,
    grid,
    infer,
    tabular,
    windows,
)
from swerve.evidence.evidence import Evidence

ARRAYS = ("actions", "drift", "push", "bend", "waves", "phase", "running", "final", "ending")


class Planted(MDP):
    """A world of continuous states; the formulas are in `reference.worlds`."""

    state_names: tuple[str, ...] = eqx.field(static=True)
    angles: tuple[str, ...] = eqx.field(static=True)
    action_names: tuple[str, ...] = eqx.field(static=True)
    goal_names: tuple[str, ...] = eqx.field(static=True)
    bounds: tuple[tuple[float, float], ...] = eqx.field(static=True)
    num_steps: int = eqx.field(static=True)
    dt: float
    actions: Array
    drift: Array
    push: Array
    bend: Array
    waves: Array
    phase: Array
    effort: float
    running: Array
    final: Array
    ripple: float
    ending: Array
    limit: float
    penalty: float

    def dynamics(self, state, action):
        change = self.drift @ state + self.push @ action
        return state + self.dt * (change + self.bend * jnp.sin(self.waves @ state + self.phase))

    def reward(self, state, action, next_state, goal):
        off = self.off(next_state, goal, self.running)
        return self.ripple * jnp.sin(next_state[0]) - self.effort * (action @ action) - off

    def terminal_reward(self, state, goal):
        fine = jnp.where(self.terminated(state, goal), self.penalty, 0.0)
        return -self.off(state, goal, self.final) - fine

    def terminated(self, state, goal):
        return self.ending @ state > self.limit

    def goal_of(self, states):
        return states[-1, : len(self.goal_names)]

    def off(self, state, goal, weights):
        away = state[: len(self.goal_names)] - goal
        is_angle = np.array([name in self.angles for name in self.state_names])
        each = jnp.where(is_angle[: len(away)], 1.0 - jnp.cos(away), away**2)
        return weights[: len(away)] @ each


def mdp_of(case: Case) -> MDP:
    """Return the library's MDP of a case."""
    world = case.world
    if isinstance(world, TableWorld):
        return tabular(
            world.successors,
            world.rewards,
            num_steps=world.num_steps,
            terminal_rewards=world.terminal,
            absorbing=np.flatnonzero(world.absorbing).tolist(),
        )
    places = [one.states.reshape(-1, len(world.axes.names)) for one in case.paths]
    if world.goals_are_states:
        places.append(case.goals)
    return smooth_mdp(world, np.concatenate(places))


def smooth_mdp(world: SmoothWorld, states: np.ndarray) -> MDP:
    """Return the library's MDP of a world, with bounds around some states [N, n]."""
    low, high = states.min(axis=0) - 0.5, states.max(axis=0) + 0.5
    names = world.axes.names
    numbers = {name: jnp.asarray(getattr(world, name), jnp.float32) for name in ARRAYS}
    return Planted(
        state_names=names,
        angles=world.axes.angles,
        action_names=world.action_names,
        goal_names=names if world.goals_are_states else ("mark",),
        bounds=tuple(zip(low.tolist(), high.tolist(), strict=True)),
        num_steps=world.mdp_steps,
        dt=world.dt,
        effort=world.effort,
        ripple=world.ripple,
        limit=world.limit,
        penalty=world.penalty,
        **numbers,
    )


def constraint_of(region: reference.Region) -> Constraint:
    """Return the library's constraint of a region."""
    match region:
        case reference.BoxRegion():
            return Box(**region.intervals)
        case reference.BallRegion():
            return Ball(region.radius, **region.centre)
        case reference.HalfSpaceRegion():
            return HalfSpace(region.offset, **region.normal)
        case reference.PolygonRegion():
            return Polygon(region.vertices, region.names)
        case reference.MapRegion():
            blocked = np.array(region.blocked)
            return Occupancy("map", blocked, region.corner, region.cell, region.names)
        case reference.PredicateRegion():
            function = region.function
            return Predicate(region.name, lambda s: function(s) > 0.0, region.num_points)
        case reference.UnionRegion():
            return Union(region.name, [constraint_of(part) for part in region.parts])
        case reference.ActionRegion():
            return ActionBox(**region.intervals)
        case reference.StateActionRegion():
            actions = ActionBox(**region.actions.intervals)
            return StateAction(constraint_of(region.states), actions)
    raise AssertionError(region)


def hypotheses_of(case: Case) -> HypothesisSet | list[Constraint]:
    """Return the library's hypotheses of a case."""
    layout = case.layout
    if layout.kind == "grid":
        return grid(**{k: (low, high, int(num)) for k, (low, high, num) in layout.axes.items()})
    if layout.kind == "windows":
        return windows(layout.overlap, **layout.axes)
    return [constraint_of(region) for region in layout.regions]


def problem_of(case: Case, beta: float | None = None) -> Problem:
    """Return the library's problem of a case."""
    return Problem(
        mdp_of(case),
        hypotheses_of(case),
        beta=case.beta if beta is None else beta,
        measure=case.measure,
        known=[constraint_of(region) for region in case.known],
        between_states=case.between,
    )


def tasks_of(case: Case) -> list[Task]:
    """Return the library's tasks of a case."""
    return [Task(*pair) for pair in zip(case.starts, case.goals, strict=True)]


def demonstration_of(case: Case, recording: Recording, number: int = 0) -> Demonstration:
    """Return the library's demonstration of a recording."""
    task = Task(case.starts[recording.task], case.goals[recording.task])
    return Demonstration(
        f"demo {number}", recording.states, task, recording.times, recording.actions
    )


def demonstrations_of(case: Case) -> list[Demonstration]:
    """Return the library's demonstrations of a case."""
    return [demonstration_of(case, r, number) for number, r in enumerate(case.recordings)]


def inferred(case: Case, evidence: Evidence) -> Inference:
    """Return the library's inference from all demonstrations of a case."""
    assumed = case.assumed
    return infer(
        evidence,
        demonstrations_of(case),
        score=assumed.score,
        prior=assumed.prior,
        tolerance=assumed.tolerance,
        margin=assumed.margin,
        clearance=assumed.clearance,
    )
