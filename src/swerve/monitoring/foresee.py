"""Learn how likely each hypothesis is avoided from any state and time on.

The nominal policy continues trajectories from many states. Each state is labelled with the
hypotheses that the rest of its trajectory enters (see `sampling.labelled_states`). A network is
fitted to the labels of all hypotheses at once by weighted logistic regression,

    minimise  sum w [- y log P - (1 - y) log(1 - P)],    y = 1[the rest avoids c].

At the starts of tasks, the network is also fitted to the evidence.

Shapes: R labelled states, K tasks, G goals, H hypotheses, F inputs, n state dimensions, g goal
dimensions.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from swerve.base.arguments import instance, seed_number, whole_number
from swerve.base.forked import check_process
from swerve.base.progress import Advance, progress_bar
from swerve.base.solver_kinds import solver_names
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.bits import select, unpack
from swerve.monitoring.foresight import Ahead, Foresight, Inputs, hidden_sizes
from swerve.problem.problem import Problem
from swerve.problem.record import ProblemRecord
from swerve.sampling.labelled_states import LabelledStates, labelled_states
from swerve.simulation.continuation import continued
from swerve.simulation.trajectory import Policy
from swerve.solvers.base import Nominal, PolicyNominal
from swerve.solvers.trained.networks import DenseNetwork

LEAST_UPDATES, UPDATES_PER_GOAL = 10_000, 1_000  # updates of the network, by default
BATCH = 1024  # labelled states in each update
BLOCK = 100  # updates between two reports of progress
LEARNING_RATE = 3e-3  # of the first update; the rate falls to 0 at the last update
START_WEIGHT = 0.2  # weight of the loss at the starts of tasks, beside the loss of labelled states


class Rollouts:
    """Estimates by rollouts, for each state anew, the probabilities that a `Foresight` learns.

        P_0(avoid c from here on) ~ sum_k w_k 1[xi_k avoids c] / sum_k w_k

    Half a trajectory that avoids c and half a trajectory that enters c are added, so that no answer
    is -inf. Where every trajectory enters a known constraint, as from inside the constraint, all
    trajectories have equal weight.

    Args:
      nominal: nominal distribution of a solver with policies.
      num_trajectories: trajectories that are rolled out for each state.
      seed: seed of the trajectories.

    Raises:
      ValueError: if the nominal distribution has no policies, or a number is out of range.
    """

    def __init__(self, nominal: Nominal, num_trajectories: int = 1000, *, seed: int = 0) -> None:
        self._nominal = _with_policies(nominal)
        self._num = whole_number(num_trajectories, "num_trajectories", 1)
        self._seed = seed_number(seed)
        self.fingerprint = nominal.problem.record.fingerprint

    def towards(self, goal: np.ndarray) -> Ahead:
        """Return a function that estimates log P_0(avoid c from here on) for a goal [g]."""
        (policy,) = self._nominal.policies(np.asarray(goal, float)[None])
        return _RolledOut(self._nominal.problem, policy, goal, self._num, self._seed)


class _RolledOut:
    """Estimates for one goal; each call rolls out trajectories of its own."""

    def __init__(
        self, problem: Problem, policy: Policy, goal: np.ndarray, num: int, seed: int
    ) -> None:
        self._problem, self._policy, self._goal = problem, policy, goal
        self._num, self._key = num, jax.random.key(seed)

    def __call__(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return log P_0(avoid c from here on) [H], nats, for a state [n] at a step."""
        problem, num = self._problem, self._num
        record, target = problem.record, jnp.asarray(self._goal, jnp.float32)
        self._key, key_now = jax.random.split(self._key)
        starts = jnp.broadcast_to(jnp.asarray(state, jnp.float32)[:, None], (len(state), num))
        found = continued(problem, self._policy, starts, jnp.int32(step), target, key_now)
        states = np.moveaxis(np.asarray(found.states)[step:], -1, 0)
        bits = record.hypotheses.violations(states, record.space, problem.between_states)
        log_weight = np.asarray(found.log_weight[step], float)
        largest = log_weight.max()
        is_lost = largest == -np.inf
        weight = np.ones(num) if is_lost else np.exp(log_weight - largest)
        avoided = weight @ ~unpack(bits, len(record.hypotheses))
        share = weight.sum() / num
        return np.log((avoided + 0.5 * share) / (weight.sum() + share))


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
      nominal: nominal distribution of a solver with policies.
      evidence: evidence of the same problem; the foresight is learned for the goals of its tasks.
      num_trajectories: trajectories that are rolled out for each goal.
      num_updates: updates of the network; if None, 1,000 for each goal and at least 10,000.
      seed: seed of all randomness.
      progress: whether to show a progress bar.

    Returns:
      The foresight that a `Monitor` needs, for the tasks of the evidence.

    Raises:
      ValueError: if an argument is of the wrong kind or range, the nominal distribution has no
        policies, the evidence is of another problem, or a hypothesis is about actions.
    """
    num_trajectories = whole_number(num_trajectories, "num_trajectories", 1)
    if num_updates is not None:
        num_updates = whole_number(num_updates, "num_updates", 1)
    seed = seed_number(seed)
    nominal = _with_policies(nominal)
    record = nominal.problem.record
    _check_evidence(evidence, record)
    goals, goal_of = np.unique(evidence.tasks.goal, axis=0, return_inverse=True)
    goal_of = goal_of.reshape(-1)
    with progress_bar("looking ahead", 2.0 * len(goals), progress) as advance:
        states = labelled_states(nominal, evidence, goals, goal_of, num_trajectories, seed, advance)
    inputs = _inputs(record, goals)
    num_updates = num_updates or max(LEAST_UPDATES, UPDATES_PER_GOAL * len(goals))
    with progress_bar("learning", num_updates, progress) as advance:
        fit = _Fit(inputs, states, goals, evidence, goal_of)
        network = fit.run(num_updates, len(record.hypotheses), seed, advance)
    weights, biases = (
        tuple(np.asarray(x) for x in layers) for layers in (network.weights, network.biases)
    )
    return Foresight(record.fingerprint, evidence.digest, inputs, goals, weights, biases)


def _check_evidence(evidence: Evidence, record: ProblemRecord) -> None:
    """Raise ValueError where the argument is not evidence, or is of another problem."""
    instance(evidence, Evidence, "evidence", "make some with swerve.sample or swerve.Evidence.load")
    if record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"the evidence is of another problem, {evidence.problem.summary}, than the nominal, "
            f"{record.summary}"
        )


def _inputs(record: ProblemRecord, goals: np.ndarray) -> Inputs:
    """Return the network's inputs for goals [G, g]; the inputs scale these to about 1."""
    return Inputs(
        record.space,
        record.goal_names == record.space.names,
        goals.mean(axis=0),
        np.maximum(goals.std(axis=0), 1e-3 + 1e-3 * np.abs(goals).max(axis=0)),
        record.num_steps,
    )


