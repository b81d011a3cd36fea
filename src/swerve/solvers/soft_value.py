"""Neural soft values: one goal-conditioned network for every start and goal, any dimension.

    V_t(s) = log mean_a exp(beta r(s, a, s') + V_{t+1}(s'))    (sum for the counting measure),

regressed on lambda-returns of its own residuals under its own look-ahead policy, from exploring
starts over state and time beside on-policy rollouts; see `soft_value_training`. V is a network plus
the terminal reward, which fades with the time to go. Where an episode ends V is not asked: r_T is
paid. Training ends when the KL divergence that a few tasks show stops improving.

Shapes: n states, g goal dimensions, C chunks.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from swerve.arguments import whole_number
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.solvers.checkpoints import Checkpoint
from swerve.solvers.lanes import check_lanes
from swerve.solvers.networks import from_arrays, to_arrays
from swerve.solvers.probe import Probe
from swerve.solvers.soft_value_training import SoftValuePolicy, Trainer
from swerve.space import Task

NUM_CHUNKS = 40
PATIENCE = 12  # chunks without improvement after which training ends
IMPROVED = 0.97  # of the least KL so far


class Progress(NamedTuple):
    """How training went, chunk by chunk.

    Attributes:
      seconds: of training so far, without probes.
      num_steps: environment steps so far.
      kl: median KL over the tasks tried, nats.
      worst_kl: the largest.
      effective_share: median ESS, as a share of the trajectories.
      residual: median |(B V) - V| in the lanes, nats.
    """

    seconds: float
    num_steps: float
    kl: float
    worst_kl: float
    effective_share: float
    residual: float


@dataclass(frozen=True)
class SoftValue:
    """Solver: a soft value network, and one-step look-ahead with it.

    Attributes:
      num_steps: environment steps to train for at most.
      num_lanes: N, episodes simulated side by side.
      segment: L, steps of each lane between updates.
      explore: share of the lanes that start anywhere at any time.
      num_epochs: passes over a segment.
      num_minibatches: G, updates a pass; has to divide the segment.
      trace: lambda of the returns; 0 trusts the network, 1 the residuals along the segment.
      learning_rate: at first, falling to a hundredth.
      width: of the two hidden layers.
      loss_scale: nats; errors are divided by 1 + |target| / this.
      fade: share of the horizon in which the terminal reward fades to 1 / e of itself.
    """

    num_steps: int = 50_000_000
    num_lanes: int = 512
    segment: int = 32
    explore: float = 0.5
    num_epochs: int = 2
    num_minibatches: int = 8
    trace: float = 0.99
    learning_rate: float = 3e-3
    width: int = 160
    loss_scale: float = 5.0
    fade: float = 0.04

    name = "soft-value"

    def __post_init__(self) -> None:
        for field in (
            "num_steps",
            "num_lanes",
            "segment",
            "num_epochs",
            "num_minibatches",
            "width",
        ):
            whole_number(getattr(self, field), f"SoftValue: {field}", 1)
        if self.segment % self.num_minibatches:
            raise ValueError(
                f"SoftValue: num_minibatches: expected a divisor of the segment {self.segment}, "
                f"got {self.num_minibatches}"
            )
        for field in ("explore", "trace"):
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(
                    f"SoftValue: {field}: expected a number from 0 to 1, got {getattr(self, field)}"
                )
        for field in ("learning_rate", "loss_scale", "fade"):
            if not getattr(self, field) > 0.0:
                raise ValueError(
                    f"SoftValue: {field}: expected a number > 0, got {getattr(self, field)}"
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

    @property
    def num_iterations(self) -> int:
        """Iterations of a whole run."""
        return self.num_chunks * self.chunk_iterations

    def learn(
        self,
        problem: Problem,
        *,
        tasks: Task | None = None,
        seed: int = 0,
        progress: bool = False,
        checkpoint: Path | None = None,
    ) -> SoftValueNominal:
        """Train, or go on training from a checkpoint, and return the nominal distribution.

        Args:
          problem: what to learn.
          tasks: those on which KL and ESS are estimated; drawn if None.
          seed: of everything random.
          progress: whether to show a bar with steps per second, KL, ESS and residual.
          checkpoint: file that is written after every chunk and resumed from; None for neither.

        Raises:
          ValueError: if the checkpoint is of another run, training diverged from the beginning, or
            no episode that the MDP draws can begin.
        """
        trainer = Trainer(problem, self, seed)
        run = _Run(trainer, Probe(problem, tasks), Checkpoint(checkpoint, problem, self, seed))
        check_lanes(problem, self.num_lanes, seed)
        with progress_bar("training", self.num_chunks * self.chunk_steps, progress) as advance:
            advance(len(run.history) * self.chunk_steps)
            while len(run.history) < self.num_chunks and not _has_settled(run.history):
                note = run.advance()
                if note is None:
                    break
                advance(self.chunk_steps, note=note)
        policy = trainer.policy(run.state.network)
        return SoftValueNominal(problem, self, policy, np.array(run.history))

    def check(self, problem: Problem) -> None:
        """Do nothing: there is no problem that it could not try."""

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> SoftValueNominal:
        """Return the nominal distribution whose `arrays` were stored."""
        arrays = dict(arrays)
        history = arrays.pop("history")
        trainer = Trainer(problem, self, 0)
        network = from_arrays(eqx.filter_eval_shape(trainer.initial_state).network, arrays)
        return SoftValueNominal(problem, self, trainer.policy(network), history)


@dataclass(frozen=True, eq=False)
class SoftValueNominal:
    """pi_0 by a soft value network that takes the goal as an input.

    Attributes:
      policy: of all goals.
      history: [C, 6] how training went, see `Progress`.
    """

    problem: Problem
    solver: SoftValue
    policy: SoftValuePolicy
    history: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the network's weights and how training went."""
        return to_arrays(self.policy.network) | {"history": self.history}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[SoftValuePolicy]:
        """Yield the same policy for each goal."""
        for _ in goals:
            advance(1.0)
            yield self.policy


