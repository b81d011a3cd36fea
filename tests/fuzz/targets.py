"""All that is fuzzed."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fuzz.records import Records, Specifications, WorkFolders
from fuzz.stores import CheckpointFiles, EvidenceFiles, ForesightFiles, NominalFiles
from fuzz.streams import Streams
from fuzz.tables import ParquetFiles, Tables, TasksFiles
from fuzz.target import FuzzError, Target, try_inputs

TARGETS: tuple[type[Target], ...] = (
    Tables,
    TasksFiles,
    Streams,
    EvidenceFiles,
    ParquetFiles,
    NominalFiles,
    ForesightFiles,
    CheckpointFiles,
    WorkFolders,
    Records,
    Specifications,
)


def tried(name: str, first: int, num: int) -> tuple[int, str]:
    """Try inputs of a target up to the first failure.

    Args:
      name: name of the target.
      first: number of the first input.
      num: number of inputs to try.

    Returns:
      The number of inputs that were tried, and the failure; "" if there was none.
    """
    (kind,) = (kind for kind in TARGETS if kind.name == name)
    passed = 0
    with tempfile.TemporaryDirectory() as folder:
        try:
            for _ in try_inputs(kind(Path(folder)), range(first, first + num)):
                passed += 1
        except FuzzError as error:
            return min(passed + 1, num), str(error)
    return passed, ""
