"""Learning how likely each hypothesis is avoided from any state and time on.

The nominal policy goes on from states all over the state space, at all times; more of them near
where nominal trajectories pass, and not quite there, which is where those go who avoid something.
What the rest of each trajectory enters, from several of its states on, labels these states for
all hypotheses at once, and a network is fitted by weighted logistic regression,

    minimise  sum w [- y log P - (1 - y) log(1 - P)],    y = 1[the rest avoids c],
    w = exp(l)    (see `continuation`; 1 where the policy is pi_0).

At the starts of tasks it is told what the evidence knows.

Shapes: R rows, N trajectories at once, K tasks, G goals, H hypotheses, B = ceil(H / 8) bytes,
T steps, n state dimensions, g goal dimensions.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from swerve.base.arguments import instance, whole_number
from swerve.base.progress import Advance, progress_bar
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import unpack
from swerve.monitoring.foresight import Ahead, Foresight, Inputs, hidden_sizes
from swerve.problem.problem import Problem
from swerve.simulation.continuation import continued
from swerve.simulation.trajectory import Policy, enters
from swerve.solvers.learn import Nominal, PolicyNominal
from swerve.solvers.trained.networks import DenseNetwork

AT_ONCE = 256  # trajectories that go on from the same step
NUM_SUFFIXES = 8  # states of each trajectory from which the rest is judged
NEARBY = (0.005, 0.15)  # how far from nominal trajectories, in extents, the near starts lie
SHARES = (0.5, 0.85)  # of the starts, cumulated: near nominal trajectories, anywhere; rest: tasks'
LEAST_UPDATES, UPDATES_PER_GOAL = 10_000, 1_000
BATCH = 1024
BLOCK = 100  # updates between two reports
LEARNING_RATE = 3e-3
# Where a policy is coarse (11 nodes an axis) heavy trajectories drown the others: the network is
# off by 0.024 to 0.031 on average with limits from 1 to 4, by 0.037, 0.052 and 0.060 with 5, 7 and
# 40. Of the former a high one leaves less bias where a policy is poor: shares of 20,000 rollouts of
# a soft value learned for 200,000 steps are off by 0.053 unweighted, 0.023 with 1, 0.011 with 3.
MAX_LOG_WEIGHT = 3.0  # nats
START_WEIGHT = 0.2  # of what the evidence knows of the starts, beside all that was sampled


class Rows(NamedTuple):
    """Labelled states.

    Attributes:
      state: [R, n].
      step: [R].
      goal: [R] number of the goal.
      entered: [R, B] packed bits: what the rest enters.
      weight: [R].
    """

    state: np.ndarray
    step: np.ndarray
    goal: np.ndarray
    entered: np.ndarray
    weight: np.ndarray


class Rollouts:
    """What `Foresight` tells, rolled out on the spot: nothing is learned, each answer takes longer.

        P_0(avoid c from here on) ~ sum_k w_k 1[xi_k avoids c] / sum_k w_k

    One more trajectory that avoids c is added, so that no answer is -inf. Where every one enters a
    known constraint, as from inside it, all count alike.

    Args:
      nominal: of a solver with policies.
      num_trajectories: for each answer.
      seed: of the trajectories.

    Raises:
      ValueError: if the nominal has no policies, or a number is out of range.
    """

    def __init__(self, nominal: Nominal, num_trajectories: int = 1000, *, seed: int = 0) -> None:
        self._nominal = _with_policies(nominal)
        self._num = whole_number(num_trajectories, "num_trajectories", 1)
        self._key = jax.random.key(whole_number(seed, "seed", 0))
        self.fingerprint = nominal.problem.record.fingerprint

    def towards(self, goal: np.ndarray) -> Ahead:
        """Return what tells it for a goal [g]."""
        problem, num = self._nominal.problem, self._num
        record, target = problem.record, jnp.asarray(goal, jnp.float32)
        (policy,) = self._nominal.policies(np.asarray(goal, float)[None])
        key = self._key

        def ahead(state: np.ndarray, step: int) -> np.ndarray:
            nonlocal key
            key, key_now = jax.random.split(key)
            starts = jnp.broadcast_to(jnp.asarray(state, jnp.float32)[:, None], (len(state), num))
            found = continued(problem, policy, starts, jnp.asarray(step), target, key_now)
            states = np.moveaxis(np.asarray(found.states)[step:], -1, 0)
            bits = record.hypotheses.violations(states, record.space, problem.between_states)
            log_weight = np.asarray(found.log_weight[step], float)
            largest = log_weight.max()
            is_lost = largest == -np.inf
            weight = np.ones(num) if is_lost else np.exp(log_weight - largest)
            avoided = weight @ ~unpack(bits, len(record.hypotheses))
            share = weight.sum() / num
            return np.log((avoided + 0.5 * share) / (weight.sum() + share))

        return ahead


def foresee(
    nominal: Nominal,
    evidence: Evidence,
    *,
    num_trajectories: int = 6000,
    num_updates: int | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Foresight:
    """Learn how likely each hypothesis is avoided from any state and time on.

    Args:
      nominal: of a solver with policies.
      evidence: of the same problem; its goals are learned.
      num_trajectories: rolled out for each goal.
      num_updates: of the network; 1,000 for each goal and at least 10,000 if None.
      seed: of everything random.
      progress: whether to show a progress bar.

    Returns:
      What `Monitor` needs, for the tasks of the evidence.

    Raises:
      ValueError: if an argument is of the wrong kind or range, the nominal has no policies, the
        evidence is of another problem, or a hypothesis is about actions.
    """
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    nominal = _with_policies(nominal)
    num_trajectories = whole_number(num_trajectories, "num_trajectories", 1)
    if num_updates is not None:
        num_updates = whole_number(num_updates, "num_updates", 1)
    seed = whole_number(seed, "seed", 0)
    record = nominal.problem.record
    if record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"the evidence is of another problem, {evidence.problem.summary}, than the nominal, "
            f"{record.summary}"
        )
    goals, goal_of = np.unique(evidence.tasks.goal, axis=0, return_inverse=True)
    goal_of = goal_of.reshape(-1)
    with progress_bar("looking ahead", 2.0 * len(goals), progress) as advance:
        rows = _rows(nominal, evidence, goals, goal_of, num_trajectories, seed, advance)
    inputs = Inputs(
        record.space,
        record.goal_names == record.space.names,
        goals.mean(axis=0),
        np.maximum(goals.std(axis=0), 1e-3 + 1e-3 * np.abs(goals).max(axis=0)),
        record.num_steps,
    )
    num_hypotheses = len(record.hypotheses)
    num_updates = num_updates or max(LEAST_UPDATES, UPDATES_PER_GOAL * len(goals))
    with progress_bar("learning", num_updates, progress) as advance:
        fit = _Fit(inputs, rows, goals, evidence, goal_of)
        network = fit.run(num_updates, num_hypotheses, seed, advance)
    return Foresight(
        record.fingerprint,
        evidence.digest,
        inputs,
        goals,
        tuple(np.asarray(weight) for weight in network.weights),
        tuple(np.asarray(bias) for bias in network.biases),
    )


def _with_policies(nominal: Nominal) -> PolicyNominal:
    """Return a nominal that trajectories can be drawn from.

    Raises:
      ValueError: if it is none, or hypotheses are about actions, which a monitor does not see.
    """
    if not isinstance(nominal, PolicyNominal):
        raise ValueError(
            "nominal: expected one of a solver that is sampled (grid, soft-value, distilled, ppo), "
            f"got {nominal!r}"
        )
    if nominal.problem.hypotheses.about_actions:
        raise ValueError(
            "nominal: some hypotheses of its problem are about actions, which a monitor that sees "
            "states alone cannot judge: leave them out"
        )
    return nominal


def _rows(
    nominal: PolicyNominal,
    evidence: Evidence,
    goals: np.ndarray,
    goal_of: np.ndarray,
    num_trajectories: int,
    seed: int,
    advance: Advance,
) -> Rows:
    """Return labelled states of all goals."""
    generator = np.random.default_rng(seed)
    num_chunks = max(1, -(-num_trajectories // AT_ONCE))
    parts = []
    for goal, policy in enumerate(nominal.policies(goals, advance)):
        tasks = np.flatnonzero(goal_of == goal)
        kept = np.concatenate(list(evidence.samples.kept[tasks]))
        # one in each part of the time, so that no time is left out
        steps = (np.arange(num_chunks) + generator.random(num_chunks)) / num_chunks
        steps = (steps * nominal.problem.mdp.num_steps).astype(int)
        steps[0] = 0
        for step in steps.tolist():
            starts = _starts(nominal.problem, kept, evidence.tasks.start[tasks], step, generator)
            key = jax.random.key(int(generator.integers(2**31)))
            parts.append(_labelled(nominal.problem, policy, starts, step, goals, goal, key))
        advance(1.0)
    return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _starts(
    problem: Problem,
    kept: np.ndarray,
    starts: np.ndarray,
    step: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """Return states [N, n] from which to go on at a step.

    Args:
      problem: whose states they are.
      kept: [M, T+1, n] nominal trajectories.
      starts: [K, n] of tasks.
      step: at which.
      generator: what is random.
    """
    num_near, num_before_tasks = (int(share * AT_ONCE) for share in SHARES)
    space, now = problem.mdp.space, kept[:, step]
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
) -> Rows:
    """Go on from states [N, n] at a step; return several states of each trajectory, labelled."""
    record, num_steps = problem.record, problem.mdp.num_steps
    target = jnp.asarray(goals[goal], jnp.float32)
    begin = jnp.asarray(starts.T, jnp.float32)
    key_cuts, key = jax.random.split(key)
    found = continued(problem, policy, begin, jnp.asarray(first), target, key)
    states = np.moveaxis(np.asarray(found.states), -1, 0)
    log_weight = np.asarray(found.log_weight)
    shares = np.sort(np.asarray(jax.random.uniform(key_cuts, (NUM_SUFFIXES - 1,))))
    cuts = np.unique([first, *(first + shares * (num_steps - first)).astype(int)])
    allowed = np.isfinite(states).all(axis=(1, 2)) & ~_is_forbidden(problem, begin)
    entered, rows = np.uint8(0), []
    for cut, end in reversed(list(zip(cuts, [*cuts[1:], num_steps], strict=True))):
        part = states[:, cut : end + 1]
        entered = entered | record.hypotheses.violations(part, record.space, record.between_states)
        weight = np.exp(np.minimum(log_weight[cut], MAX_LOG_WEIGHT))
        weight = np.where(allowed & np.isfinite(weight), weight, 0.0).astype(np.float32)
        num = len(states)
        rows.append(Rows(states[:, cut], np.full(num, cut), np.full(num, goal), entered, weight))
    return Rows(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _is_forbidden(problem: Problem, states: Array) -> np.ndarray:
    """Return which states [n, N] lie in a known constraint: a step that stays there enters it."""
    stays = jax.vmap(lambda state: enters(problem.known, state, state, problem.mdp, False), -1)
    return np.asarray(stays(states))


class _Fit:
    """Fitting the network to labelled states."""

    def __init__(
        self, inputs: Inputs, rows: Rows, goals: np.ndarray, evidence: Evidence, goal_of: np.ndarray
    ) -> None:
        self.inputs, self.num_rows = inputs, len(rows.step)
        self.rows = jax.tree.map(jnp.asarray, rows)
        self.goals = jnp.asarray(goals, jnp.float32)
        starts = jnp.asarray(evidence.tasks.start, jnp.float32)
        steps = jnp.zeros(len(starts))
        self.at_starts = inputs(starts, steps, self.goals[goal_of])
        self.known = jnp.asarray(np.exp(evidence.log_ratio), jnp.float32)
        weight, share = rows.weight[:, None], np.zeros(self.known.shape[1])
        for first in range(0, self.num_rows, 1 << 14):
            block = slice(first, first + (1 << 14))
            share += (weight[block] * unpack(rows.entered[block], len(share))).sum(axis=0)
        self.entered = np.clip(share / weight.sum(), 1e-4, 1.0 - 1e-4)

    def run(
        self, num_updates: int, num_hypotheses: int, seed: int, advance: Advance
    ) -> DenseNetwork:
        """Return the network after so many updates."""
        sizes = (self.at_starts.shape[1], *hidden_sizes(num_hypotheses), num_hypotheses)
        key_network, key = jax.random.split(jax.random.key(seed))
        network = DenseNetwork(sizes, 0.1, key=key_network)
        # what holds whatever the state, which then need not be learned
        network.biases[-1] = jnp.asarray(np.log1p(-self.entered) - np.log(self.entered))
        schedule = optax.cosine_decay_schedule(LEARNING_RATE, num_updates)
        optimiser = optax.adam(schedule)
        state = optimiser.init(network)  # pyright: ignore[reportArgumentType]

        @jax.jit
        def block(network: Any, state: Any, key: Array, num: Array) -> tuple[Any, Any]:
            def update(k: Array, carry: tuple) -> tuple:
                network, state = carry
                slope = jax.grad(self.loss)(network, jax.random.fold_in(key, k))
                change, state = optimiser.update(slope, state)
                return optax.apply_updates(network, change), state

            return jax.lax.fori_loop(0, num, update, (network, state))

        for k in range(math.ceil(num_updates / BLOCK)):
            num = min(BLOCK, num_updates - k * BLOCK)
            network, state = block(network, state, jax.random.fold_in(key, k), jnp.asarray(num))
            advance(num)
        return network

    def loss(self, network: DenseNetwork, key: Array) -> Array:
        """Return the mean cross-entropy of a minibatch drawn at random, and of the starts."""
        chosen = jax.random.randint(key, (BATCH,), 0, self.num_rows)
        rows = jax.tree.map(lambda column: column[chosen], self.rows)
        x = self.inputs(rows.state, rows.step.astype(jnp.float32), self.goals[rows.goal])
        num_hypotheses = self.known.shape[1]
        bit = jnp.arange(num_hypotheses)
        entered = (rows.entered[:, bit >> 3] >> (bit & 7).astype(jnp.uint8)) & 1
        loss = _cross_entropy(_outputs(network, x), 1.0 - entered.astype(jnp.float32))
        total = jnp.maximum(rows.weight.sum(), 1e-6)
        sampled = (rows.weight[:, None] * loss).sum() / total
        known = _cross_entropy(_outputs(network, self.at_starts), self.known).sum(axis=1).mean()
        return (sampled + START_WEIGHT * known) / num_hypotheses


def _outputs(network: DenseNetwork, x: Array) -> Array:
    """Return the outputs [R, H] for inputs [R, F]."""
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        x = jnp.tanh(x @ weight.T + bias)
    return x @ network.weights[-1].T + network.biases[-1]


def _cross_entropy(output: Array, avoided: Array) -> Array:
    """Return - y log P - (1 - y) log(1 - P) with P = 1 / (1 + exp(-z))."""
    return jnp.logaddexp(0.0, output) - avoided * output
