"""Sample states from anywhere, labelled with the hypotheses that a nominal trajectory then enters.

The nominal policy goes on from states all over the state space, at all times. Half of these states
lie near nominal trajectories but not on them: demonstrators who avoid something go there. Several
states of each trajectory are labelled, each with the hypotheses that the trajectory enters from
this state on, and with the weight

    w = exp(min(l, MAX_LOG_WEIGHT)),

where l is the log-weight of the rest of the trajectory (see `simulation.continuation`).

Shapes: R labelled states, N trajectories at once, M kept trajectories, K tasks, G goals,
H hypotheses, B = ceil(H / 8) bytes, T steps, n state dimensions, g goal dimensions.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from swerve.base.progress import Advance
from swerve.evidence.evidence import Evidence
from swerve.problem.problem import Problem
from swerve.simulation.continuation import continued
from swerve.simulation.trajectory import Policy, enters
from swerve.solvers.base import PolicyNominal

AT_ONCE = 256  # trajectories that go on from the same step, in one call
NUM_SUFFIXES = 8  # states of each trajectory that are labelled, its first state among them
# distance of starts from nominal trajectories, least and most, as a share of the states' extent
NEARBY = (0.005, 0.15)
# shares of the starts, added up: near nominal trajectories, then anywhere; the rest at the starts
# of tasks (at later steps, on nominal trajectories)
SHARES = (0.5, 0.85)
# nats. A high limit lets a few heavy trajectories outweigh the others: with a coarse policy (11
# nodes an axis), the network is off by 0.024 to 0.031 on average with limits from 1 to 4, and by
# 0.037, 0.052 and 0.060 with limits of 5, 7 and 40. A low limit leaves the bias of a poor policy:
# shares of 20,000 rollouts of a soft value learned for 200,000 steps are off by 0.053 without
# weights, by 0.023 with a limit of 1 and by 0.011 with a limit of 3.
MAX_LOG_WEIGHT = 3.0


class LabelledStates(NamedTuple):
    """States, and which hypotheses a trajectory of the nominal policy enters from each state on.

    Attributes:
      state: [R, n].
      step: [R] step at which the trajectory is in the state.
      goal: [R] number of the goal.
      entered: [R, B] packed bits: hypotheses that the rest of the trajectory enters.
      weight: [R] w; 0 for states to be left out.
    """

    state: np.ndarray
    step: np.ndarray
    goal: np.ndarray
    entered: np.ndarray
    weight: np.ndarray


def labelled_states(
    nominal: PolicyNominal,
    evidence: Evidence,
    goals: np.ndarray,
    goal_of: np.ndarray,
    num_trajectories: int,
    seed: int,
    advance: Advance,
) -> LabelledStates:
    """Sample labelled states for all goals.

    Args:
      nominal: nominal distribution whose policies go on.
      evidence: evidence of the same problem, with the tasks and the nominal trajectories.
      goals: [G, g].
      goal_of: [K] number of each task's goal.
      num_trajectories: number for each goal; rounded up to a multiple of AT_ONCE.
      seed: seed of everything random.
      advance: called with 1 for each policy that is ready, and for each goal that is done.
    """
    generator = np.random.default_rng(seed)
    num_chunks = max(1, -(-num_trajectories // AT_ONCE))
    parts = []
    for goal, policy in enumerate(nominal.policies(goals, advance)):
        tasks = np.flatnonzero(goal_of == goal)
        kept = np.concatenate(list(evidence.samples.kept[tasks]))
        # one step in each of equal parts of the horizon, so that no time is left out
        steps = (np.arange(num_chunks) + generator.random(num_chunks)) / num_chunks
        steps = (steps * nominal.problem.mdp.num_steps).astype(int)
        steps[0] = 0
        for step in steps.tolist():
            starts = _starts(nominal.problem, kept, evidence.tasks.start[tasks], step, generator)
            key = jax.random.key(int(generator.integers(2**31)))
            parts.append(_labelled(nominal.problem, policy, starts, step, goals, goal, key))
        advance(1.0)
    return LabelledStates(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _starts(
    problem: Problem,
    kept: np.ndarray,
    starts: np.ndarray,
    step: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """Return states [N, n] from which to go on at a step.

    Args:
      problem: problem with these states.
      kept: [M, L, n] nominal trajectories, each at rest in its last state.
      starts: [K, n] starts of tasks.
      step: step at which to go on.
      generator: source of randomness.
    """
    num_near, num_before_tasks = (int(share * AT_ONCE) for share in SHARES)
    space, now = problem.mdp.space, kept[:, min(step, kept.shape[1] - 1)]
    near = now[generator.integers(len(now), size=AT_ONCE)]
    scale = np.exp(generator.uniform(*np.log(NEARBY), size=(AT_ONCE, 1)))
    states = near + scale * space.extent * generator.normal(size=near.shape)
    keys = jax.random.split(jax.random.key(int(generator.integers(2**31))), AT_ONCE)
    anywhere = np.asarray(jax.vmap(problem.mdp.sample_state)(keys))
    states[num_near:num_before_tasks] = anywhere[num_near:num_before_tasks]
    from_tasks = near if step else starts[generator.integers(len(starts), size=AT_ONCE)]
    states[num_before_tasks:] = from_tasks[num_before_tasks:]
    return states


def _labelled(
    problem: Problem,
    policy: Policy,
    starts: np.ndarray,
    first: int,
    goals: np.ndarray,
    goal: int,
    key: Array,
) -> LabelledStates:
    """Go on from states [N, n] at a step, and label several states of each trajectory."""
    record, num_steps = problem.record, problem.mdp.num_steps
    target = jnp.asarray(goals[goal], jnp.float32)
    begin = jnp.asarray(starts.T, jnp.float32)
    key_cuts, key = jax.random.split(key)
    found = continued(problem, policy, begin, jnp.int32(first), target, key)
    states = np.moveaxis(np.asarray(found.states), -1, 0)
    log_weight = np.asarray(found.log_weight)
    shares = np.sort(np.asarray(jax.random.uniform(key_cuts, (NUM_SUFFIXES - 1,), jnp.float32)))
    cuts = np.unique([first, *(first + shares * (num_steps - first)).astype(int)])
    allowed = np.isfinite(states).all(axis=(1, 2)) & ~_is_forbidden(problem, begin)
    entered, parts = np.uint8(0), []
    for cut, end in reversed(list(zip(cuts, [*cuts[1:], num_steps], strict=True))):
        part = states[:, cut : end + 1]
        entered = entered | record.hypotheses.violations(part, record.space, record.between_states)
        weight = np.exp(np.minimum(log_weight[cut], MAX_LOG_WEIGHT))
        weight = np.where(allowed & np.isfinite(weight), weight, 0.0).astype(np.float32)
        step, number = np.full(len(states), cut), np.full(len(states), goal)
        parts.append(LabelledStates(states[:, cut], step, number, entered, weight))
    return LabelledStates(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _is_forbidden(problem: Problem, states: Array) -> np.ndarray:
    """Return which states [n, N] lie in a known constraint: a step that stays there enters it."""
    stays = jax.vmap(lambda state: enters(problem.known, state, state, problem.mdp, False), -1)
    return np.asarray(stays(states))
