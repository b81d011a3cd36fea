"""Read Parquet with polars, in a process of its own.

A damaged file can end the process that decodes it: polars aborts where it cannot get the memory
that such a file asks for. So the process is another one, with limits of time and memory
(`parquet_child`). It starts with the first Parquet file (0.3 s), reads all further files, and ends
with this process. It gets the content of a file, never its path: polars takes a path for a pattern
or an address.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from swerve.base.phrases import cut, shown
from swerve.demonstrations.tables import Table, file_content, select_columns

CHILD = Path(__file__).with_name("parquet_child.py")
MARK = b"PAR1"  # the first and the last bytes
LEAST = 12  # bytes of a file without rows or columns: two marks, and the length of the footer
MAX_REASON = 200  # characters of polars' reason in a message

_lock = threading.Lock()
_running: list[tuple[int, subprocess.Popen[bytes]]] = []  # this process's id, and its child


def read_parquet(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    """Read columns of a Parquet file; see `formats.read_table`."""
    answer, numbers = _decoded(path, [*required, *optional], label)
    found, types, nulls = answer["found"], answer["types"], answer["nulls"]
    names = select_columns(path, found, required, optional, label)
    for name in types:
        expected = "texts" if name == label else "numbers"
        raise ValueError(f"{path}: column {name}: expected {expected}, got {types[name]} values")
    for name, row in nulls.items():
        if name not in optional:
            expected = "text" if name == label else "number"
            raise ValueError(
                f"{path}: row {row + 1}, column {name}: expected a {expected}, got null"
            )
    unread = tuple(name for name in found if name not in (*names, label))
    return Table(names, numbers, answer["labels"], None, unread)


def _decoded(path: Path, names: list[str], label: str | None) -> tuple[Any, np.ndarray]:
    """Return the child's answer and the numbers [rows, names].

    Raises:
      ValueError: if the file cannot be decoded.
    """
    content = file_content(path)
    _check_marks(path, content)
    request = json.dumps({"size": len(content), "numbers": names, "label": label}).encode()
    with _lock:
        is_fresh = not _held()
        try:
            reply = _ask(request, content)
            if reply is None and not is_fresh:  # perhaps an earlier file, or a fork, did it
                reply = _ask(request, content)
        except BaseException:
            _end()  # an answer that nobody waits for would be taken for the next one
            raise
    if reply is None:
        raise ValueError(f"{path}: cannot be read as Parquet: damaged, or it needs too much memory")
    answer, columns = reply
    if "error" in answer:
        reason = cut(shown(answer["error"]), MAX_REASON)
        raise ValueError(f"{path}: cannot be read as Parquet: {reason}")
    return answer, np.ascontiguousarray(columns.T)


def _check_marks(path: Path, content: bytes) -> None:
    """Raise ValueError unless content begins and ends as Parquet does."""
    if not content.startswith(MARK):
        found = f"it does not begin with {MARK.decode()}" if content else "the file is empty"
        raise ValueError(
            f"{path}: cannot be read as Parquet: {found}; save it as Parquet, or name it .csv if "
            "it is CSV"
        )
    if len(content) < LEAST or not content.endswith(MARK):
        raise ValueError(
            f"{path}: cannot be read as Parquet: it is cut short, after {len(content):,} bytes, "
            f"since Parquet ends with {MARK.decode()}; copy it again from its source"
        )


def _ask(request: bytes, content: bytes) -> tuple[Any, np.ndarray] | None:
    """Return the child's answer and columns [names, rows]; None if the child has ended."""
    child = _held() or _start()
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        for part in (request, b"\n", content):
            child.stdin.write(part)
        child.stdin.flush()
        line = child.stdout.readline()
        answer = json.loads(line)
        shape = (0, 0) if "error" in answer else (len(answer["names"]), answer["rows"])
        numbers = child.stdout.read(8 * shape[0] * shape[1])
        return answer, np.frombuffer(numbers).reshape(shape)
    except (BrokenPipeError, ValueError):
        _end()
        return None


def _held() -> subprocess.Popen[bytes] | None:
    """Return this process's child; None if there is none."""
    return next((child for owner, child in _running if owner == os.getpid()), None)


def _start() -> subprocess.Popen[bytes]:
    """Start a child that finds polars where this process would, and nothing of the user's."""
    specs = [find_spec(name) for name in ("numpy", "polars")]
    places = [str(Path(spec.origin).parents[1]) for spec in specs if spec and spec.origin]
    child = subprocess.Popen(
        [sys.executable, "-I", str(CHILD), *places],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd="/",
        env=os.environ | {"POLARS_MAX_THREADS": "1"},
    )
    _running[:] = [(os.getpid(), child)]
    return child


def _end() -> None:
    """End this process's child."""
    child = _held()
    _running.clear()
    if child is not None:
        child.kill()
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):  # it holds what the child never took
                    pipe.close()


atexit.register(_end)
