"""The work folder: what one problem has cost so far, kept for the next call.

    problem.json                                   the problem as data, hashes of the source files
                                                   it came from, and the settings used last
    <solver>.seed<S>.nominal                       what the solver learned
    <solver>.seed<S>.<method>.<N>.evidence         what sampling it told
    <solver>.seed<S>.<method>.<N>.foresight        what watching needs besides
    <solver>.seed<S>.checkpoint                    training that is under way
    <solver>.seed<S>.training.png                  a picture of how training went
    outdated/                                      all this as it was before the problem changed

Other settings make other files, so nothing is replaced. Settings that are left out are those with
which something was last worked out. As long as none of the sources has changed, results are read
without importing JAX or user code. When one has, whatever rests on it is moved aside before
anything new is written. Several processes may work in one folder.
"""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote

import numpy as np

import swerve
from swerve.base import store
from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import ADAPTING_SOLVERS, REWEIGHED
from swerve.problem.loading import Specification, canonical_problem, file_hash, source_hashes
from swerve.problem.problem import ProblemRecord
from swerve.trust.verdicts import some_names
from swerve.work.settings import Settings

if TYPE_CHECKING:
    from swerve.inference.ranking import Inference
    from swerve.problem.problem import Problem
    from swerve.solvers.learn import Nominal

RESULTS = ("*.nominal", "*.evidence", "*.foresight", "*.checkpoint", "*.training.png")
OUTDATED = "outdated"  # folder of what was there before the problem changed
FORMAT = 3  # of problem.json
NUM_PRIOR_TASKS = 8
SAVE_INTERVAL = 60.0  # s between two saves while sampling


