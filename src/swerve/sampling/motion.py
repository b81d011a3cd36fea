"""Learn how the states of a problem move, from steps of its dynamics.

Shapes: M states, K actions tried in each, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary, ref

import jax
import numpy as np

from swerve.evidence.motion import Motion, fit_motion
from swerve.problem.boundary import actions_of
from swerve.problem.mdp import MDP
from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem
from swerve.trust.own_motion import without_alarms

NUM_STATES = 900  # several for each product of features
MOST_ACTIONS = 25  # actions tried in a state
LEAST_FINITE = 0.5  # share of the states: with fewer finite ones, the fit would be of few places
MOST_OWN, LEAST_OWN = 64, 8  # trajectories of the model that must not seem impossible
OWN_STEPS = 12_800  # of these trajectories in all, if the least number of them does not have more
_KNOWN: WeakKeyDictionary[type, tuple[ref[MDP], Motion | None]] = WeakKeyDictionary()
"""By class, the MDP that was learned last, and its motion."""


def motion_of(problem: Problem) -> Motion | None:
    """Return how the states of a problem move; None where its moves take no definite time.

    Problems with the same MDP, which differ in what is known, share the motion.
    """
    mdp = problem.mdp
    if not mdp.is_timed or mdp.space.is_lattice:
        return None
    known, motion = _KNOWN.get(type(mdp), (None, None))
    if known is None or known() is not mdp:
        motion = _learned(problem)
        _KNOWN[type(mdp)] = ref(mdp), motion
    return motion


def _learned(problem: Problem) -> Motion | None:
    """Fit the motion to steps from states anywhere in the bounds, with any of the actions.

    Returns None where the dynamics are not finite for most states.
    """
    mdp = problem.mdp
    space, actions = mdp.space, np.asarray(actions_of(mdp))
    generator = np.random.default_rng(0)
    (low, high), shape = space.bounds.T, (NUM_STATES, len(space.names))
    before = generator.uniform(low, high, shape).astype(np.float32)
    order = generator.random((NUM_STATES, len(actions))).argsort(axis=1)[:, :MOST_ACTIONS]
    after = np.asarray(_successors(problem, before, actions[order]), np.float64)
    is_finite = np.isfinite(after).all(axis=(1, 2))
    if is_finite.mean() < LEAST_FINITE:
        return None
    before = before.astype(np.float64)
    motion = fit_motion(before[is_finite], after[is_finite], space, float(mdp.dt))
    return without_alarms(motion, _own(problem, before[is_finite], actions), problem.record)


def _own(problem: Problem, starts: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Return trajectories [N, T+1, n] of random actions from some of the starts [M, n].

    An action is held for a step in some trajectories, for the whole of it in others.
    """
    num_steps = problem.mdp.num_steps
    num = max(LEAST_OWN, min(MOST_OWN, OWN_STEPS // num_steps, len(starts)))
    generator = np.random.default_rng(1)
    drawn = generator.integers(len(actions), size=(num, num_steps))
    is_new = generator.random(drawn.shape) < np.geomspace(1.0 / num_steps, 1.0, num)[:, None]
    since = np.maximum.accumulate(np.where(is_new, np.arange(num_steps), 0), axis=1)
    taken = actions[np.take_along_axis(drawn, since, axis=1)]
    return np.asarray(_rolled_out(problem, starts[:num].astype(np.float32), taken), np.float64)


@of_problem
def _successors(problem: Problem, states: Any, actions: Any) -> jax.Array:
    """Return the states [M, K, n] one step after states [M, n], with actions [M, K, m]."""
    return jax.vmap(jax.vmap(problem.mdp.dynamics, (None, 0)))(states, actions)


@of_problem
def _rolled_out(problem: Problem, starts: Any, actions: Any) -> jax.Array:
    """Return the trajectories [N, T+1, n] from states [N, n] with actions [N, T, m]."""

    def step(state: Any, action: Any) -> tuple[Any, Any]:
        after = problem.mdp.dynamics(state, action)
        return after, after

    after = jax.vmap(lambda start, taken: jax.lax.scan(step, start, taken)[1])(starts, actions)
    return jax.numpy.concatenate([starts[:, None], after], axis=1)
