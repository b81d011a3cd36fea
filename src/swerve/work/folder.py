"""The files of a work folder: their names, the record of the problem, results that are outdated.

    problem.json                                   the record: the problem as data, hashes of the
                                                   source files that made it, the settings used last
    <solver>.seed<S>.nominal                       the nominal distribution that the solver learned
    <solver>.seed<S>.<method>.<N>.evidence         what N trajectories per task tell
    <solver>.seed<S>.<method>.<N>.foresight        what a monitor needs besides the evidence
    <solver>.seed<S>.checkpoint                    training that has not finished
    <solver>.seed<S>.training.png                  a picture of how training went
    outdated/                                      all these files as they were before the problem
                                                   changed; `outdating/` while they are moved

A file is named after all settings that its contents depend on (`WorkFolder.result_path`), so that
other settings make another file. <solver> is percent-encoded: evidence by the solver
"grid?num_points=40" is in grid%3Fnum_points=40.seed0.smc.10000.evidence.

Several processes may work in one folder.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import msgspec
import numpy as np

from swerve.base import files, schema, store
from swerve.base.space import Task
from swerve.base.version import VERSION
from swerve.evidence.evidence import Evidence
from swerve.evidence.matching import find_each
from swerve.problem.loading import canonical_problem, file_hash
from swerve.problem.record import ProblemRecord
from swerve.problem.schema import stored_record
from swerve.work.outdated import RECORD, is_unfinished, recover, set_aside
from swerve.work.settings import Settings

RESULTS = ("*.nominal", "*.evidence", "*.foresight", "*.checkpoint", "*.training.png")
SAMPLED = ("evidence", "foresight")  # results that depend on the method and on N too
LONGEST_NAME = 230  # bytes of a result's name before its suffix; file systems hold 255 in all
FORMAT = 3  # of problem.json; increase it when its fields change


class SettingsData(msgspec.Struct):
    """The fields of `Settings` as they are stored; those of other versions are left out."""

    solver: str | None = None
    seed: schema.Seed | None = None
    method: str | None = None
    num_trajectories: schema.Count | None = None


class FolderData(schema.Data):
    """The fields of problem.json; the settings and the record are checked apart."""

    format: int
    problem: str
    record: dict[str, Any]
    settings: dict[str, Any]
    sources: dict[str, str]
    swerve: str


class State(Enum):
    """What a folder's record says of the results beside it."""

    ABSENT = "absent"  # there is no record
    OTHER_FORMAT = "other format"  # another version of Swerve wrote the record
    CHANGED = "changed"  # a source file or Swerve has changed since
    CURRENT = "current"  # no source file has changed: results can be used


