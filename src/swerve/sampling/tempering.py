"""Temper trajectories of pi_0: take them from one inverse temperature to another.

    pi_b(xi) = m exp(b R(xi)) / Z_b,        Z_b' / Z_b = E_b[exp((b' - b) R)]

(the paper, Theorem 2, by way of temperatures between). The policy samples trajectories, which are
weighed for the problem's beta. Each further b is chosen such that half of the trajectories stay
effective. At each b the trajectories are resampled and moved: a trajectory is cut at some step and
grown anew from there by the policy, and the new trajectory is accepted with probability
min(1, exp(l' - l)), l = b R + log m - log pi (Metropolis and Hastings; the part before the cut
cancels). Roots tell which of the first trajectories are left; a trajectory that is grown anew from
the start becomes its own root.

Shapes: N = I P trajectories in I islands, T steps, n state dimensions, g goal dimensions. The batch
is the last axis of every array.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from swerve.base.space import Task
from swerve.evidence import estimators
from swerve.problem.problem import Problem
from swerve.sampling.smc import Particles
from swerve.simulation.compiled import of_problem
from swerve.simulation.trajectory import Policy, Trajectory, sample_action, take_step

EFFECTIVE = 0.5  # share of the trajectories that stays effective from one temperature to the next
NUM_MOVES = 4  # moves of each trajectory at each temperature, cut at different parts of the horizon
MAX_TEMPERATURES = 300  # temperatures between two betas before giving up


class _Paths(NamedTuple):
    """Trajectories step by step: states [T+1, n, N], lengths [N], all others [T, N]."""

    states: Array
    actions: Array
    reward: Array
    log_probability: Array
    length: Array


def temper(
    problem: Problem,
    policy: Policy,
    task: Task,
    beta: float,
    *,
    num_islands: int,
    num_particles: int,
    seed: int,
) -> Particles:
    """Sample islands of trajectories of pi_0 at an inverse temperature other than the problem's.

    Args:
      problem: the MDP, its beta, the measure and the known constraints.
      policy: near pi_0 at the problem's beta.
      task: start [n] and goal [g].
      beta: inverse temperature of the trajectories to return.
      num_islands: I.
      num_particles: P of an island.
      seed: seed of everything random.

    Returns:
      N = I P particles, island by island; the particles of an island have the same weight.

    Raises:
      TemperingError: if the trajectories do not reach beta in MAX_TEMPERATURES temperatures.
    """
    chains = _Chains(problem, policy, task, num_islands, num_particles, seed)
    chains.resample(chains.log_weight(chains.paths, problem.beta))
    at = problem.beta
    for _ in range(MAX_TEMPERATURES):
        if not chains.is_alive.any():
            return chains.particles
        chains.move(at)
        step = _next_step(chains.reward[chains.is_alive], beta - at)
        chains.resample(step * chains.reward)
        if step == beta - at:
            chains.move(beta)
            return chains.particles
        at += step
    raise TemperingError(
        f"tempering from beta {problem.beta:g} towards {beta:g} reached only {at:g} in "
        f"{MAX_TEMPERATURES} temperatures: learn at a beta nearer to {beta:g}"
    )


class TemperingError(ValueError):
    """Too many temperatures lie between the problem's beta and the beta asked for."""


