"""Write and read checkpoints: files from which an interrupted training goes on."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swerve.base import store
from swerve.problem.problem import Problem

VERSION = 5


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The file of one run; without a path nothing is written and nothing is found.

    Attributes:
      path: path of the file, or None.
      problem: problem that is learned.
      settings: the solver, a dataclass of settings.
      seed: seed of the run.
      teacher: fingerprint of the policy that the run imitates; empty if there is none.
    """

    path: Path | None
    problem: Problem
    settings: Any
    seed: int
    teacher: str = ""

    def save(self, arrays: dict[str, np.ndarray]) -> None:
        """Write the arrays, atomically."""
        if self.path is not None:
            store.write(self.path, self._kind, VERSION, self._header, arrays)

    def load(self) -> dict[str, np.ndarray] | None:
        """Return the arrays written last, or None where there is no file.

        Raises:
          ValueError: if the file is of another run.
          store.StoreError: if the file is cut short, altered, or of another kind or version.
        """
        if self.path is None or not self.path.exists():
            return None
        with store.open_file(self.path, self._kind, VERSION) as stored:
            for key, value in self._header.items():
                found = stored.header.get(key)
                if found != value:
                    raise ValueError(
                        f"{self.path} is a checkpoint of another run: its {key} is {found}, this "
                        f"run's is {value}. Give that run's {key}, or remove the file to start anew"
                    )
            return {name: stored.array(name) for name in stored.names}

    @property
    def _kind(self) -> str:
        return f"swerve-{self.settings.name}-checkpoint"

    @property
    def _header(self) -> dict[str, Any]:
        return {
            "problem": self.problem.record.fingerprint,
            "settings": dataclasses.asdict(self.settings),
            "seed": self.seed,
            "teacher": self.teacher,
        }