class Work:
    """One problem's results, in a folder or, without one, in memory alone.

    Args:
      problem_text: a problem specification, see `specification.load_problem`.
      folder: where results are kept, or None.
      settings: how to learn and sample.
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
        settings: Settings | None = None,
        *,
        say: Callable[[str], None] = lambda text: None,
        progress: bool = False,
    ) -> None:
        self.problem_text = problem_text
        self.folder = folder
        self.say = say
        self.progress = progress
        self._asked = settings or Settings()
        self._last = Settings()  # of the folder
        self._stored = self._read_record(say)
        self._nominals: dict[Settings, Nominal] = {}

    @property
    def record(self) -> ProblemRecord:
        """The problem as data; from the folder while its sources are unchanged."""
        if self._stored is not None and not self._stored.needs_code:
            return self._stored
        return self.problem.record

    @cached_property
    def problem(self) -> Problem:
        """The problem itself, which needs JAX and the user's code."""
        from swerve.problem.loading import load_problem

        problem = load_problem(self.problem_text)
        if self._stored is not None and self._stored.fingerprint != problem.record.fingerprint:
            self.say(f"{self.folder} is out of date (the problem has changed): working it out anew")
            self._stored = None
        return problem

    @property
    def settings(self) -> Settings:
        """All settings: those asked for, else those used last, else the defaults."""
        chosen = self._asked.completed(self._last)
        if chosen.solver is None:
            from swerve.solvers.learn import default_solver

            chosen = chosen.completed(Settings(default_solver(self.problem)))
        return chosen.filled()

    @property
    def goal_of(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """What gives the goal of a demonstration that names none; None: its last state."""
        return None if self.record.goal_is_last_state else self.problem.mdp.goal_of

    def evidence(self, tasks: Task | None) -> Evidence:
        """Return evidence for tasks, learning and sampling only what is not there yet.

        Args:
          tasks: starts [K, n] and goals [K, g]; None takes those of the stored evidence, or else
            draws some from the MDP.
        """
        known = self._stored_evidence()
        if known is not None and _covers(known, tasks):
            return known
        problem = self.problem  # which may show that what is stored is out of date
        known = self._stored_evidence() or self._weighed_otherwise()
        if known is not None and _covers(known, tasks):
            return known
        wanted = self._prior_tasks(problem) if tasks is None else _distinct(tasks)
        return self._sample(wanted if known is None else _missing(known, wanted), known)

    def nominal(self, tasks: Task | None = None) -> Nominal:
        """Return the nominal distribution, learning it if it is not there yet.

        Args:
          tasks: those on which training reports its progress.
        """
        if self.settings not in self._nominals:
            self._nominals[self.settings] = self._learned(tasks)
        return self._nominals[self.settings]

    def _learned(self, tasks: Task | None) -> Nominal:
        """Return the nominal distribution, read or learned."""
        from swerve.solvers.learn import learn, load_nominal, resolve_solver, save_nominal
        from swerve.solvers.trained.distilled import Distilled
        from swerve.solvers.trained.training import TrainedNominal

        problem, settings = self.problem, self.settings
        assert settings.solver is not None
        assert settings.seed is not None
        solver = resolve_solver(settings.solver)
        solver.check(problem)
        self._begin()
        path, checkpoint = self.path("nominal"), self.path("checkpoint")
        if path is not None and path.exists():
            self.say(f"using {path}")
            return load_nominal(path, problem)
        train = partial(learn, problem, solver)
        if isinstance(solver, Distilled):
            train = partial(solver.imitate, self._teacher.nominal(tasks))
            self._last = Settings()  # the folder has noted those of the teacher
            self._begin()
        self.say(f"learning with {settings.solver}: {problem.record.summary}")
        if checkpoint is not None and checkpoint.exists():
            self.say(f"going on from {checkpoint}")
        nominal = train(
            tasks=tasks, seed=settings.seed, progress=self.progress, checkpoint=checkpoint
        )
        if path is not None and checkpoint is not None:
            save_nominal(path, nominal)
            checkpoint.unlink(missing_ok=True)
        picture = self.path("training.png")
        if picture is not None and isinstance(nominal, TrainedNominal):
            nominal.plot_training(picture)
            self.say(f"how training went: {picture}")
        return nominal

    @property
    def _teacher(self) -> Work:
        """The same folder, for the soft value that a direct policy is distilled from.

        That which the folder holds, the latest if there are several, else one to be learned.
        """
        seed, solver = self.settings.seed, "soft-value"
        if self.folder is not None:
            suffix = f".seed{seed}.nominal"
            held = sorted(
                self.folder.glob(f"soft-value*{suffix}"), key=lambda path: path.stat().st_mtime
            )
            solver = unquote(held[-1].name.removesuffix(suffix)) if held else solver
        settings = Settings(solver=solver, seed=seed)
        return Work(self.problem_text, self.folder, settings, say=self.say, progress=self.progress)

    def resolved(self, inference: Inference) -> Evidence:
        """Return the evidence of a ranking, with what it hangs on worked out: see `resolve`."""
        evidence, solver = inference.evidence, self.settings.solver
        is_able = Specification.parse(str(solver)).target in ADAPTING_SOLVERS
        is_asked = inference.demonstrations and inference.score_name == "likelihood"
        if not (is_able and is_asked and inference.is_open.any()):
            return evidence
        from swerve.sampling.resolve import resolve

        names = np.flatnonzero(inference.is_open.any(axis=0)).tolist()
        self.say(
            "next to no trajectory avoids "
            f"{some_names([inference.hypothesis_name(index) for index in names])}: resolving what "
            "that takes (--no-resolve leaves what the samples tell)"
        )
        return resolve(
            self.nominal(),
            inference,
            seed=self.settings.seed or 0,
            progress=self.progress,
            keep=lambda evidence: self._save([evidence]),
        )

    def _sample(self, tasks: Task, known: Evidence | None) -> Evidence:
        """Sample tasks; what is finished is kept, also when it is interrupted."""
        from swerve.problem.tasks import checked_tasks
        from swerve.sampling.sample import sample_each

        settings = self.settings
        assert settings.num_trajectories is not None
        assert settings.method is not None
        assert settings.seed is not None
        checked_tasks(self.problem, tasks)  # before learning, which may take minutes
        found = [] if known is None else [known]
        saved, at = len(found), time.monotonic()
        try:
            for _, evidence in sample_each(
                self.nominal(tasks),
                tasks,
                settings.num_trajectories,
                method=settings.method,
                seed=settings.seed,
                progress=self.progress,
            ):
                found.append(evidence)
                if time.monotonic() - at > SAVE_INTERVAL:
                    self._save(found)
                    saved, at = len(found), time.monotonic()
        finally:
            if len(found) > saved:
                self._save(found)
        return found[0].joined(*found[1:])

    def _save(self, found: list[Evidence]) -> None:
        """Write evidence, with that of tasks which another process has added meanwhile."""
        path = self.path("evidence")
        if self.folder is None or path is None:
            return
        evidence = found[0].joined(*found[1:])
        with store.locked(self.folder):
            stored = self._stored_evidence()
            if stored is not None:
                rows = _missing_rows(evidence, stored.tasks)
                evidence = evidence.joined(stored.select(rows)) if rows else evidence
            evidence.save(path)

    def _weighed_otherwise(self) -> Evidence | None:
        """Return stored trajectories that were weighed by another method, weighed by this one."""
        mine = self.settings.method
        for method in REWEIGHED if mine in REWEIGHED else ():
            other = self._stored_evidence(method)
            if other is not None and mine is not None:
                self._begin()
                evidence = other.weighted(mine)
                self._save([evidence])
                return evidence
        return None

    def _prior_tasks(self, problem: Problem) -> Task:
        """Draw tasks for the ranking before any demonstration."""
        from swerve.problem.tasks import draw_tasks

        self.say(f"no demonstrations and no tasks: drawing {NUM_PRIOR_TASKS} tasks from the MDP")
        return draw_tasks(problem, NUM_PRIOR_TASKS, seed=self.settings.seed or 0)

    def path(self, suffix: str, method: str | None = None) -> Path | None:
        """Return the file of a result, named after all settings that it depends on."""
        if self.folder is None:
            return None
        settings = self.settings
        name = f"{quote(str(settings.solver), safe='=')}.seed{settings.seed}"
        if suffix == "evidence":
            name = f"{name}.{method or settings.method}.{settings.num_trajectories}"
        return self.folder / f"{name}.{suffix}"

    def _stored_evidence(self, method: str | None = None) -> Evidence | None:
        """Return the stored evidence that was made with these settings, or another method."""
        if self._stored is not None and self._stored.needs_code:
            _ = self.problem  # which may show that what is stored is out of date
        if self._stored is None:
            return None
        path = self.path("evidence", method)
        if path is None or not path.exists():
            return None
        evidence = Evidence.load(path)
        if evidence.problem.fingerprint != self._stored.fingerprint:
            raise store.StoreError(
                path,
                "holds evidence of another version of the problem",
                "remove it, and it is made again",
            )
        if evidence.problem.needs_code:
            return dataclasses.replace(evidence, problem=self.problem.record)
        return evidence

    def _read_record(self, say: Callable[[str], None]) -> ProblemRecord | None:
        """Return the folder's problem if it is this one and nothing it came from has changed."""
        if self.folder is None or not (self.folder / "problem.json").exists():
            return None
        stored = store.read_json(self.folder / "problem.json")
        asked = canonical_problem(self.problem_text)
        if stored.get("format") != FORMAT:
            say(f"{self.folder} is of another version of swerve: working it out anew")
            return None
        if stored["problem"] != asked:
            raise ValueError(
                f"{self.folder} holds the results of {stored['problem']!r}, not of {asked!r}: "
                "name another --work folder"
            )
        self._last = Settings.from_json(stored["settings"])
        changes = [
            f"{path} has changed"
            for path, old in stored["sources"].items()
            if file_hash(Path(path)) != old
        ]
        if stored["swerve"] != swerve.__version__:
            changes.append(f"swerve was {stored['swerve']} and is {swerve.__version__}")
        if changes:
            say(f"{self.folder} is out of date ({'; '.join(changes)}): working it out anew")
            return None
        return ProblemRecord.from_json(stored["record"])

    def _begin(self) -> None:
        """Make the folder ready to be written: nothing out of date in it, these settings noted."""
        if self.folder is None:
            return
        store.check_writable(self.folder)
        record, settings = self.problem.record, self.settings
        if self._stored is not None and settings == self._last:
            return
        with store.locked(self.folder):
            if not self._is_current(record):
                self._move_aside(self.folder)
            data = {
                "format": FORMAT,
                "problem": canonical_problem(self.problem_text),
                "record": record.to_json(),
                "settings": dataclasses.asdict(settings),
                "sources": source_hashes(self.problem),
                "swerve": swerve.__version__,
            }
            store.write_json(self.folder / "problem.json", data)
        self._stored, self._last = record, settings

    def _is_current(self, record: ProblemRecord) -> bool:
        """Return whether the folder is, by now perhaps, one of this problem as it is."""
        if self._stored is None:
            self._stored = self._read_record(lambda text: None)  # since it has been said
        return self._stored is not None and self._stored.fingerprint == record.fingerprint

    def _move_aside(self, folder: Path) -> None:
        """Move what rests on an older version of the problem, in place of what was moved before."""
        results = [path for pattern in RESULTS for path in folder.glob(pattern)]
        if results and not (folder / "problem.json").exists():
            raise ValueError(
                f"{folder} holds {results[0].name} but no problem.json, so it is no work "
                "folder of swerve: name another --work folder"
            )
        aside = folder / OUTDATED
        if results:
            shutil.rmtree(aside, ignore_errors=True)
            aside.mkdir()
            shutil.copy(folder / "problem.json", aside)
            self.say(f"what {folder} held is in {aside} now")
        for path in results:
            shutil.move(path, aside)


def _distinct(tasks: Task) -> Task:
    """Return each task once."""
    rows = np.unique(np.hstack(tasks), axis=0)
    return Task(*np.split(rows, [tasks.start.shape[1]], axis=1))


def _covers(evidence: Evidence, tasks: Task | None) -> bool:
    """Return whether there is evidence for all tasks, if any are asked for."""
    return tasks is None or not _missing_rows(evidence, tasks)


def _missing(evidence: Evidence, tasks: Task) -> Task:
    """Return those tasks for which there is no evidence."""
    rows = _missing_rows(evidence, tasks)
    return Task(tasks.start[rows], tasks.goal[rows])


def _missing_rows(evidence: Evidence, tasks: Task) -> list[int]:
    """Return the numbers of those tasks for which there is no evidence."""
    return [
        k for k, task in enumerate(zip(*tasks, strict=True)) if evidence.find(Task(*task)) is None
    ]