class _Chains:
    """Trajectories that are resampled and moved.

    Attributes:
      paths: the N trajectories.
      log_mean: [I] log of the product of the mean weights at each resampling so far, nats.
      root: [N] number, within its island, of the first trajectory that each comes from.
    """

    def __init__(
        self,
        problem: Problem,
        policy: Policy,
        task: Task,
        num_islands: int,
        num_particles: int,
        seed: int,
    ) -> None:
        self.problem, self.policy = problem, policy
        self.goal = jnp.asarray(task.goal, jnp.float32)
        self.generator = np.random.default_rng(seed)
        self.own = np.tile(np.arange(num_particles), num_islands)
        self.root, self.log_mean = self.own, np.zeros(num_islands)
        self.paths = self.grow(_unmoved(problem, task, len(self.own)), 0)

    @property
    def is_alive(self) -> np.ndarray:
        """[N] whether a trajectory's island has a trajectory that enters no known constraint."""
        return np.isfinite(self.log_mean).repeat(len(self.own) // len(self.log_mean))

    @property
    def reward(self) -> np.ndarray:
        """[N] R(xi), 0 for trajectories that enter a known constraint: their islands are dead."""
        reward = _sum(self.paths.reward)
        return np.where(np.isneginf(reward), 0.0, reward)

    @property
    def particles(self) -> Particles:
        """The trajectories with their weights."""
        paths = self.paths
        trajectory = Trajectory(
            paths.states,
            paths.actions,
            jnp.sum(paths.reward, axis=0),
            jnp.sum(paths.log_probability, axis=0),
            paths.length,
        )
        log_weight = np.repeat(self.log_mean, len(self.own) // len(self.log_mean))
        return Particles(trajectory, jnp.asarray(log_weight), jnp.asarray(self.root))

    def log_weight(self, paths: _Paths, beta: float) -> np.ndarray:
        """Return l = beta R + log m - log pi [N], nats."""
        record = self.problem.record
        return estimators.log_weights(
            _sum(paths.reward),
            _sum(paths.log_probability),
            np.asarray(paths.length),
            beta=beta,
            measure=record.measure,
            num_actions=record.num_actions,
        )

    def grow(self, paths: _Paths, cut: int) -> _Paths:
        """Return the trajectories grown anew from step `cut` on."""
        key = jax.random.key(self.generator.integers(2**32))
        return _grow(self.problem, self.policy, paths, self.goal, jnp.int32(cut), key)

    def move(self, beta: float) -> None:
        """Move each trajectory NUM_MOVES times: cut at the start, late and in between."""
        num_steps = self.problem.mdp.num_steps
        log_weight = self.log_weight(self.paths, beta)
        for k in self.generator.permutation(NUM_MOVES):
            cut = int((k + self.generator.random()) / NUM_MOVES * num_steps) if k else 0
            grown = self.grow(self.paths, cut)
            proposed = self.log_weight(grown, beta)
            threshold = np.log(self.generator.random(len(self.own))) + log_weight
            accepted = proposed > threshold
            keep = partial(jnp.where, jnp.asarray(accepted))
            self.paths = jax.tree.map(keep, grown, self.paths)
            log_weight = np.where(accepted, proposed, log_weight)
            if cut == 0:
                self.root = np.where(accepted, self.own, self.root)

    def resample(self, log_weight: np.ndarray) -> None:
        """Resample every island by weight, systematically; a dead island stays as it is."""
        num_islands = len(self.log_mean)
        islands = log_weight.reshape(num_islands, -1)
        num = islands.shape[1]
        largest = islands.max(axis=1, keepdims=True)
        cumulative = np.cumsum(np.exp(islands - np.where(np.isneginf(largest), 0.0, largest)), 1)
        total = cumulative[:, -1]
        points = (np.arange(num) + self.generator.random((num_islands, 1))) / num * total[:, None]
        chosen = np.array(list(map(partial(np.searchsorted, side="right"), cumulative, points)))
        chosen = np.where(total[:, None] > 0.0, np.minimum(chosen, num - 1), np.arange(num))
        chosen = (chosen + num * np.arange(num_islands)[:, None]).reshape(-1)
        with np.errstate(divide="ignore"):
            self.log_mean = self.log_mean + np.log(total / num) + largest[:, 0]
        self.paths = jax.tree.map(lambda x: x[..., chosen], self.paths)
        self.root = self.root[chosen]


def _next_step(reward: np.ndarray, rest: float) -> float:
    """Return the longest step of beta, at most the rest, that leaves enough effective samples."""

    def is_enough(step: float) -> bool:
        return estimators.effective_sample_size(step * reward) >= EFFECTIVE * len(reward)

    if is_enough(rest):
        return rest
    low, high = 0.0, rest
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_enough(middle) else (low, middle)
    return low


def _sum(column: Array) -> np.ndarray:
    """Return the sum [N] over steps of a column [T, N], in float64."""
    return np.asarray(column, np.float64).sum(axis=0)


def _unmoved(problem: Problem, task: Task, num: int) -> _Paths:
    """Return trajectories that have not left the start."""
    num_steps, start = problem.mdp.num_steps, jnp.asarray(task.start, jnp.float32)
    return _Paths(
        states=jnp.broadcast_to(start[:, None], (num_steps + 1, len(start), num)),
        actions=jnp.zeros((num_steps, num), jnp.int32),
        reward=jnp.zeros((num_steps, num), jnp.float32),
        log_probability=jnp.zeros((num_steps, num), jnp.float32),
        length=jnp.full(num, num_steps, jnp.int32),
    )


@of_problem
def _grow(
    problem: Problem,
    policy: Policy,
    paths: _Paths,
    goal: Float[Array, " g"],
    cut: Int[Array, ""],
    key: Key[Array, ""],
) -> _Paths:
    """Return trajectories grown anew by the policy from step `cut` on, unless they end before."""
    num_steps = problem.mdp.num_steps
    uniforms = jax.random.uniform(key, paths.actions.shape, jnp.float32)

    def step_one(state: Array, step: Array, uniform: Array) -> tuple:
        action, log_probability = sample_action(policy(state, step, goal), uniform)
        return action, log_probability, take_step(problem, state, action, step, goal)

    def step_all(step: Array, carry: tuple[_Paths, Array]) -> tuple[_Paths, Array]:
        paths, ended = carry
        state = paths.states[step]
        action, log_probability, taken = jax.vmap(step_one, (-1, None, -1), -1)(
            state, step, uniforms[step]
        )
        grown = _Paths(
            paths.states.at[step + 1].set(jnp.where(ended, state, taken.state)),
            paths.actions.at[step].set(action),
            paths.reward.at[step].set(jnp.where(ended, 0.0, taken.reward)),
            paths.log_probability.at[step].set(jnp.where(ended, 0.0, log_probability)),
            jnp.where(ended, paths.length, step + 1),
        )
        return grown, ended | taken.ended

    return jax.lax.fori_loop(cut, num_steps, step_all, (paths, paths.length <= cut))[0]