@dataclass(frozen=True)
class Reading:
    """A folder's record as it was read at one moment.

    Attributes:
      state: what the record says of the results.
      record: the problem as data; None unless the state is CURRENT.
      settings: settings used last; all None if the state is ABSENT or OTHER_FORMAT.
      changes: texts that say what has changed; empty unless the state is CHANGED.
    """

    state: State
    record: ProblemRecord | None = None
    settings: Settings = Settings()  # noqa: RUF009  # immutable
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class WorkFolder:
    """A folder with the results of one problem.

    Attributes:
      path: the folder, which need not exist yet.
      problem_text: the problem's specification, see `loading.load_problem`.
    """

    path: Path
    problem_text: str

    def result_path(self, suffix: str, settings: Settings, method: str | None = None) -> Path:
        """Return the file of a result.

        Args:
          suffix: kind of the result, such as "nominal" or "evidence".
          settings: complete settings that the result was made with.
          method: method of sampling, in place of the settings' method.

        Raises:
          ValueError: if the settings of the solver are too long for the name of a file.
        """
        name = f"{quote(str(settings.solver), safe='=')}.seed{settings.seed}"
        if suffix in SAMPLED:
            name = f"{name}.{method or settings.method}.{settings.num_trajectories}"
        if len(name) > LONGEST_NAME:
            raise ValueError(
                f"solver: expected settings that fit in the name of a file, {LONGEST_NAME} "
                f"characters, got {len(name)}: {name[:60]}...; shorten them"
            )
        return self.path / f"{name}.{suffix}"

    def latest_solver(self, name: str, seed: int | None) -> str | None:
        """Return the solver, of this name and seed, whose nominal was written last.

        Returns:
          The solver's specification, settings included; None if there is no such nominal.
        """
        suffix = f".seed{seed}.nominal"
        held = sorted(self.path.glob(f"{name}*{suffix}"), key=lambda path: path.stat().st_mtime)
        return unquote(held[-1].name.removesuffix(suffix)) if held else None

    def read_evidence(
        self, settings: Settings, record: ProblemRecord, method: str | None = None
    ) -> Evidence | None:
        """Return the evidence that was made with some settings, or None if there is none.

        Args:
          settings: complete settings.
          record: record of the problem, with the code that judging demonstrations may need.
          method: method of sampling, in place of the settings' method.

        Raises:
          store.StoreError: if the file is cut short or altered, or its evidence is of another
            version of the problem.
        """
        path = self.result_path("evidence", settings, method)
        if not path.exists():
            return None
        evidence = Evidence.load(path)
        if evidence.problem.fingerprint != record.fingerprint:
            raise store.StoreError(
                path,
                "holds evidence of another version of the problem",
                "remove it, and it is made again",
            )
        if evidence.problem.needs_code:  # code, which no file can hold
            return dataclasses.replace(evidence, problem=record)
        return evidence

    def add_evidence(self, evidence: Evidence, settings: Settings, record: ProblemRecord) -> None:
        """Write evidence after the stored evidence, which another process may have added to.

        Of a task that both hold, the stored evidence is kept, with what either has resolved.
        """
        with self._locked():
            stored = self.read_evidence(settings, record)
            if stored is not None and _are_equal(stored.tasks, evidence.tasks):
                evidence = evidence.with_resolved(stored)  # no samples are read again
            elif stored is not None:
                rows = missing_rows(stored, evidence.tasks)
                stored = stored.with_resolved(evidence)
                evidence = stored.joined(evidence.select(rows)) if rows else stored
            evidence.save(self.result_path("evidence", settings))

    def read(self) -> Reading:
        """Read the record and compare it with the problem's text and with its source files.

        Needs neither JAX nor the user's code, so a change that no source file shows, such as one
        of a data file, is not noticed here.

        Raises:
          ValueError: if the folder holds the results of another problem.
          store.StoreError: if the record is cut short or altered, or holds what no record holds.
          OSError: if a move of outdated results was cut short, and the folder cannot be written.
        """
        if is_unfinished(self.path):
            with self._locked():
                pass
        path = self.path / RECORD
        if not path.exists():
            return Reading(State.ABSENT)
        data = store.read_json(path)
        asked = canonical_problem(self.problem_text)
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            return Reading(State.OTHER_FORMAT)
        stored = schema.checked(path, data, FolderData)
        if stored.problem != asked:
            raise ValueError(
                f"{self.path} holds the results of {stored.problem!r}, not of {asked!r}: "
                "name another --work folder"
            )
        schema.checked(path, stored.settings, SettingsData)
        with schema.contents(path):
            settings = Settings.from_json(stored.settings)
        changes = [
            f"{source} has changed"
            for source, old in stored.sources.items()
            if file_hash(Path(source)) != old
        ]
        if stored.swerve != VERSION:
            changes.append(f"swerve was {stored.swerve} and is {VERSION}")
        if changes:
            return Reading(State.CHANGED, settings=settings, changes=tuple(changes))
        return Reading(State.CURRENT, stored_record(path, stored.record), settings)

    def write(
        self,
        record: ProblemRecord,
        settings: Settings,
        sources: dict[str, str],
        *,
        is_current: bool,
        moved: Callable[[Path], None],
    ) -> None:
        """Write the record, after moving outdated results aside.

        Args:
          record: the problem as data.
          settings: complete settings that are used now.
          sources: hash of each source file that made the problem.
          is_current: whether the results are known to be of this problem. If not, the record is
            read again, since another process may have written one for this problem.
          moved: called, before the record is written, with the folder that outdated results are in
            now, if there were any.

        Raises:
          ValueError: if there are results but no record: they may be somebody else's.
          OSError: if the folder cannot be written.
        """
        with self._locked():
            aside = None if is_current or self._is_of(record) else self._move_aside()
            if aside is not None:
                moved(aside)
            data = {
                "format": FORMAT,
                "problem": canonical_problem(self.problem_text),
                "record": record.to_json(),
                "settings": dataclasses.asdict(settings),
                "sources": sources,
                "swerve": VERSION,
            }
            store.write_json(self.path / RECORD, data)

    def _is_of(self, record: ProblemRecord) -> bool:
        """Return whether the folder's record, read now, is current and of this problem."""
        found = self.read().record
        return found is not None and found.fingerprint == record.fingerprint

    def _move_aside(self) -> Path | None:
        """Move all results aside, since they are outdated; remove those moved aside before."""
        results = [path for pattern in RESULTS for path in self.path.glob(pattern)]
        if not results:
            return None
        if not (self.path / RECORD).exists():
            raise ValueError(
                f"{self.path} holds {results[0].name} but no {RECORD}, so it is no work "
                "folder of swerve: name another --work folder"
            )
        return set_aside(self.path, results)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Hold the folder's lock; first undo or finish a move of results that was cut short."""
        with files.locked(self.path):
            recover(self.path)
            yield


def _are_equal(tasks: Task, others: Task) -> bool:
    """Return whether tasks are the very same, in the same order: then their samples are too."""
    return [part.tobytes() for part in tasks] == [part.tobytes() for part in others]


def missing_rows(evidence: Evidence, tasks: Task) -> list[int]:
    """Return the rows of the tasks that evidence lacks."""
    return np.flatnonzero(find_each(evidence.problem, evidence.tasks, tasks) < 0).tolist()
