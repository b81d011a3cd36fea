"""The work folder: what one problem has cost so far, kept for the next call.

    problem.json            the problem as data, and hashes of the source files it came from
    <solver>.nominal        what the solver learned
    <solver>.evidence       what sampling it told
    <solver>.checkpoint     training that is under way

As long as none of the sources has changed, results are read without importing JAX or user code.
When one has, whatever rests on it is removed before anything new is written.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

import numpy as np

import swerve
from swerve import store
from swerve.evidence import Evidence
from swerve.problem import ProblemRecord
from swerve.space import Task
from swerve.specification import Specification, canonical_problem, file_hash, source_hashes

if TYPE_CHECKING:
    from swerve.nominal import Nominal
    from swerve.problem import Problem

RESULTS = ("*.nominal", "*.evidence", "*.checkpoint")
NUM_PRIOR_TASKS = 8


@dataclasses.dataclass(frozen=True)
class SampleSettings:
    """How to sample; None takes what the folder holds, or else the default.

    Attributes:
      num_trajectories: N a task (default 10,000).
      method: "importance" (default) or "plain".
      seed: of learning and sampling (default 0).
    """

    num_trajectories: int | None = None
    method: str | None = None
    seed: int | None = None

    def fits(self, evidence: Evidence) -> bool:
        """Return whether evidence was made with these settings."""
        return all(
            wanted is None or wanted == getattr(evidence, field.name)
            for field in dataclasses.fields(self)
            for wanted in [getattr(self, field.name)]
        )


class Work:
    """One problem's results, in a folder or, without one, in memory alone.

    Args:
      problem_text: a problem specification, see `specification.load_problem`.
      folder: where results are kept, or None.
      say: called with a line of text on what is found or done.
      progress: whether to show progress bars.

    Raises:
      ValueError: if the folder holds the results of another problem.
      store.StoreError: if a file in it is cut short, altered or of a newer version.
    """

    def __init__(
        self,
        problem_text: str,
        folder: Path | None,
        *,
        say: Callable[[str], None] = lambda text: None,
        progress: bool = False,
    ) -> None:
        self.problem_text = problem_text
        self.folder = folder
        self.say = say
        self.progress = progress
        self._stored = self._read_record()

    @property
    def record(self) -> ProblemRecord:
        """The problem as data; from the folder while its sources are unchanged."""
        if self._stored is not None and not self._stored.needs_code:
            return self._stored
        return self.problem.record

    @cached_property
    def problem(self) -> Problem:
        """The problem itself, which needs JAX and the user's code."""
        from swerve.specification import load_problem

        problem = load_problem(self.problem_text)
        if self.folder is not None and self._stored is None:
            self._start_folder(problem)
        return problem

    @property
    def goal_of(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """What gives the goal of a demonstration that names none; None: its last state."""
        return None if self.record.goal_is_last_state else self.problem.mdp.goal_of

    def evidence(
        self, tasks: Task | None, solver: str | None, settings: SampleSettings
    ) -> Evidence:
        """Return evidence for tasks, learning and sampling only what is not there yet.

        Args:
          tasks: starts [K, n] and goals [K, g]; None takes those of the stored evidence, or else
            draws some from the MDP.
          solver: a solver specification; None takes the one used last, or else the default.
          settings: how to sample.
        """
        known = self._stored_evidence(solver, settings)
        if known is not None and (tasks is None or not len(_missing(known, tasks).start)):
            return known
        solver = solver or (self._last_solver() if self._stored else None) or self._default_solver()
        wanted = self._prior_tasks() if tasks is None else tasks
        wanted = Task(*np.split(np.unique(np.hstack(wanted), axis=0), [wanted.start.shape[1]], 1))
        missing = wanted if known is None else _missing(known, wanted)
        evidence = self._sample(missing, solver, settings, known)
        if known is not None:
            evidence = known.joined(evidence)
        path = self._path(solver, "evidence")
        if path is not None:
            evidence.save(path)
        return evidence

    def nominal(self, solver: str | None, seed: int | None, tasks: Task | None = None) -> Nominal:
        """Return the nominal distribution, learning it if it is not there yet.

        Args:
          solver: a solver specification; None takes the one used last, or else the default.
          seed: of learning; a stored nominal of any seed is used as it is.
          tasks: those on which training reports its progress.
        """
        from swerve.nominal import learn, load_nominal, save_nominal

        problem = self.problem  # first, since it clears the folder of what is out of date
        solver = solver or self._last_solver() or self._default_solver()
        path, checkpoint = self._path(solver, "nominal"), self._path(solver, "checkpoint")
        if path is not None and path.exists():
            self.say(f"using {path}")
            return load_nominal(path, problem)
        if self.folder is not None:
            store.check_writable(self.folder)
        self.say(f"learning with {solver}: {problem.record.summary}")
        nominal = learn(
            problem,
            solver,
            tasks=tasks,
            seed=seed or 0,
            progress=self.progress,
            checkpoint=checkpoint,
        )
        if path is not None and checkpoint is not None:
            save_nominal(path, nominal)
            checkpoint.unlink(missing_ok=True)
        return nominal

    def _sample(
        self, tasks: Task, solver: str, settings: SampleSettings, like: Evidence | None
    ) -> Evidence:
        from swerve.sampling import sample

        if like is not None:
            settings = SampleSettings(like.num_trajectories, like.method, like.seed)
        if self.folder is not None:
            store.check_writable(self.folder)
        nominal = self.nominal(solver, settings.seed, tasks)
        return sample(
            nominal,
            tasks,
            settings.num_trajectories or 10_000,
            method=settings.method or "importance",
            seed=settings.seed or 0,
            progress=self.progress,
        )

    def _prior_tasks(self) -> Task:
        """Draw tasks for the ranking before any demonstration."""
        import jax

        keys = jax.random.split(jax.random.key(0), NUM_PRIOR_TASKS)
        self.say(f"no demonstrations and no tasks: drawing {NUM_PRIOR_TASKS} tasks from the MDP")
        start, goal = jax.vmap(self.problem.mdp.sample_task)(keys)
        return Task(np.asarray(start, np.float64), np.asarray(goal, np.float64))

    def _default_solver(self) -> str:
        from swerve.nominal import default_solver

        return default_solver(self.problem)

    def _path(self, solver: str, suffix: str) -> Path | None:
        """Return the file of a solver's results; parameters are part of its name."""
        if self.folder is None:
            return None
        return self.folder / f"{quote(str(Specification.parse(solver)), safe='=')}.{suffix}"

    def _last_solver(self) -> str | None:
        """Return the solver whose results were written last, or None."""
        if self.folder is None:
            return None
        files = [path for pattern in RESULTS for path in self.folder.glob(pattern)]
        if not files:
            return None
        return unquote(max(files, key=lambda path: path.stat().st_mtime).stem)

    def _stored_evidence(self, solver: str | None, settings: SampleSettings) -> Evidence | None:
        """Return the stored evidence of a solver if it was sampled as asked."""
        solver = solver or self._last_solver()
        path = self._path(solver, "evidence") if solver is not None else None
        if self._stored is None or path is None or not path.exists():
            return None
        evidence = Evidence.load(path)
        if evidence.problem.needs_code:
            evidence = dataclasses.replace(evidence, problem=self.problem.record)
        return evidence if settings.fits(evidence) else None

    def _read_record(self) -> ProblemRecord | None:
        """Return the folder's problem if it is this one and nothing it came from has changed."""
        if self.folder is None or not (self.folder / "problem.json").exists():
            return None
        stored = store.read_json(self.folder / "problem.json")
        asked = canonical_problem(self.problem_text)
        if stored["problem"] != asked:
            raise ValueError(
                f"{self.folder} holds the results of {stored['problem']!r}, not of {asked!r}: "
                "name another --work folder"
            )
        changes = [
            f"{path} has changed"
            for path, old in stored["sources"].items()
            if file_hash(Path(path)) != old
        ]
        if stored["swerve"] != swerve.__version__:
            changes.append(f"swerve was {stored['swerve']} and is {swerve.__version__}")
        if changes:
            self.say(f"{self.folder} is out of date ({'; '.join(changes)}): working it out anew")
            return None
        return ProblemRecord.from_json(stored["record"])

    def _start_folder(self, problem: Problem) -> None:
        """Remove what rests on an older version of the problem, then record this one."""
        assert self.folder is not None
        store.check_writable(self.folder)
        results = [path for pattern in RESULTS for path in self.folder.glob(pattern)]
        if results and not (self.folder / "problem.json").exists():
            raise ValueError(
                f"{self.folder} holds {results[0].name} but no problem.json, so it is no work "
                "folder of swerve: name another --work folder"
            )
        for path in results:
            path.unlink()
        data: dict[str, Any] = {
            "problem": canonical_problem(self.problem_text),
            "record": problem.record.to_json(),
            "sources": source_hashes(problem),
            "swerve": swerve.__version__,
        }
        store.write_json(self.folder / "problem.json", data)
        self._stored = problem.record


def _missing(evidence: Evidence, tasks: Task) -> Task:
    """Return those tasks for which there is no evidence."""
    rows = [
        k for k, task in enumerate(zip(*tasks, strict=True)) if evidence.find(Task(*task)) is None
    ]
    return Task(tasks.start[rows], tasks.goal[rows])
