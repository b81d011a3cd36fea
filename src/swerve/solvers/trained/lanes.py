"""Lanes: the episodes, side by side, that trained solvers learn from.

A share of the lanes explores: these lanes start anywhere at any time. Such starts cost nothing in a
simulator, and find all modes. The other lanes start where tasks start.

Shapes: N lanes, n states, g goal dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Key

from swerve.problem.problem import Problem
from swerve.problem.tasks import can_begin


class Lanes(NamedTuple):
    """States [n, N], steps [N] and goals [g, N] of the episodes."""

    state: Array
    step: Array
    goal: Array


def over_lanes(function: Any, *axes: int | None) -> Any:
    """Map a function of one lane over the last axis of its arguments; None if shared."""
    return jax.vmap(function, in_axes=axes, out_axes=-1)


def fresh_lanes(problem: Problem, key: Key[Array, ""], num_lanes: int, explore: float) -> Lanes:
    """Return new episodes: a share of lanes anywhere at any time, the others at a start."""
    mdp = problem.mdp
    key_task, key_state, key_step = jax.random.split(key, 3)
    start, goal = over_lanes(mdp.sample_task, 0)(jax.random.split(key_task, num_lanes))
    anywhere = over_lanes(mdp.sample_state, 0)(jax.random.split(key_state, num_lanes))
    step = jax.random.randint(key_step, (num_lanes,), 0, mdp.num_steps, jnp.int32)
    explores = jnp.arange(num_lanes) < explore * num_lanes
    lanes = Lanes(jnp.where(explores, anywhere, start), jnp.where(explores, step, 0), goal)
    begins = over_lanes(partial(can_begin, problem), -1, -1)(lanes.state, lanes.goal)
    return jax.tree.map(lambda x: x[..., _replacements(begins)], lanes)


def check_lanes(problem: Problem, num_lanes: int, seed: int) -> None:
    """Raise ValueError where hardly any episode that the MDP samples can begin."""
    lanes = fresh_lanes(problem, jax.random.key(seed), num_lanes, 0.5)
    if not over_lanes(partial(can_begin, problem), -1, -1)(lanes.state, lanes.goal).all():
        raise ValueError(
            f"{type(problem.mdp).__name__}.sample_task and sample_state give no state "
            "outside the known constraints from which an episode can go on: write your own"
        )


def _replacements(allowed: Bool[Array, " N"]) -> Int[Array, " N"]:
    """Return for each lane its own number if it is allowed, else the next allowed lane's."""
    num_lanes = allowed.shape[0]
    lanes = jnp.arange(num_lanes, dtype=jnp.int32)
    twice = jnp.arange(2 * num_lanes, dtype=jnp.int32)
    ahead = jnp.where(jnp.concatenate([allowed, allowed]), twice, 2 * num_lanes)
    following = jax.lax.cummin(ahead, reverse=True)[:num_lanes]
    return jnp.where(following < 2 * num_lanes, following % num_lanes, lanes)