class _Run:
    """A run that advances chunk by chunk, from the checkpoint if there is one."""

    def __init__(self, trainer: Trainer, probe: Probe, checkpoint: Checkpoint) -> None:
        self.trainer, self.probe, self.checkpoint = trainer, probe, checkpoint
        self.state = trainer.initial_state()
        self.history: list[Progress] = []
        arrays = checkpoint.load()
        if arrays is not None:
            self.history = [Progress(*row) for row in arrays.pop("history").tolist()]
            self.state = from_arrays(self.state, arrays)

    def advance(self) -> str | None:
        """Train for a chunk; return a note for people, or None where training diverged."""
        settings = self.trainer.settings
        began = time.perf_counter()
        state, info = self.trainer.run(self.state, settings.chunk_iterations)
        jax.block_until_ready(state)
        seconds = time.perf_counter() - began
        if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.network)):
            self._diverged()
            return None
        self.state = state
        reading = self.probe.read(self.trainer.policy(state.network))
        residual = float(np.median(info.residual))
        past = self.history[-1] if self.history else Progress(0.0, 0.0, *reading, residual)
        self.history.append(
            Progress(
                past.seconds + seconds, past.num_steps + settings.chunk_steps, *reading, residual
            )
        )
        self.checkpoint.save(to_arrays(state) | {"history": np.array(self.history)})
        rate = settings.chunk_steps / seconds / 1000.0
        return f"{rate:.0f} k steps/s  {reading}  residual {residual:.2g}"

    def _diverged(self) -> None:
        """Raise ValueError where nothing was learned yet, else say that the last state is kept."""
        mdp, rate = type(self.trainer.problem.mdp).__name__, self.trainer.settings.learning_rate
        text = (
            f"training diverged after {int(self.state.iteration)} iterations: a weight is not "
            f"finite. Check the rewards and features of {mdp}, or lower learning_rate from {rate}"
        )
        if not self.history:
            raise ValueError(text)
        warnings.warn(f"{text}. The network before that is kept", RuntimeWarning, stacklevel=4)


def _has_settled(history: list[Progress]) -> bool:
    """Return whether the KL has not improved for PATIENCE chunks."""
    kl = [progress.kl for progress in history]
    return len(kl) > PATIENCE and min(kl[-PATIENCE:]) > IMPROVED * min(kl[:-PATIENCE])
