"""Hold evidence: what samples of the nominal distribution tell about each hypothesis, by task.

Inference needs evidence alone. Evidence keeps N trajectories a task as numbers and bits. Small
tables sum up the trajectories, and are read without them (see `quantities`).

Shapes: K tasks, N trajectories, H hypotheses, n states, g goal dimensions.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from swerve.base import store
from swerve.base.arguments import positive_number
from swerve.base.space import Task
from swerve.evidence import matching
from swerve.evidence.motion import Motion
from swerve.evidence.quantities import Quantities
from swerve.evidence.samples import (
    RESOLVED,
    REWEIGHED,
    Samples,
    Summary,
    joined_samples,
    summarise,
)
from swerve.evidence.schema import StoredEvidence

KIND = "swerve-evidence"
VERSION = 6  # of the file format
Fields = TypeVar("Fields", bound=tuple)


@dataclass(frozen=True, eq=False)
class Evidence(Quantities):
    """Violation probabilities of every hypothesis under pi_0, for each of K tasks.

    Attributes:
      problem: problem that the estimates are for.
      tasks: starts [K, n] and goals [K, g].
      method: "smc", "tempered", "importance", "plain" (the paper's estimates: all weights equal, or
        at another beta the weights of its Theorem 2), or "exact". With "exact" the numbers have no
        sampling error, and the trajectories are kept for pictures alone.
      num_trajectories: N, the trajectories of each task.
      solver: the solver and its settings, as a text for people.
      seed: seed of the sampling.
      summary: the estimates, in small tables.
      load_samples: function that returns the reduced trajectories, called on first use.
      sampling_beta: beta for which the trajectories were sampled; the problem's unless given.
      motion: how states of the problem move, which demonstrations are held against; None where the
        moves take no definite time, and in evidence of earlier versions.
      missed_share: [K] share of pi_0 in which no trajectory is expected to be sampled, by
        trajectories that explore (see `sampling.missed`); NaN where none did.
      load_reward: function that returns the total rewards of the samples alone, which plain
        evidence with known constraints needs; those of `load_samples` if None.
    """

    @property
    def digest(self) -> str:
        """A hash of the tasks and their log ratios."""
        parts = (*self.tasks, self.log_ratio)
        return hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in parts)).hexdigest()

    def __repr__(self) -> str:
        """Return the problem, the numbers of tasks and hypotheses and the method in one line."""
        return (
            f"<Evidence of {self.problem.summary}: {self.num_tasks} tasks, "
            f"{len(self.problem.hypotheses)} hypotheses, method {self.method!r}>"
        )

    def find(self, task: Task) -> int | None:
        """Return the index of the task with the same start and goal; None without such a task.

        Two tasks are the same within MATCH_TOLERANCE of each state's extent.
        """
        number, distance = self.nearest(task)
        return int(number) if distance <= matching.MATCH_TOLERANCE else None

    def match(self, task: Task, name: str = "the task") -> int:
        """Return the index of the task with the same start and goal, as `find` does.

        Raises:
          ValueError: if there is no such task; the message names the nearest task.
        """
        return matching.match(self.problem, self.tasks, task, name)

    def nearest(self, tasks: Task) -> tuple[np.ndarray, np.ndarray]:
        """Return the index and the distance [...] of the task nearest to each of `tasks` [...].

        Distances are in units of the states' extents.
        """
        return matching.nearest(self.problem, self.tasks, tasks)

    def select(self, indices: list[int]) -> Evidence:
        """Return the evidence of some tasks, in the order of `indices`."""
        return dataclasses.replace(
            self,
            tasks=Task(*(values[indices] for values in self.tasks)),
            summary=Summary(*(values[indices] for values in self.summary)),
            load_samples=lambda: Samples(*(values[indices] for values in self.samples)),
            missed_share=self.missed_share[indices],
            load_reward=lambda: self.total_reward[indices],
        )

    def with_resolved(self, other: Evidence) -> Evidence:
        """Return this evidence with the ratios that other evidence has resolved for its tasks.

        Tasks that are only nearly the same do not count: a ratio belongs to the samples of a task.

        Args:
          other: evidence with the same problem and settings, of the same tasks or others.
        """
        rows = matching.find_equal(other.tasks, self.tasks)
        mine, theirs = np.flatnonzero(rows >= 0), rows[rows >= 0]
        before, after = (
            evidence.summary.log_ratio_error[k] for evidence, k in ((self, mine), (other, theirs))
        )
        is_newer = np.isfinite(after) | np.isnan(before) & np.isposinf(after)
        changed = {name: getattr(self.summary, name).copy() for name in RESOLVED}
        for name, values in changed.items():
            values[mine] = np.where(is_newer, getattr(other.summary, name)[theirs], values[mine])
        return dataclasses.replace(self, summary=self.summary._replace(**changed))

    def weighted(self, method: str) -> Evidence:
        """Return evidence with the same trajectories weighed by another method.

        Raises:
          ValueError: if one of the two methods is not "importance" or "plain": only these share
            trajectories.
        """
        if method == self.method:
            return self
        if not {method, self.method} <= set(REWEIGHED):
            raise ValueError(
                f"method: trajectories sampled by {self.method!r} cannot be weighed by {method!r}: "
                "sample anew"
            )
        summary = summarise(self.problem, self.samples, method, self.sampling_beta)
        return dataclasses.replace(self, method=method, summary=summary)

    def at_beta(self, beta: float) -> Evidence:
        """Return evidence with the same trajectories weighed for a demonstrator of another beta.

        With every method, (beta - beta of this evidence) R(xi) is added to a trajectory's
        log-weight (the paper, Theorem 2). The effective sample size falls with the distance of beta
        from `sampling_beta`; `infer` warns where the size is too small. The trajectories kept for
        pictures remain those of `sampling_beta`. The solver's soft value, which also belongs to
        that beta, is left out.

        Args:
          beta: inverse temperature, nats per unit of reward.

        Raises:
          ValueError: if beta is not a finite number above 0, or the evidence is exact.
        """
        beta = positive_number(beta, "beta")
        if self.is_exact:
            raise ValueError(
                f"at_beta: exact answers hold for their beta, {self.problem.beta:g}, alone and "
                f"have no samples to weigh anew: solve the problem again at beta {beta:g}"
            )
        problem = dataclasses.replace(self.problem, beta=beta)
        samples = self.samples
        return dataclasses.replace(
            self,
            problem=problem,
            summary=summarise(problem, samples, self.method, self.sampling_beta),
            load_samples=lambda: samples,
        )

    def joined(self, *others: Evidence) -> Evidence:
        """Return evidence for the tasks of this evidence and of others, in that order.

        Raises:
          ValueError: if the evidences differ in problem, method, solver, seed, number of
            trajectories or the beta for which the trajectories were sampled.
        """
        for other in others:
            for field in ("method", "num_trajectories", "solver", "seed", "sampling_beta"):
                if getattr(self, field) != getattr(other, field):
                    raise ValueError(
                        f"evidence of different {field} cannot be joined: "
                        f"{getattr(self, field)!r} and {getattr(other, field)!r}"
                    )
            if self.problem.fingerprint != other.problem.fingerprint:
                raise ValueError(
                    "evidence of different problems cannot be joined: "
                    f"{self.problem.summary} and {other.problem.summary}"
                )
        everything = (self, *others)
        return dataclasses.replace(
            self,
            tasks=_concatenated([evidence.tasks for evidence in everything]),
            summary=_concatenated([evidence.summary for evidence in everything]),
            load_samples=lambda: joined_samples([evidence.samples for evidence in everything]),
            missed_share=np.concatenate([evidence.missed_share for evidence in everything]),
            load_reward=lambda: np.concatenate([evidence.total_reward for evidence in everything]),
            motion=next((e.motion for e in everything if e.motion is not None), None),
        )

    def save(self, path: str | Path) -> None:
        """Write the evidence to one file, atomically."""
        header = {
            "problem": self.problem.to_json(),
            "method": self.method,
            "num_trajectories": self.num_trajectories,
            "solver": self.solver,
            "seed": self.seed,
            "sampling_beta": self.sampling_beta,
        }
        parts: dict[str, Any]
        parts = {"tasks": self.tasks, "summary": self.summary, "samples": self.samples}
        if self.motion is not None:
            parts["motion"] = self.motion
        arrays = {
            f"{part}/{name}": array
            for part, values in parts.items()
            for name, array in values._asdict().items()
        }
        if np.isfinite(self.missed_share).any():
            arrays["missed/share"] = self.missed_share
        store.write(path, KIND, VERSION, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Evidence:
        """Read evidence; the trajectories are read and checked on first use.

        Raises:
          store.StoreError: if the file is cut short, altered, of another kind or version, or holds
            what no evidence holds.
        """
        stored = store.open_file(path, KIND, VERSION)
        checked = StoredEvidence(stored)
        found = cls(
            problem=checked.problem,
            tasks=Task(*checked.read("tasks")),
            method=stored.header["method"],
            num_trajectories=stored.header["num_trajectories"],
            solver=stored.header["solver"],
            seed=stored.header["seed"],
            summary=Summary(*checked.read("summary")),
            load_samples=functools.cache(lambda: Samples(*checked.read("samples"))),
            load_reward=lambda: checked.read("samples", "total_reward")[0],
            sampling_beta=stored.header["sampling_beta"],
            motion=Motion(*checked.read("motion")) if "motion" in checked.parts else None,
        )
        if "missed" in checked.parts:
            return dataclasses.replace(found, missed_share=checked.read("missed")[0])
        return found


def _concatenated(parts: Sequence[Fields]) -> Fields:
    """Join named tuples of arrays along the first axis of every array."""
    return type(parts[0])(*map(np.concatenate, zip(*parts, strict=True)))
