"""Write files so that readers see the old content or the new content, never a part of it.

A file is written beside its final place under another name, `.<file>.tmp`, and moved to its place
when it is complete. A lock on the temporary file makes a second writer wait.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

AnyPath = str | os.PathLike[str]


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file at once; its folder is created if need be.

    Raises:
      OSError: if the folder cannot be written; a file that existed there is still there.
    """
    write_bytes(path, text.encode())


def write_bytes(path: AnyPath, content: bytes) -> None:
    """Write a file at once; its folder is created if need be.

    Raises:
      OSError: if the folder cannot be written; a file that existed there is still there.
    """
    replace(Path(path), lambda file: file.write(content))


def open_regular(path: AnyPath, most: int) -> BinaryIO:
    """Open a file that others may have made, to read it.

    A pipe or a device would be waited for, or read without an end: such files are refused.

    Args:
      path: a regular file, or a link to one.
      most: number of bytes that the file may have.

    Raises:
      OSError: if the file does not exist, or is no regular file.
      ValueError: if the file has more bytes.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
            raise OSError(f"{path}: expected a regular file, got {kind}")
        if found.st_size > most:
            raise ValueError(f"{path}: {found.st_size:,} bytes, expected at most {most:,}")
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


@contextlib.contextmanager
def locked(directory: AnyPath) -> Iterator[None]:
    """Hold the lock of a folder, so that nothing changes there between a read and a write.

    A second process waits. On network folders without locks no process waits.
    """
    with (Path(directory) / ".lock").open("ab") as file:
        with contextlib.suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def check_writable(directory: AnyPath) -> None:
    """Create a folder if need be and check that it can be written, before minutes of work.

    Raises:
      OSError: if the folder cannot be written.
    """
    import tempfile

    directory = Path(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise _cannot_write(directory, error) from error


def replace(path: Path, write_to: Callable[[BinaryIO], object]) -> None:
    """Write a file under another name and move it to its place when it is complete.

    Raises:
      OSError: if the folder cannot be written; a file that existed there is still there.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _open_alone(temporary) as file:
            try:
                write_to(file)
                file.flush()
                os.fsync(file.fileno())
                temporary.replace(path)
            except BaseException:
                temporary.unlink()
                raise
        _sync_folder(path.parent)
    except OSError as error:
        raise _cannot_write(path.parent, error, path.name) from error


def _open_alone(temporary: Path) -> BinaryIO:
    """Open and lock the temporary file; a second writer waits until the first is done or killed."""
    while True:
        file = os.fdopen(os.open(temporary, os.O_RDWR | os.O_CREAT, 0o666), "r+b")
        with contextlib.suppress(OSError):  # some network folders have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):  # the first writer moved or removed the file
            if os.path.samestat(os.fstat(file.fileno()), temporary.stat()):
                file.truncate()
                return file
        file.close()


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # network folders may refuse; the file itself is safe
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _cannot_write(folder: Path, error: OSError, name: str = "") -> OSError:
    what = f"cannot write {name} in {folder}" if name else f"cannot write in {folder}"
    return OSError(
        error.errno,
        f"{what}: {error.strerror}; choose a folder that you can write, with space left",
    )
