"""Work on one problem: learn, sample and resolve whatever the work folder does not hold yet.

Settings that are left out keep the value used last, which the folder's record names. As long as no
source file of the problem has changed, results are read without importing JAX or user code. When a
source file has changed, all results are moved aside before anything new is written. See `folder`
for the files.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swerve.base.interrupts import saving
from swerve.base.phrases import counted, duration, some_names
from swerve.base.solver_kinds import kind_named
from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import NUM_ISLANDS, RESAMPLED, REWEIGHED
from swerve.inference.unresolved import worth_resolving
from swerve.work.folder import WorkFolder, missing_rows
from swerve.work.settings import Settings
from swerve.work.stages import ProblemInFolder

if TYPE_CHECKING:
    from swerve.inference.ranking import Ranking
    from swerve.monitoring.foresight import Foresight
    from swerve.problem.problem import Problem
    from swerve.problem.record import ProblemRecord
    from swerve.solvers.base import Nominal

NUM_PRIOR_TASKS = 8  # tasks sampled from the MDP for the ranking before any demonstration
SAVE_INTERVAL = 60.0  # s between two saves while sampling: what an interruption may lose


class Work:
    """One problem's results, in a folder or, without a folder, in memory alone.

    Args:
      problem_text: a problem specification, see `loading.load_problem`.
      folder: where results are kept, or None.
      settings: how to learn and sample.
      say: called with a line of text on each thing found or done.
      progress: whether to show progress bars.

    Raises:
      ValueError: if the folder holds the results of another problem.
      store.StoreError: if a file in the folder is cut short, altered or of a newer version.
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
        self.say = say
        self.progress = progress
        self._folder = None if folder is None else WorkFolder(folder, problem_text)
        self._asked = settings or Settings()
        self._stages = ProblemInFolder(problem_text, self._folder, say)
        self._nominal: Nominal | None = None  # set once, by `nominal`

    @property
    def problem(self) -> Problem:
        """The problem itself, which needs JAX and the user's code."""
        return self._stages.load().problem

    @property
    def record(self) -> ProblemRecord:
        """The problem as data; from the folder while its sources are unchanged."""
        return self._stages.record()

    @cached_property
    def settings(self) -> Settings:
        """Complete settings: each value as asked for, else as used last, else the default."""
        chosen = self._asked.completed(self._stages.opened.settings)
        if chosen.solver is None:
            from swerve.solvers.learn import default_solver

            chosen = chosen.completed(Settings(default_solver(self.problem)))
        return chosen.filled()

    @property
    def goal_of(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Function that gives the goal of a demonstration without one; None for the last state."""
        return None if self.record.goal_is_last_state else self.problem.mdp.goal_of

    def path(self, suffix: str, method: str | None = None) -> Path | None:
        """Return the file of a result, or None without a folder; see `WorkFolder.result_path`."""
        if self._folder is None:
            return None
        return self._folder.result_path(suffix, self.settings, method)

    def evidence(self, tasks: Task | None) -> Evidence:
        """Return evidence for tasks, learning and sampling only what the folder does not hold.

        Args:
          tasks: starts [K, n] and goals [K, g]; None takes the tasks of the stored evidence or, if
            there is no evidence, samples some from the MDP.
        """
        known = self._stored_evidence(self._stages.usable())
        if known is not None and _has_all(known, tasks):
            return known
        record = self._stages.usable_once_loaded()
        known = self._stored_evidence(record) or self._reweighed(record)
        if known is not None and _has_all(known, tasks):
            return known
        wanted = self._prior_tasks() if tasks is None else _distinct(tasks)
        return self._sample(wanted if known is None else _missing(known, wanted), known)

    def nominal(self, tasks: Task | None = None) -> Nominal:
        """Return the nominal distribution, learning it if the folder does not hold it.

        Args:
          tasks: tasks on which training reports its progress.
        """
        if self._nominal is None:
            self._nominal = self._read_or_learn(tasks)
        return self._nominal

    def resolved(self, ranking: Ranking, seconds: float = math.inf) -> Evidence:
        """Return the evidence of a ranking, with its open scores worked out: see `resolve`.

        Args:
          ranking: a ranking by demonstrations.
          seconds: time after which no further score is worked out [s].
        """
        is_able = kind_named(str(self.settings.solver)).adapts
        is_asked = ranking.demonstrations and ranking.score_name == "likelihood"
        found = worth_resolving(ranking) if is_able and is_asked else np.zeros(0, int)
        if not len(found):
            return ranking.evidence
        from swerve.sampling.resolve import resolve

        num_others = np.count_nonzero(ranking.is_open.any(axis=0)) - len(found)
        others = f"; {num_others} more can change nothing" if num_others else ""
        limit = f", within {duration(seconds)} (--resolve-seconds)" if seconds < math.inf else ""
        self.say(
            f"hardly any trajectory avoids {self._named(ranking, found)}: resolving how unlikely "
            f"that is, best first{limit}{others}; --no-resolve keeps the bounds of the samples"
        )
        evidence = resolve(
            self.nominal(),
            ranking,
            seed=self.settings.seed or 0,
            seconds=seconds,
            progress=self.progress,
            keep=lambda evidence: self._save([evidence]),
        )
        untried = ranking.is_open & np.isnan(evidence.summary.log_ratio_error)
        left = found[untried[:, found].any(axis=0)]
        if len(left):
            self.say(
                f"left for want of time: {len(left)} of {counted(len(found), 'hypothesis')}, "
                f"{self._named(ranking, left)}; their scores stay as the samples tell. Give more "
                "--resolve-seconds" + ", and the same --work to go on" * (self._folder is not None)
            )
        return evidence

    @staticmethod
    def _named(ranking: Ranking, hypotheses: np.ndarray) -> str:
        """Return the numbers and names of the first hypotheses, and how many more there are."""
        return some_names([f"{k} ({ranking.hypothesis_name(k)})" for k in hypotheses.tolist()])

    def foresight(self, evidence: Evidence) -> Foresight:
        """Return the foresight for the tasks of evidence, learning it if the folder has none."""
        from swerve.monitoring.foresight import Foresight

        path = self.path("foresight")
        if path is not None and path.exists():
            foresight = Foresight.load(path, evidence.problem)
            if foresight.learned_from == evidence.digest:
                return foresight
        from swerve.monitoring.foresee import foresee

        self.say("learning to look ahead, for the goals of the work folder's tasks")
        nominal = self.nominal(evidence.tasks)
        seed = self.settings.seed or 0
        foresight = foresee(nominal, evidence, seed=seed, progress=self.progress)
        if path is not None:
            foresight.save(path)
        return foresight

    def _read_or_learn(self, tasks: Task | None) -> Nominal:
        """Return the nominal distribution, read from the folder or learned into it."""
        from swerve.solvers.learn import load_nominal, resolve_solver, save_nominal

        problem, solver = self.problem, resolve_solver(str(self.settings.solver))
        solver.check(problem)  # before the record is written: a refused solver is not remembered
        self._stages.prepare(self.settings)
        path, checkpoint = self.path("nominal"), self.path("checkpoint")
        if path is not None and path.exists():
            self.say(f"using {path}")
            return load_nominal(path, problem)
        nominal: Any = self._learn(solver, tasks, checkpoint)
        if path is not None and checkpoint is not None:
            save_nominal(path, nominal)
            checkpoint.unlink(missing_ok=True)
        picture = self.path("training.png")
        if picture is not None and kind_named(solver.name).is_trained:
            nominal.plot_training(picture)
            self.say(f"how training went: {picture}")
        return nominal

    def _learn(self, solver: Any, tasks: Task | None, checkpoint: Path | None) -> Nominal:
        """Return the nominal distribution that a solver learns, from a checkpoint if there is one.

        Args:
          solver: solver of any kind; a solver with a teacher imitates what the teacher learned.
          tasks: tasks on which training reports its progress.
          checkpoint: file that training writes as it goes, or None.
        """
        from swerve.solvers.learn import learn

        settings, loaded = self.settings, self._stages.load()
        assert settings.seed is not None
        train = partial(learn, loaded.problem, solver)
        teacher = kind_named(solver.name).teacher
        if teacher:
            train = partial(solver.imitate, self._work_of_teacher(teacher).nominal(tasks))
            self._stages.write_record(settings)  # the teacher's work has recorded its own settings
        self.say(f"learning with {settings.solver}: {loaded.record.summary}")
        if checkpoint is not None and checkpoint.exists():
            self.say(f"going on from {checkpoint}")
        return train(tasks=tasks, seed=settings.seed, progress=self.progress, checkpoint=checkpoint)

    def _work_of_teacher(self, name: str) -> Work:
        """Return work in the same folder with the solver that a student imitates.

        Args:
          name: name of the teacher. Its settings are those of its latest nominal in the folder,
            else the defaults.
        """
        seed = self.settings.seed
        held = None if self._folder is None else self._folder.latest_solver(name, seed)
        settings = Settings(solver=held or name, seed=seed)
        path = None if self._folder is None else self._folder.path
        return Work(self.problem_text, path, settings, say=self.say, progress=self.progress)

    def _sample(self, tasks: Task, known: Evidence | None) -> Evidence:
        """Sample tasks and add their evidence to the known evidence.

        Finished tasks are saved every SAVE_INTERVAL, and at the end or an interruption.
        """
        from swerve.problem.tasks import checked_tasks
        from swerve.sampling.one_task import whole_islands
        from swerve.sampling.sample import sample_each

        settings = self.settings
        assert settings.num_trajectories is not None
        assert settings.method is not None
        assert settings.seed is not None
        checked_tasks(self.problem, tasks)  # before learning, which may take minutes
        num = math.prod(whole_islands(settings.num_trajectories))
        if settings.method in RESAMPLED and num > settings.num_trajectories:
            self.say(f"{settings.method} takes {num:,} trajectories a task, in {NUM_ISLANDS} parts")
        found: list[Evidence] = []
        num_saved, saved_at = 0, time.monotonic()
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
                if time.monotonic() - saved_at > SAVE_INTERVAL:
                    self._save(found)
                    num_saved, saved_at = len(found), time.monotonic()
        finally:
            if len(found) > num_saved:
                self._save(found)
        first, *others = found if known is None else [known, *found]
        return first.joined(*others)

    def _save(self, found: list[Evidence]) -> None:
        """Add evidence to the folder, which has been prepared."""
        if self._folder is not None:
            with saving():
                evidence = found[0].joined(*found[1:])
                self._folder.add_evidence(evidence, self.settings, self._stages.load().record)

    def _stored_evidence(
        self, record: ProblemRecord | None, method: str | None = None
    ) -> Evidence | None:
        """Return the stored evidence that was made with these settings, if any.

        Args:
          record: record of the usable results, see `ProblemInFolder.usable`; None for no results.
          method: method of sampling, in place of the settings' method.
        """
        if record is None or self._folder is None:
            return None
        return self._folder.read_evidence(self.settings, record, method)

    def _reweighed(self, record: ProblemRecord | None) -> Evidence | None:
        """Return stored trajectories of another method, weighed by this method, or None.

        Args:
          record: record of the usable results; None if no results are usable.
        """
        mine = self.settings.method
        if mine not in REWEIGHED:
            return None
        for method in REWEIGHED:
            other = self._stored_evidence(record, method)
            if other is not None:
                self._stages.prepare(self.settings)
                evidence = other.weighted(mine)
                self._save([evidence])
                return evidence
        return None

    def _prior_tasks(self) -> Task:
        """Sample tasks from the MDP for the ranking before any demonstration."""
        from swerve.problem.tasks import draw_tasks

        self.say(f"no demonstrations and no tasks: sampling {NUM_PRIOR_TASKS} tasks from the MDP")
        return draw_tasks(self.problem, NUM_PRIOR_TASKS, seed=self.settings.seed or 0)


def _distinct(tasks: Task) -> Task:
    """Return each task once."""
    rows = np.unique(np.hstack(tasks), axis=0)
    return Task(*np.split(rows, [tasks.start.shape[1]], axis=1))


def _has_all(evidence: Evidence, tasks: Task | None) -> bool:
    """Return whether there is evidence for all tasks, if any are asked for."""
    return tasks is None or not missing_rows(evidence, tasks)


def _missing(evidence: Evidence, tasks: Task) -> Task:
    """Return the tasks for which there is no evidence."""
    rows = missing_rows(evidence, tasks)
    return Task(tasks.start[rows], tasks.goal[rows])
