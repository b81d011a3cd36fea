"""Maximum-entropy proximal policy optimisation: one goal-conditioned policy for all tasks.

The paper's way to pi_0: maximise its eq. 6, where the log-probability of the executed action is
part of the return at weight 1 / beta, here with everything times beta, in nats. Half of the lanes
start anywhere at any time (exploring starts), half where tasks start; see `ppo_training`. A run is
one `scan` over iterations, cut into chunks between which progress is shown and a checkpoint
written.

Shapes: A actions, n states, g goal dimensions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from swerve.arguments import whole_number
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.solvers.checkpoints import Checkpoint
from swerve.solvers.lanes import check_lanes
from swerve.solvers.networks import DenseNetwork, from_arrays, to_arrays
from swerve.solvers.ppo_training import PPOState, Trainer
from swerve.solvers.probe import Probe
from swerve.space import Task

NUM_CHUNKS = 40


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
      loss_scale: nats; losses are divided by 1 + |value| / this.
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
            whole_number(getattr(self, field), f"PPO: {field}", 1)
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
          ValueError: if the checkpoint is of another run, training diverged, or no episode that the
            MDP draws can begin.
        """
        trainer = Trainer(problem, self, seed)
        check_lanes(problem, self.num_lanes, seed)
        state = trainer.initial_state()
        file = Checkpoint(checkpoint, problem, self, seed)
        arrays = file.load()
        if arrays is not None:
            state = from_arrays(state, arrays)
        done = int(state.iteration) // self.chunk_iterations
        probe = Probe(problem, tasks) if progress else None
        with progress_bar("training", self.num_chunks * self.chunk_steps, progress) as advance:
            advance(done * self.chunk_steps)
            for _ in range(done, self.num_chunks):
                began = time.perf_counter()
                state = jax.block_until_ready(trainer.run(state, self.chunk_iterations))
                rate = self.chunk_steps / (time.perf_counter() - began)
                _check_finite(state, trainer)
                file.save(to_arrays(state))
                note = str(probe.read(PPOPolicy(problem, state.policy))) if probe else ""
                advance(self.chunk_steps, note=f"{rate / 1000:.0f} k steps/s  {note}")
        return PPONominal(problem, self, PPOPolicy(problem, state.policy))

    def check(self, problem: Problem) -> None:
        """Do nothing: there is no problem that PPO could not try."""

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> PPONominal:
        """Return the nominal distribution whose `arrays` were stored."""
        policy = eqx.filter_eval_shape(Trainer(problem, self, 0).initial_state).policy
        return PPONominal(problem, self, PPOPolicy(problem, from_arrays(policy, arrays)))


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
        return to_arrays(self.policy.network)

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[PPOPolicy]:
        """Yield the same policy for each goal."""
        for _ in goals:
            advance(1.0)
            yield self.policy


def _check_finite(state: PPOState, trainer: Trainer) -> None:
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state.policy, state.value))):
        raise ValueError(
            f"training diverged before iteration {int(state.iteration)}: a weight is not finite. "
            f"Check the rewards and features of {type(trainer.problem.mdp).__name__}, or lower "
            f"learning_rate from {trainer.settings.learning_rate}"
        )
