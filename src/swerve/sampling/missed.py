"""Look for modes of pi_0 that sampling misses, with trajectories that deviate from the policy.

Where a soft value is far too low, or a policy never takes some actions, no sampled trajectory goes
there. All weights then look perfect, and the share of pi_0 that lies there is missing. Explorers
therefore follow

    q(a | s, t) = (1 - eps) softmax_a(log pi(a | s, t) / temperature) + eps / A,

without resampling. Each has an exact weight, so that the mean of

    exp(sum_t g_t) / Z_0,    g_t = beta r + log m - log q,

over the explorers is an unbiased estimate of the share of pi_0 that lies in any region. Where the
density of the samples is exp(-D) of that of pi_0, there are N exp(-D) samples for each unit of the
share. With weights alone D = log pi_0(xi) - log pi(xi). With resampling, particles at step t have
the density

    pi_t(s_0, ..., s_t) = exp(sum_{k < t} g_k + V_t(s_t)) q(s_0, ..., s_t) / Z_t

and choose their action by pi, so that

    D = max_t [beta r + log m - log pi + W_{t+1} - V_t(s_t) + log Z_t] - log Z_0,
    W_t = sum_{k >= t} [beta r + log m - max(log q, log pi)].

W is at most V in expectation, and at most V on every path if V is exact: D is then 0 or less, and
nothing is missed. Take the explorers of the largest D, with share f in all: pi_0 is missed there if
the density of the samples is SPARSE of that of pi_0, or less, and fewer than SURELY_SEEN samples,
of N exp(-D) f, are expected.

Shapes: M explorers, T steps, A actions.
"""

from __future__ import annotations

import math
import zlib
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from swerve.base.space import Task
from swerve.evidence.samples import RESAMPLED, TEMPERED
from swerve.problem.problem import Problem
from swerve.sampling.one_task import SamplingJob
from swerve.simulation.compiled import of_problem
from swerve.simulation.policies import LOWEST, ValuedPolicy, log_measure
from swerve.simulation.trajectory import Policy, sample_action, take_step

NUM_EXPLORERS = 512  # trajectories: finds what holds a percent of pi_0, and costs little time
NUM_DEVIATIONS = 2.0  # expected number of random actions in an episode of an explorer
MOST_RANDOM = 0.5  # eps at most, where episodes are short
TEMPERATURES = (1.0, 10.0)  # of the policy, in turn: a policy may be too sure of itself
SPARSE = 0.05  # share of the density of pi_0: samples as sparse as this are not enough
SURELY_SEEN = 3.0  # trajectories: none is sampled with a probability of exp(-3) = 5 %


def share_missed(job: SamplingJob, log_partition: float) -> float:
    """Estimate the share of pi_0, from 0 to 1, that the samples of a task miss.

    Args:
      job: how the task was sampled.
      log_partition: log Z_0 by the samples, nats.

    Returns:
      The share; NaN where the samples have another beta than the policy, or all explorers enter a
      known constraint.
    """
    if job.method == TEMPERED:
        return math.nan
    numbers = np.concatenate([job.task.start, job.task.goal])
    key = jax.random.fold_in(jax.random.key(job.seed), zlib.crc32(b"explore" + numbers.tobytes()))
    explored = explore(job.problem, job.policy, job.task, key)
    is_resampled = job.method in RESAMPLED
    return missed_share(explored, log_partition, job.num_trajectories, is_resampled)


class Explored(NamedTuple):
    """Terms of the log-weights of M explorers, for each of T steps [T, M], nats.

    Attributes:
      gain: beta r + log m - log q; -inf where a known constraint is entered, 0 after the end.
      policy_gain: the same with log pi in place of log q.
      value: V_t(s_t) by the policy; 0 without a soft value, and after the end.
    """

    gain: Float[Array, "T M"]
    policy_gain: Float[Array, "T M"]
    value: Float[Array, "T M"]


def explore(problem: Problem, policy: Policy, task: Task, key: Key[Array, ""]) -> Explored:
    """Roll out explorers of one task.

    Args:
      problem: the MDP, beta, the measure and the known constraints.
      policy: policy that the explorers deviate from.
      task: start [n] and goal [g].
      key: source of randomness.
    """
    start, goal = (jnp.asarray(values, jnp.float32) for values in task)
    return _explore(problem, policy, start, goal, key)


