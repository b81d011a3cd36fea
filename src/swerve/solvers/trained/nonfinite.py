"""Trace numbers that are not finite to the method of the MDP which returned them.

A reward of -inf is allowed: it forbids a step. NaN and +inf are errors.

Shapes: L steps of a segment, N lanes, M = L N states, A actions, n states, g goal dimensions.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from swerve.problem.boundary import actions_of
from swerve.problem.problem import Problem
from swerve.simulation.trajectory import enters
from swerve.solvers.trained.lanes import Lanes

SAMPLED = "sample_state or sample_task"
ASKED: tuple[str, ...] = (SAMPLED, "features", "dynamics", "reward", "terminal_reward")


def check_steps(problem: Problem, visited: Lanes) -> None:
    """Check the numbers that an MDP returns for every action in the visited states.

    Args:
      problem: problem of the MDP.
      visited: states [L, n, N], steps [L, N] and goals [L, g, N], in the order of time.

    Raises:
      ValueError: naming the first method, step, state, goal and action without a finite number.
    """
    # [M, ...], the earliest first: later NaNs may only follow from the first NaN
    lanes = Lanes(*(jnp.moveaxis(x, -1, 1).reshape(-1, *x.shape[1:-1]) for x in visited))
    answers = dict(zip(ASKED, map(np.asarray, _ask(problem, lanes)), strict=True))
    bad = {name: _is_bad(name, x) for name, x in answers.items()}
    rows = {name: x.reshape(len(x), -1).any(axis=1) for name, x in bad.items()}
    found = {name: int(x.argmax()) for name, x in rows.items() if x.any()}
    if not found:
        return
    name = min(found, key=lambda name: found[name])  # of several in one state, the first in ASKED
    row = found[name]
    value = answers[name][row]
    where = f"at step {int(lanes.step[row])}"
    if name != SAMPLED:
        where += f" from state {_numbers(lanes.state[row])} with goal {_numbers(lanes.goal[row])}"
    if name not in (SAMPLED, "features"):
        action = int(np.argwhere(bad[name][row])[0, 0])
        value = value[action]
        where += f" with action {action}, {_numbers(actions_of(problem.mdp)[action])}"
    raise ValueError(
        f"{type(problem.mdp).__name__}.{name} returned {_numbers(value)} {where}: expected finite "
        "numbers"
    )


def _ask(problem: Problem, lanes: Lanes) -> tuple[Array, ...]:
    """Return the numbers of ASKED: two [M, ...] for the states, three [M, A, ...] for actions.

    Rewards are 0 for steps into a known constraint: such rewards are never paid.
    """
    mdp = problem.mdp

    def act(lane: Lanes, action: Array) -> tuple[Array, Array, Array]:
        following = mdp.dynamics(lane.state, action)
        hit = enters(problem.known, lane.state, following, mdp, problem.between_states, action)
        reward = jnp.where(hit, 0.0, mdp.reward(lane.state, action, following, lane.goal))
        return following, reward, jnp.where(hit, 0.0, mdp.terminal_reward(following, lane.goal))

    @jax.jit
    @jax.vmap
    def ask(lane: Lanes) -> tuple[Array, ...]:
        sampled = jnp.concatenate([lane.state, lane.goal])
        actions = actions_of(mdp)
        return sampled, mdp.features(*lane), *jax.vmap(act, (None, 0))(lane, actions)

    return ask(lanes)


def _is_bad(name: str, value: np.ndarray) -> np.ndarray:
    """Return where a value is neither finite nor a reward of -inf."""
    forbids = np.isneginf(value) & name.endswith("reward")
    return ~(np.isfinite(value) | forbids)


def _numbers(value: Any) -> str:
    """Return the text of a number, or of several in brackets."""
    value = np.asarray(value)
    if not value.ndim:
        return f"{value:.6g}"
    return f"[{', '.join(f'{x:.6g}' for x in value)}]"
