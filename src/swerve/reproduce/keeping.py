"""Folders that keep slow results, with the wall time of each, also over interruptions."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from swerve.base import files, schema, store


class ClockData(schema.Data):
    """The fields of the file of a `Clock`."""

    seconds: dict[str, schema.Finite]
    finished: dict[str, str]


class Clock:
    """Wall time [s] of each piece of work by its name, kept in a file.

    The times of a piece of work that is interrupted and continued add up, unless the process is
    killed. A finished piece of work is not timed again: a later run only loads its result.

    Args:
      path: path of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        data = store.read_json(path) if path.exists() else {"seconds": {}, "finished": {}}
        stored = schema.checked(path, data, ClockData)
        self.seconds, self._finished = stored.seconds, stored.finished

    @contextmanager
    def timing(self, name: str, of: str = "") -> Iterator[None]:
        """Add the time of the block to the time under its name, unless the block finished before.

        Args:
          name: name of the piece of work.
          of: mark of its inputs; the time starts again from 0 where the mark has changed.
        """
        if self._finished.get(name) == of:
            yield
            return
        if name in self._finished:
            del self._finished[name], self.seconds[name]
        began = time.perf_counter()
        try:
            yield
            self._finished[name] = of
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
            store.write_json(self._path, {"seconds": self.seconds, "finished": self._finished})


class Keeping(NamedTuple):
    """Folder and settings of one run of a result.

    Attributes:
      folder: folder that keeps slow results.
      clock: wall times of the run.
      seed: seed of everything random.
      progress: whether to show progress bars.
    """

    folder: Path
    clock: Clock
    seed: int
    progress: bool

    @classmethod
    def at(cls, folder: Path, name: str, scale: Any, seed: int, progress: bool) -> Keeping:
        """Return the folder and settings of a run of one scale and seed, creating its folder.

        Args:
          folder: parent folder of all scales and seeds.
          name: name of the scale.
          scale: amount of work; its text is stored, to notice a change.
          seed: seed of everything random.
          progress: whether to show progress bars.

        Raises:
          ValueError: if the folder was filled by another version, or with another scale.
        """
        place = folder / f"{name}.seed{seed}"
        files.make_folder(place)
        path, made_by = place / "made_by.json", {"swerve": version("swerve"), "scale": repr(scale)}
        if not path.exists():
            store.write_json(path, made_by)
        elif store.read_json(path) != made_by:
            raise ValueError(
                f"{place}: was filled by another version of Swerve, or with other settings: remove "
                "the folder, or choose another one"
            )
        return cls(place, Clock(place / "seconds.json"), seed, progress)