def _with_policies(nominal: Nominal) -> PolicyNominal:
    """Return the nominal distribution if its trajectories can be sampled.

    Raises:
      ValueError: if the nominal distribution has no policies, or hypotheses are about actions,
        which a monitor does not see.
    """
    check_process()
    if not isinstance(nominal, PolicyNominal):
        names = ", ".join(solver_names(lambda kind: not kind.is_exact))
        raise ValueError(
            f"nominal: expected one of a solver that is sampled ({names}), got {nominal!r}"
        )
    if nominal.problem.hypotheses.about_actions:
        raise ValueError(
            "nominal: some hypotheses of its problem are about actions, which a monitor that sees "
            "states alone cannot judge: leave them out"
        )
    return nominal


class _Fit:
    """The network's fit to labelled states, and to the evidence at the starts of tasks."""

    def __init__(
        self,
        inputs: Inputs,
        states: LabelledStates,
        goals: np.ndarray,
        evidence: Evidence,
        goal_of: np.ndarray,
    ) -> None:
        self.inputs, self.num_states = inputs, len(states.step)
        self.states = jax.tree.map(jnp.asarray, states)
        self.goals = jnp.asarray(goals, jnp.float32)
        starts = jnp.asarray(evidence.tasks.start, jnp.float32)
        steps = jnp.zeros(len(starts), jnp.float32)
        self.at_starts = inputs(starts, steps, self.goals[goal_of])
        self.known = jnp.asarray(np.exp(evidence.log_ratio), jnp.float32)
        weight, share = states.weight[:, None], np.zeros(self.known.shape[1])
        for first in range(0, self.num_states, 1 << 14):
            block = slice(first, first + (1 << 14))
            share += (weight[block] * unpack(states.entered[block], len(share))).sum(axis=0)
        self.entered = np.clip(share / weight.sum(), 1e-4, 1.0 - 1e-4)

    def run(
        self, num_updates: int, num_hypotheses: int, seed: int, advance: Advance
    ) -> DenseNetwork:
        """Return the network after a number of updates."""
        sizes = (self.at_starts.shape[1], *hidden_sizes(num_hypotheses), num_hypotheses)
        key_network, key = jax.random.split(jax.random.key(seed))
        network = DenseNetwork(sizes, 0.1, key=key_network)
        # begin with each hypothesis's log-odds over all states: only differences are left to learn
        log_odds = np.log1p(-self.entered) - np.log(self.entered)
        network.biases[-1] = jnp.asarray(log_odds, jnp.float32)
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
            network, state = block(network, state, jax.random.fold_in(key, k), jnp.int32(num))
            advance(num)
        return network

    def loss(self, network: DenseNetwork, key: Array) -> Array:
        """Return the mean cross-entropy of a random minibatch, and of the starts of tasks."""
        chosen = jax.random.randint(key, (BATCH,), 0, self.num_states, jnp.int32)
        batch = jax.tree.map(lambda column: column[chosen], self.states)
        x = self.inputs(batch.state, batch.step.astype(jnp.float32), self.goals[batch.goal])
        num_hypotheses = self.known.shape[1]
        entered = select(batch.entered, jnp.arange(num_hypotheses))
        loss = _cross_entropy(_outputs(network, x), 1.0 - entered.astype(jnp.float32))
        total = jnp.maximum(batch.weight.sum(), 1e-6)
        sampled = (batch.weight[:, None] * loss).sum() / total
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
