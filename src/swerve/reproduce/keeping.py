"""What takes long is kept, with the time that it took, also in parts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from swerve.base import store


class Clock:
    """Seconds by name, kept in a file.

    What was interrupted is added up when it goes on, unless the process was killed outright; what
    has finished is found again afterwards, and that does not count.

    Args:
      path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        stored = store.read_json(path) if path.exists() else {"seconds": {}, "finished": {}}
        self.seconds: dict[str, float] = stored["seconds"]
        self._finished: dict[str, str] = stored["finished"]

    @contextmanager
    def timing(self, name: str, of: str = "") -> Iterator[None]:
        """Add what the block takes to what is called so, unless it finished before.

        Args:
          name: what it is called.
          of: what it is done to; time begins anew where that is something else than before.
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
    """Where a result is made, and how.

    Attributes:
      folder: of what takes long, which is found again there.
      clock: of it.
      seed: of everything random.
      progress: whether to show progress bars.
    """

    folder: Path
    clock: Clock
    seed: int
    progress: bool

    @classmethod
    def at(cls, folder: Path, name: str, scale: Any, seed: int, progress: bool) -> Keeping:
        """Return that of one size and seed, in a folder of all sizes and seeds.

        Args:
          folder: of all of them.
          name: of the size.
          scale: how much is done; its text is kept, to be compared.
          seed: of everything random.
          progress: whether to show progress bars.

        Raises:
          ValueError: if what is there was made by another version, or with another scale.
        """
        place = folder / f"{name}.seed{seed}"
        place.mkdir(parents=True, exist_ok=True)
        path, made_by = place / "made_by.json", {"swerve": version("swerve"), "scale": repr(scale)}
        if not path.exists():
            store.write_json(path, made_by)
        elif store.read_json(path) != made_by:
            raise ValueError(
                f"{place}: holds what another version of Swerve made, or with other settings: "
                "remove it, or choose another folder"
            )
        return cls(place, Clock(place / "seconds.json"), seed, progress)
