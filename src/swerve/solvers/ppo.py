"""Maximum-entropy proximal policy optimisation: one goal-conditioned policy for all tasks.

The paper's way to pi_0: maximise its eq. 6, where the log-probability of the executed action is
part of the return at weight 1 / beta, here with everything times beta, in nats. Half of the lanes
start anywhere at any time (exploring starts), half where tasks start; all continue their own
episode from segment to segment, and start anew when it ends. An iteration rolls out one segment in
every lane and takes a few epochs of steps on it; a run is one `scan` over iterations, cut into
chunks between which progress is shown and a checkpoint written.

Shapes: N lanes, L steps of a segment, G minibatches, A actions, F features, n states, g goal
dimensions. The batch is the last axis of every array.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from swerve import estimators, store
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.solvers import losses
from swerve.solvers.networks import DenseNetwork
from swerve.space import Task
from swerve.trajectory import draw_action, rollout, take_step

KIND = "swerve-ppo-checkpoint"
VERSION = 1
NUM_CHUNKS = 40
NUM_PROBE_TASKS = 8
NUM_PROBES = 128  # trajectories a task for the estimates shown while training
KNOWN_PENALTY = 100.0  # nats, where an episode ends in a known constraint
RATE_END = 0.01  # of the first learning rate, reached at the end


@dataclass(frozen=True)
class PPO:
    """Solver: maximum-entropy PPO.

    Attributes:
      num_steps: environment steps to train for.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G; must divide num_lanes.
      gae_lambda: of the advantages.
      clip: of the surrogate.
      learning_rate: at first, falling linearly to a hundredth.
      width: of the two hidden layers of the policy and of the value network.
      loss_scale: nats; losses are divided by 1 + |return| / this.
    """

    num_steps: int = 20_000_000
    num_lanes: int = 256
    segment: int = 32
    explore: float = 0.5
    num_epochs: int = 3
    num_minibatches: int = 8
    gae_lambda: float = 0.9
    clip: float = 0.2
    learning_rate: float = 3e-3
    width: int = 64
    loss_scale: float = 10.0

    name = "ppo"

    def __post_init__(self) -> None:
        for field in (
            "num_steps",
            "num_lanes",
            "segment",
            "num_epochs",
            "num_minibatches",
            "width",
        ):
            if getattr(self, field) < 1:
                raise ValueError(f"PPO: expected {field} >= 1, got {getattr(self, field)}")
        for field in ("explore", "gae_lambda"):
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(f"PPO: expected {field} in [0, 1], got {getattr(self, field)}")
        for field in ("clip", "learning_rate", "loss_scale"):
            if not getattr(self, field) > 0.0:
                raise ValueError(f"PPO: expected {field} > 0, got {getattr(self, field)}")
        if self.num_lanes % self.num_minibatches:
            raise ValueError(
                f"PPO: expected num_minibatches to divide num_lanes, got {self.num_minibatches} "
                f"and {self.num_lanes}"
            )

    @property
    def chunk_iterations(self) -> int:
        """Iterations between two checkpoints."""
        return max(1, round(self.num_steps / (self.num_lanes * self.segment * NUM_CHUNKS)))

    @property
    def chunk_steps(self) -> int:
        """Environment steps between two checkpoints."""
        return self.chunk_iterations * self.num_lanes * self.segment

    @property
    def num_chunks(self) -> int:
        """Chunks of a run: about NUM_CHUNKS."""
        return max(1, round(self.num_steps / self.chunk_steps))

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> PPONominal:
        """Train, or go on training from a checkpoint, and return the nominal distribution.

        Args:
          problem: what to learn.
          tasks: those on which KL and ESS are estimated for the progress bar; drawn if None.
          seed: of everything random.
          progress: whether to show a bar with steps per second, KL and ESS.
          checkpoint: file that is written after every chunk and resumed from; None for neither.

        Raises:
          ValueError: if the checkpoint is of another run, or training diverged.
        """
        trainer = _Trainer(problem, self, seed)
        state = trainer.initial_state()
        if checkpoint is not None and checkpoint.exists():
            state = _restore_checkpoint(checkpoint, trainer, state)
        done = int(state.iteration) // self.chunk_iterations
        probe = _Probe(problem, tasks)
        with progress_bar("training", self.num_chunks * self.chunk_steps, progress) as advance:
            advance(done * self.chunk_steps)
            for _ in range(done, self.num_chunks):
                began = time.perf_counter()
                state = jax.block_until_ready(trainer.run(state, self.chunk_iterations))
                rate = self.chunk_steps / (time.perf_counter() - began)
                _check_finite(state, trainer)
                if checkpoint is not None:
                    _save_checkpoint(checkpoint, trainer, state)
                note = probe.report(PPOPolicy(problem, state.policy)) if progress else ""
                advance(self.chunk_steps, note=f"{rate / 1000:.0f} k steps/s  {note}")
        return PPONominal(problem, self, PPOPolicy(problem, state.policy))

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> PPONominal:
        """Return the nominal distribution whose `arrays` were stored."""
        policy = _Trainer(problem, self, 0).initial_state().policy
        return PPONominal(problem, self, PPOPolicy(problem, _from_arrays(policy, arrays)))


class PPOPolicy(eqx.Module):
    """The learned policy of all goals."""

    problem: Problem = eqx.field(static=True)
    network: DenseNetwork

    def __call__(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " A"]:
        """Return log pi(a | state, step, goal) for every action."""
        return jax.nn.log_softmax(self.network(self.problem.mdp.features(state, step, goal)))


@dataclass(frozen=True, eq=False)
class PPONominal:
    """pi_0 as a policy network that takes the goal as an input."""

    problem: Problem
    solver: PPO
    policy: PPOPolicy

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the policy's weights."""
        return _to_arrays(self.policy.network)

    def policies(self, goals: np.ndarray) -> Iterator[PPOPolicy]:
        """Yield the same policy for each goal."""
        for _ in goals:
            yield self.policy