def missed_share(
    explored: Explored, log_partition: float, num_trajectories: int, is_resampled: bool
) -> float:
    """Estimate the share of pi_0, from 0 to 1, in which no trajectory is expected to be sampled.

    The share is NaN where all explorers enter a known constraint.

    Args:
      explored: the explorers.
      log_partition: log Z_0 by the samples, nats.
      num_trajectories: N, the number of samples.
      is_resampled: whether the samples are those of sequential Monte Carlo.
    """
    gain, policy_gain, value = (np.asarray(part, np.float64) for part in explored)
    is_lost = np.isneginf(gain).any(axis=0)  # they weigh nothing, whatever the policy does
    if is_lost.all():  # nothing was explored
        return math.nan
    policy_gain = np.where(is_lost, gain, policy_gain)
    log_weight = gain.sum(axis=0) - log_partition
    scarcity = policy_gain.sum(axis=0) - log_partition
    if is_resampled:
        log_mean = np.logaddexp.reduce(_before(gain) + value, axis=1) - math.log(gain.shape[1])
        after = _before(np.minimum(gain, policy_gain)[::-1])[::-1]
        ahead = policy_gain + after - value + log_mean[:, None]
        scarcity = ahead.max(axis=0) - log_partition
    order = np.argsort(-scarcity)
    log_share = np.logaddexp.accumulate(log_weight[order]) - math.log(len(order))
    log_expected = math.log(num_trajectories) - scarcity[order] + log_share
    missed = (log_expected < math.log(SURELY_SEEN)) & (scarcity[order] > -math.log(SPARSE))
    log_missed = log_share[missed].max(initial=-math.inf)
    return float(np.exp(log_missed - np.logaddexp(0.0, log_missed)))


def _before(steps: np.ndarray) -> np.ndarray:
    """Return the sum of the steps before each step [T, M]."""
    return np.concatenate([np.zeros_like(steps[:1]), steps[:-1].cumsum(axis=0)])


@of_problem
def _explore(problem: Problem, policy: Policy, start: Array, goal: Array, key: Array) -> Explored:
    num_steps = problem.mdp.num_steps
    uniforms = jax.random.uniform(key, (num_steps, NUM_EXPLORERS), jnp.float32)
    temperatures = jnp.resize(jnp.asarray(TEMPERATURES, jnp.float32), (NUM_EXPLORERS,))
    advance = jax.vmap(partial(_advance, problem, policy), (-1, -1, None, None, -1, -1), -1)

    def body(carry: tuple[Array, Array], x: tuple) -> tuple[tuple[Array, Array], Explored]:
        step, uniform = x
        state, ended, explored = advance(*carry, goal, step, temperatures, uniform)
        return (state, ended), explored

    states = jnp.broadcast_to(start[:, None], (len(start), NUM_EXPLORERS))
    initial = (states, jnp.zeros(NUM_EXPLORERS, bool))
    return jax.lax.scan(body, initial, (jnp.arange(num_steps, dtype=jnp.int32), uniforms))[1]


def _advance(
    problem: Problem,
    policy: Policy,
    state: Array,
    ended: Array,
    goal: Array,
    step: Array,
    temperature: Array,
    uniform: Array,
) -> tuple[Array, Array, Explored]:
    """Take one step with one explorer, unless its episode has ended."""
    if isinstance(policy, ValuedPolicy):
        log_pi, value = policy.propose(state, step, goal)
    else:
        log_pi, value = policy(state, step, goal), jnp.zeros((), jnp.float32)
    mdp = problem.mdp
    random = min(MOST_RANDOM, NUM_DEVIATIONS / mdp.num_steps)
    proposed = jnp.logaddexp(
        math.log1p(-random) + jax.nn.log_softmax(log_pi / temperature),
        math.log(random / mdp.num_actions),
    )
    # a state that the policy never visits may have no probabilities: then all actions are random
    is_lost = jnp.isnan(proposed).any()
    proposed = jnp.where(is_lost, -math.log(mdp.num_actions), proposed)
    log_pi = jnp.where(is_lost, -jnp.inf, log_pi)
    action, log_q = sample_action(proposed, uniform)
    taken = take_step(problem, state, action, step, goal)
    allowed = ~jnp.isneginf(taken.reward)
    earned = problem.beta * jnp.where(allowed, taken.reward, 0.0) - log_measure(problem)
    earned = jnp.where(allowed, earned, -jnp.inf)
    policy_gain = jnp.where(allowed, earned - log_pi[action], -jnp.inf)
    now = Explored(earned - log_q, policy_gain, jnp.maximum(value, LOWEST))
    return (
        jnp.where(ended, state, taken.state),
        ended | taken.ended,
        Explored(*(jnp.where(ended, 0.0, x) for x in now)),
    )
