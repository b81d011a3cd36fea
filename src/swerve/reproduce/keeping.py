"""How long what took, also in parts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swerve import store


class Clock:
    """Seconds by name, kept in a file.

    What was interrupted is added up when it goes on; what has finished is found again afterwards,
    and that does not count.

    Args:
      path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        stored = store.read_json(path) if path.exists() else {"seconds": {}, "finished": []}
        self.seconds: dict[str, float] = stored["seconds"]
        self._finished: list[str] = stored["finished"]

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add what the block takes to what is called so, unless it finished before."""
        if name in self._finished:
            yield
            return
        began = time.perf_counter()
        try:
            yield
            self._finished.append(name)
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
            store.write_json(self._path, {"seconds": self.seconds, "finished": self._finished})


def work_folder(folder: Path, is_quick: bool, seed: int) -> Path:
    """Return where a result of this size and seed keeps what takes long."""
    place = folder / f"{'quick' if is_quick else 'full'}.seed{seed}"
    place.mkdir(parents=True, exist_ok=True)
    return place
