"""How long what took, also in parts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from swerve import store


class Clock:
    """Seconds by name, kept in a file, so that what was interrupted is added up.

    Args:
      path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seconds: dict[str, float] = store.read_json(path) if path.exists() else {}

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add what the block takes to what is called so."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
            store.write_json(self._path, self.seconds)