class Lanes(NamedTuple):
    """Where the episodes are: states [n, N], steps [N], goals [g, N]."""

    state: Array
    step: Array
    goal: Array


class PPOState(NamedTuple):
    """Everything that training carries; with the settings and the seed it determines the rest."""

    policy: DenseNetwork
    value: DenseNetwork
    policy_optimiser: Any
    value_optimiser: Any
    lanes: Lanes
    iteration: Int[Array, ""]


class Segment(NamedTuple):
    """What a rollout leaves for the losses: [F, N], [N], [A, N], [N], [N] with a leading L."""

    features: Array
    action: Array
    log_probabilities: Array
    reward: Array
    ended: Array


class Batch(NamedTuple):
    """A segment with advantages and value targets, [..., columns] with a leading G."""

    features: Array
    action: Array
    log_probabilities: Array
    advantage: Array
    target: Array


def over_lanes(function: Any, *axes: int | None) -> Any:
    """Map a function of one lane over the last axis of its arguments; None where all share one."""
    return jax.vmap(function, in_axes=axes, out_axes=-1)


@dataclass(frozen=True, eq=False)
class _Trainer:
    """One run: its problem, settings and seed."""

    problem: Problem
    settings: PPO
    seed: int

    def initial_state(self) -> PPOState:
        """Return what training starts from."""
        settings, mdp = self.settings, self.problem.mdp
        key_policy, key_value, key_lanes = jax.random.split(jax.random.key(self.seed), 3)
        lanes = self.fresh_lanes(key_lanes, explore=1.0)  # at any time, so that ends come evenly
        features = over_lanes(mdp.features, -1, -1, -1)(*lanes)
        hidden = (features.shape[0], settings.width, settings.width)
        policy = DenseNetwork((*hidden, mdp.num_actions), 0.1, key=key_policy)
        value = DenseNetwork((*hidden, 1), 1.0, key=key_value)
        optimiser = self.optimiser
        return PPOState(
            policy, value, optimiser.init(policy), optimiser.init(value), lanes, jnp.int32(0)
        )

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """Adam with clipped gradients and a falling rate."""
        settings = self.settings
        num_updates = (
            settings.num_chunks
            * settings.chunk_iterations
            * settings.num_epochs
            * settings.num_minibatches
        )
        rate = settings.learning_rate
        schedule = optax.linear_schedule(rate, rate * RATE_END, num_updates)
        return optax.chain(optax.clip_by_global_norm(10.0), optax.adam(schedule, b2=0.99, eps=1e-6))

    def fresh_lanes(self, key: Key[Array, ""], explore: float) -> Lanes:
        """Return new episodes: a share of lanes anywhere at any time, the others at a start."""
        mdp, num_lanes = self.problem.mdp, self.settings.num_lanes
        key_task, key_state, key_step = jax.random.split(key, 3)
        start, goal = over_lanes(mdp.sample_task, 0)(jax.random.split(key_task, num_lanes))
        anywhere = over_lanes(mdp.sample_state, 0)(jax.random.split(key_state, num_lanes))
        step = jax.random.randint(key_step, (num_lanes,), 0, mdp.num_steps)
        explores = jnp.arange(num_lanes) < explore * num_lanes
        return Lanes(jnp.where(explores, anywhere, start), jnp.where(explores, step, 0), goal)

    @partial(jax.jit, static_argnums=(0, 2))
    def run(self, state: PPOState, num_iterations: int) -> PPOState:
        """Run iterations of training in one scan."""
        return jax.lax.scan(self.iterate, state, None, length=num_iterations)[0]

    def iterate(self, state: PPOState, _: None) -> tuple[PPOState, None]:
        """Roll out one segment in all lanes and learn from it."""
        key = jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)
        lanes, segment = self.rollout(state.policy, state.lanes, key)
        batch = self.batch(state.value, segment, lanes)
        carry = (state.policy, state.value, state.policy_optimiser, state.value_optimiser)
        for _ in range(self.settings.num_epochs):
            carry, _ = jax.lax.scan(self.update, carry, batch)
        return PPOState(*carry, lanes, state.iteration + 1), None

    def rollout(
        self, policy: DenseNetwork, lanes: Lanes, key: Key[Array, ""]
    ) -> tuple[Lanes, Segment]:
        """Roll out one segment; a lane whose episode ends goes on with a fresh one."""
        settings, problem = self.settings, self.problem
        key_fresh, key_actions = jax.random.split(key)
        fresh = self.fresh_lanes(key_fresh, settings.explore)
        uniforms = jax.random.uniform(key_actions, (settings.segment, settings.num_lanes))
        offset = np.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0

        def advance(lanes: Lanes, fresh: Lanes, uniform: Array) -> tuple[Lanes, Segment]:
            features = problem.mdp.features(*lanes)
            log_probabilities = jax.nn.log_softmax(policy(features))
            action, log_probability = draw_action(log_probabilities, uniform)
            taken = take_step(problem, lanes.state, action, lanes.step, lanes.goal)
            earned = jnp.where(
                jnp.isneginf(taken.reward), -KNOWN_PENALTY, problem.beta * taken.reward
            )
            moved = Lanes(taken.state, lanes.step + 1, lanes.goal)
            lanes = jax.tree.map(partial(jnp.where, taken.ended), fresh, moved)
            reward = earned - log_probability - offset
            return lanes, Segment(features, action, log_probabilities, reward, taken.ended)

        return jax.lax.scan(
            lambda lanes, uniform: over_lanes(advance, -1, -1, -1)(lanes, fresh, uniform),
            lanes,
            uniforms,
        )

    def batch(self, value: DenseNetwork, segment: Segment, lanes: Lanes) -> Batch:
        """Return advantages and targets, in minibatches of whole lanes."""
        settings = self.settings
        groups = settings.num_minibatches

        def values(features: Array) -> Array:
            return losses.value_of_output(over_lanes(value, -1)(features)[0], settings.loss_scale)

        def group(x: Array) -> Array:
            """[L, ..., N] to [G, ..., L N / G], each group with its share of exploring lanes."""
            x = x.reshape(*x.shape[:-1], -1, groups)
            x = jnp.moveaxis(x, (-1, 0), (0, -2))
            return x.reshape(*x.shape[:-2], -1)

        features = group(segment.features)
        now = jax.lax.map(values, features).reshape(groups, settings.segment, -1)
        now = jnp.moveaxis(now, 0, -1).reshape(settings.segment, -1)
        last = values(over_lanes(self.problem.mdp.features, -1, -1, -1)(*lanes))
        later = jnp.where(segment.ended, 0.0, jnp.concatenate([now[1:], last[None]]))
        advantage = losses.advantages(
            segment.reward, now, later, segment.ended, settings.gae_lambda
        )
        columns = (segment.action, segment.log_probabilities, advantage, advantage + now)
        return Batch(features, *map(group, columns))

    def update(self, carry: tuple, batch: Batch) -> tuple[tuple, None]:
        """Take one step on a minibatch, of the policy and of the value."""
        policy, value, policy_state, value_state = carry
        policy, policy_state = self.descend(self.policy_loss, policy, policy_state, batch)
        value, value_state = self.descend(self.value_loss, value, value_state, batch)
        return (policy, value, policy_state, value_state), None

    def descend(self, loss: Any, network: DenseNetwork, state: Any, batch: Batch) -> tuple:
        """Take one optimiser step on a loss."""
        updates, state = self.optimiser.update(jax.grad(loss)(network, batch), state)
        return optax.apply_updates(network, updates), state

    def policy_loss(self, policy: DenseNetwork, batch: Batch) -> Array:
        """Return the mean clipped surrogate of a minibatch."""

        def loss(features: Array, action: Array, old: Array, advantage: Array) -> Array:
            new = jax.nn.log_softmax(policy(features))
            return losses.policy_loss(new, old, action, advantage, clip=self.settings.clip)

        each = over_lanes(loss, -1, -1, -1, -1)(*batch[:4])
        return jnp.mean(each / losses.loss_scale(batch.target, self.settings.loss_scale))

    def value_loss(self, value: DenseNetwork, batch: Batch) -> Array:
        """Return the mean Huber loss of relative errors of a minibatch."""
        scale = self.settings.loss_scale
        predicted = losses.value_of_output(over_lanes(value, -1)(batch.features)[0], scale)
        error = (predicted - batch.target) / losses.loss_scale(batch.target, scale)
        return jnp.mean(losses.huber(error))


