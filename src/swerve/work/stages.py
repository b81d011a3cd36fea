"""A problem and its work folder: opened, loaded, prepared.

Which results in the folder may be used depends on the stage:

- Opened: the folder's record is read. Results may be used if the record is current.
- Loaded: the problem itself is there; JAX and the user's code were imported for it. Results may be
  used if the record is current and has the fingerprint of the problem.
- Prepared: outdated results were moved aside and the record is that of the problem. Results may be
  used.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from swerve.base import files
from swerve.problem.loading import load_problem, source_hashes
from swerve.work.folder import Reading, State, WorkFolder
from swerve.work.settings import Settings

if TYPE_CHECKING:
    from swerve.problem.problem import Problem
    from swerve.problem.record import ProblemRecord


class Loaded(NamedTuple):
    """A problem that is loaded.

    Attributes:
      problem: the problem itself.
      record: the problem as data.
      is_recorded: whether the folder's record, as it was when opened, is of this problem.
    """

    problem: Problem
    record: ProblemRecord
    is_recorded: bool


class ProblemInFolder:
    """A problem and its folder, which pass through the three stages and never go back.

    Args:
      problem_text: a problem specification, see `loading.load_problem`.
      folder: folder of the results; None keeps no results.
      say: called with a line of text on each thing found or done.

    Attributes:
      opened: the folder's record as it was read first.

    Raises:
      ValueError: if the folder holds the results of another problem.
      store.StoreError: if the folder's record is cut short or altered.
    """

    def __init__(
        self, problem_text: str, folder: WorkFolder | None, say: Callable[[str], None]
    ) -> None:
        self._text, self._folder, self._say = problem_text, folder, say
        self.opened = Reading(State.ABSENT) if folder is None else folder.read()
        self._loaded: Loaded | None = None  # set once, by `load`
        self._is_prepared = False  # set once, by `prepare`
        if self.opened.state is State.OTHER_FORMAT:
            self._say_of_folder("is of another version of swerve: working it out anew")
        elif self.opened.state is State.CHANGED:
            self._say_outdated("; ".join(self.opened.changes))

    def load(self) -> Loaded:
        """Load the problem, the first time, and compare the folder's record with the problem."""
        if self._loaded is None:
            problem = load_problem(self._text)
            record, opened = problem.record, self.opened.record
            is_recorded = opened is not None and opened.fingerprint == record.fingerprint
            if opened is not None and not is_recorded:
                self._say_outdated("the problem has changed")
            self._loaded = Loaded(problem, record, is_recorded)
        return self._loaded

    def record(self) -> ProblemRecord:
        """Return the problem as data, from the folder if its results may be used."""
        return self.usable() or self.load().record

    def usable(self) -> ProblemRecord | None:
        """Return the record of the usable results, or None if no results may be used.

        Loads the problem only if judging a demonstration needs the problem's code.
        """
        opened = self.opened.record
        if self._loaded is not None or (opened is not None and opened.needs_code):
            return self.usable_once_loaded()
        return opened

    def usable_once_loaded(self) -> ProblemRecord | None:
        """Load the problem; return its record, or None if no results may be used."""
        loaded = self.load()
        return loaded.record if self._is_prepared or loaded.is_recorded else None

    def prepare(self, settings: Settings) -> None:
        """Make the folder ready to be written: no outdated results, the settings recorded.

        Args:
          settings: complete settings.

        Raises:
          ValueError: if there are results but no record: they may be somebody else's.
          OSError: if the folder cannot be written.
        """
        is_recorded = self.load().is_recorded
        if self._folder is None:
            return
        files.check_writable(self._folder.path)
        if not (self._is_prepared or (is_recorded and self.opened.settings == settings)):
            self.write_record(settings)
        self._is_prepared = True

    def write_record(self, settings: Settings) -> None:
        """Write the folder's record, if there is a folder; move outdated results aside first.

        Args:
          settings: complete settings.
        """
        if self._folder is None:
            return
        problem, record, is_recorded = self.load()
        is_current = self._is_prepared or is_recorded
        sources = source_hashes(problem)
        self._folder.write(record, settings, sources, is_current=is_current, moved=self._say_moved)

    def _say_moved(self, aside: Path) -> None:
        assert self._folder is not None
        self._say(f"moved the old results of {self._folder.path} to {aside}")

    def _say_outdated(self, changes: str) -> None:
        self._say_of_folder(f"is out of date ({changes}): working it out anew")

    def _say_of_folder(self, text: str) -> None:
        assert self._folder is not None
        self._say(f"{self._folder.path} {text}")
