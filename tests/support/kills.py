"""Simulate that a process is killed at one of its file operations.

An operation is whatever Python reports to its audit hooks before it opens a file for writing, and
before it makes, moves or removes a file, or a flush to the disk. Killed at operation k, a process
has done the k operations before it. `Killed` is raised there, and at every operation after it: so
that no `except` and no `finally` can still clean up, as none can where the process is gone.

What is simulated: the process itself goes on, so its memory and its threads outlive the kill, and
its locks are let go only when its files are closed. A write is taken to reach the disk as a whole.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

MOVING = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.truncate", "os.link", "os.symlink"}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Killed(BaseException):
    """Raised in place of a kill."""


class Watch:
    """Counts the operations below a folder; from operation `number` on, each is a kill."""

    def __init__(self, root: Path, number: int | None) -> None:
        self.root, self.number, self.done = str(root), number, 0

    @property
    def is_dead(self) -> bool:
        """Whether the kill has happened."""
        return self.number is not None and self.done > self.number

    def operation(self) -> None:
        """Count an operation, or kill."""
        if self.number is None or self.done < self.number:
            self.done += 1
            return
        self.done = self.number + 1
        raise Killed


_watch: Watch | None = None


def _hook(event: str, arguments: tuple[object, ...]) -> None:
    if _watch is None or not (event == "open" or event in MOVING):
        return
    if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & WRITING):
        return
    path = arguments[0]
    if isinstance(path, int):  # an open file
        return
    name = os.fsdecode(path)  # pyright: ignore[reportArgumentType]
    if name.startswith(_watch.root) or not name.startswith("/"):  # within a folder: rmtree
        _watch.operation()


sys.addaudithook(_hook)


@contextlib.contextmanager
def killed_at(number: int | None, root: Path) -> Iterator[Watch]:
    """Kill the block at an operation below a folder; without a number only count them."""
    global _watch  # noqa: PLW0603  # an audit hook is for good and for the whole process
    fsync = os.fsync

    def counted(descriptor: int) -> None:
        watch.operation()
        fsync(descriptor)

    watch = _watch = Watch(root, number)
    os.fsync = counted
    try:
        yield watch
    except Killed:
        pass
    finally:
        _watch, os.fsync = None, fsync
