"""Learn how the states of a problem move, from steps of its dynamics.

Shapes: M states, K actions tried in each, n state dimensions, m action dimensions.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import jax
import numpy as np

from swerve.evidence.motion import Motion, fit_motion
from swerve.problem.boundary import actions_of
from swerve.problem.problem import Problem
from swerve.simulation.compiled import of_problem

NUM_STATES = 900  # several for each product of features
MOST_ACTIONS = 25  # actions tried in a state
LEAST_FINITE = 0.5  # share of the states: with fewer finite ones, the fit would be of few places
_KNOWN: WeakKeyDictionary[Problem, Motion] = WeakKeyDictionary()


def motion_of(problem: Problem) -> Motion | None:
    """Return how the states of a problem move; None where its moves take no definite time."""
    mdp = problem.mdp
    if not mdp.is_timed or mdp.space.is_lattice:
        return None
    if problem not in _KNOWN:
        found = _learned(problem)
        if found is None:
            return None
        _KNOWN[problem] = found
    return _KNOWN[problem]


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
    return fit_motion(before[is_finite], after[is_finite], space, float(mdp.dt))


@of_problem
def _successors(problem: Problem, states: Any, actions: Any) -> jax.Array:
    """Return the states [M, K, n] one step after states [M, n], with actions [M, K, m]."""
    return jax.vmap(jax.vmap(problem.mdp.dynamics, (None, 0)))(states, actions)