class _Probe:
    """Estimates of KL and ESS on a few tasks, shown while training."""

    def __init__(self, problem: Problem, tasks: Task | None) -> None:
        if tasks is None:
            keys = jax.random.split(jax.random.key(0), NUM_PROBE_TASKS)
            tasks = Task(*jax.vmap(problem.mdp.sample_task)(keys))
        self.problem = problem
        self.tasks = Task(*(np.asarray(x[:NUM_PROBE_TASKS], np.float32) for x in tasks))

    def report(self, policy: PPOPolicy) -> str:
        """Return for example 'KL 0.84 nats  ESS 35 %', medians over the tasks."""
        start, goal = (jnp.repeat(jnp.asarray(x.T), NUM_PROBES, axis=1) for x in self.tasks)
        drawn = rollout(self.problem, policy, start, goal, jax.random.key(0), start.shape[1])
        log_weights = estimators.log_weights(
            np.asarray(drawn.total_reward),
            np.asarray(drawn.log_probability),
            np.asarray(drawn.length),
            beta=self.problem.beta,
            measure=self.problem.measure,
            num_actions=self.problem.mdp.num_actions,
        ).reshape(-1, NUM_PROBES)
        divergences, sizes = [], []
        for log_weight in log_weights[np.isfinite(log_weights).any(axis=1)]:
            log_partition = estimators.log_partition(log_weight)
            divergences.append(estimators.kl_divergence(log_weight, log_partition))
            sizes.append(estimators.effective_sample_size(log_weight) / NUM_PROBES)
        if not sizes:
            return "every probe enters a known constraint"
        return f"KL {np.median(divergences):.2f} nats  ESS {100 * np.median(sizes):.0f} %"


