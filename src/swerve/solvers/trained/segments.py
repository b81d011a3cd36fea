"""Roll out segments of episodes in all lanes, and cut them into minibatches for networks.

A lane continues its episode from segment to segment until the episode ends. With `restart`, lanes
that explore start anew, anywhere at any time, with every segment.

Shapes: N lanes, L steps of a segment, G minibatches, A actions. The batch is the last axis of every
array.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from swerve.problem.problem import Problem
from swerve.simulation.trajectory import sample_action, take_step
from swerve.solvers.trained.lanes import Lanes, fresh_lanes, over_lanes

GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # multiples of GOLDEN modulo 1 spread evenly, however many


class Sizes(Protocol):
    """The settings that a segment depends on."""

    @property
    def num_lanes(self) -> int:
        """N."""
        ...

    @property
    def segment(self) -> int:
        """L."""
        ...

    @property
    def explore(self) -> float:
        """Share of the lanes that start anywhere at any time."""
        ...


class Segment(NamedTuple):
    """The steps of a rollout, all [L, ..., N].

    Attributes:
      seen: numbers that `look` keeps of each step.
      action: index of the executed action.
      log_probability: log-probability of the executed action, nats.
      reward: r(s, a, s') and r_T; -inf on entering a known constraint.
      ended: whether the episode ended with this step.
      lanes: where the lanes were before the step.
    """

    seen: Any
    action: Array
    log_probability: Array
    reward: Array
    ended: Array
    lanes: Lanes


def roll_segment(
    problem: Problem,
    sizes: Sizes,
    look: Callable[[Lanes, Array], tuple[Array, Any]],
    lanes: Lanes,
    key: Key[Array, ""],
    *,
    restart: bool,
) -> tuple[Lanes, Segment]:
    """Roll out one segment in all lanes; a lane whose episode ends goes on with a new episode.

    Args:
      problem: the MDP and known constraints.
      sizes: number of lanes, share of the lanes that explore, and number of steps.
      look: gives for one lane log pi of every action, and numbers to keep. Its second argument is a
        number from 0 to 1 that stays with the lane; the numbers of all lanes are spread evenly.
      lanes: where the lanes are.
      key: source of randomness.
      restart: whether lanes that explore start anew.

    Returns:
      Where the lanes are after the segment, and the segment.
    """
    key_fresh, key_actions = jax.random.split(key)
    num_lanes = sizes.num_lanes
    fresh = jax.vmap(lambda key: fresh_lanes(problem, key, num_lanes, sizes.explore))(
        jax.random.split(key_fresh, sizes.segment)
    )
    uniforms = jax.random.uniform(key_actions, (sizes.segment, num_lanes), jnp.float32)
    explores = (jnp.arange(num_lanes) < sizes.explore * num_lanes) & restart
    lanes = jax.tree.map(lambda new, old: jnp.where(explores, new[0], old), fresh, lanes)

    place = (jnp.arange(num_lanes, dtype=jnp.float32) * GOLDEN) % 1.0

    def advance(lanes: Lanes, fresh: Lanes, uniform: Array, place: Array) -> tuple[Lanes, Segment]:
        log_probabilities, seen = look(lanes, place)
        action, log_probability = sample_action(log_probabilities, uniform)
        taken = take_step(problem, lanes.state, action, lanes.step, lanes.goal)
        moved = Lanes(taken.state, lanes.step + 1, lanes.goal)
        following = jax.tree.map(partial(jnp.where, taken.ended), fresh, moved)
        return following, Segment(seen, action, log_probability, taken.reward, taken.ended, lanes)

    return jax.lax.scan(
        lambda lanes, x: over_lanes(advance, -1, -1, -1, -1)(lanes, *x, place),
        lanes,
        (fresh, uniforms),
    )


def minibatches(column: Array, num_minibatches: int) -> Array:
    """Return a segment's [L, ..., N] as [G, ..., L N / G], its steps far apart."""
    column = column.reshape(-1, num_minibatches, *column.shape[1:])
    column = jnp.moveaxis(column, 0, -2)
    return column.reshape(*column.shape[:-2], -1)
