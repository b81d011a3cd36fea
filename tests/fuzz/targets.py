"""All that is fuzzed."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fuzz.stores import EvidenceFiles, Records, Specifications
from fuzz.streams import Streams
from fuzz.tables import ParquetFiles, Tables, TasksFiles
from fuzz.target import FuzzError, Target, try_inputs

TARGETS: tuple[type[Target], ...] = (
    Tables,
    TasksFiles,
    Streams,
    EvidenceFiles,
    ParquetFiles,
    Records,
    Specifications,
)


def tried(name: str, first: int, num: int) -> tuple[int, str]:
    """Try `num` inputs of a target; return their number and the failure, if any."""
    (kind,) = (kind for kind in TARGETS if kind.name == name)
    with tempfile.TemporaryDirectory() as folder:
        try:
            for _ in try_inputs(kind(Path(folder)), range(first, first + num)):
                pass
        except FuzzError as error:
            return num, str(error)
    return num, ""