def _check_finite(state: PPOState, trainer: _Trainer) -> None:
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state.policy, state.value))):
        raise ValueError(
            f"training diverged before iteration {int(state.iteration)}: a weight is not finite. "
            f"Check the rewards and features of {type(trainer.problem.mdp).__name__}, or lower "
            f"learning_rate from {trainer.settings.learning_rate}"
        )


def _run_header(trainer: _Trainer) -> dict[str, Any]:
    return {
        "problem": trainer.problem.record.fingerprint,
        "settings": dataclasses.asdict(trainer.settings),
        "seed": trainer.seed,
    }


def _save_checkpoint(path: Path, trainer: _Trainer, state: PPOState) -> None:
    store.write(path, KIND, VERSION, _run_header(trainer), _to_arrays(state))


def _restore_checkpoint(path: Path, trainer: _Trainer, like: PPOState) -> PPOState:
    stored = store.open_file(path, KIND, VERSION)
    for key, value in _run_header(trainer).items():
        if stored.header[key] != value:
            raise ValueError(
                f"{path} is a checkpoint of another run: its {key} is {stored.header[key]}, this "
                f"run's is {value}. Give that run's {key}, or remove the file to start anew"
            )
    return _from_arrays(like, {name: stored.array(name) for name in stored.names})


def _to_arrays(tree: Any) -> dict[str, np.ndarray]:
    return {f"{k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(tree))}


def _from_arrays(like: Any, arrays: dict[str, np.ndarray]) -> Any:
    leaves = [jnp.asarray(arrays[str(k)]) for k in range(len(arrays))]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)
