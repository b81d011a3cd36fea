"""Write files so that readers see the old content or the new content, never a part of it.

A file is written beside its final place under a random name, `.swerve.<16 digits>.tmp`, and moved
to its place when it is complete. Nothing else in Swerve opens a file for writing. Links are never
followed: a link at the final place is replaced by the file, and what the link leads to stays as it
is. Only the umask decides who may read a file.

A writer holds a lock on its temporary file. So what a killed writer left is known by its missing
lock, and goes with the next write of another process into the folder.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from swerve.base.interrupts import saving

AnyPath = str | os.PathLike[str]

TEMPORARY = re.compile(r"\.swerve\.[0-9a-f]{16}\.tmp")
_KINDS = {
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
}
_SWEPT: set[Path] = set()  # folders that this process has cleared of leftovers


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


def replace(path: Path, write_to: Callable[[BinaryIO], object]) -> None:
    """Write a file under another name and move it to its place when it is complete.

    Args:
      path: the file; its folder is created if need be, and a link there is replaced.
      write_to: function that writes the content to an open file.

    Raises:
      OSError: if the folder cannot be written, or there is a folder, a pipe or a device in the
        file's place; a file that existed there is still there.
    """
    _check_replaceable(path)
    try:
        make_folder(path.parent)
        with saving():
            with _temporary_file(path.parent) as (temporary, file):
                write_to(file)
                file.flush()
                os.fsync(file.fileno())
                temporary.replace(path)
            _sync_folder(path.parent)
    except OSError as error:
        raise _cannot_write(path.parent, error, path.name) from error


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder to fill, which is moved to its place when the block ends.

    Without a block that ends there is no folder at all.

    Raises:
      OSError: if the folder cannot be written, or a folder with files or a link that leads nowhere
        is there already.
    """
    check_link(path)
    try:
        make_folder(path.parent)
        temporary, descriptor = _temporary_folder(path.parent)
    except OSError as error:
        raise _cannot_write(path.parent, error, path.name) from error
    try:
        yield temporary
        _sync_folder(temporary)
        move(temporary, path)
    except BaseException:
        remove(temporary)
        raise
    finally:
        os.close(descriptor)


def check_link(path: Path) -> None:
    """Raise FileExistsError for a link that leads nowhere: no folder can take its place."""
    if path.is_symlink() and not path.exists():
        raise FileExistsError(f"{path} is a link that leads nowhere; remove it or choose another")


def make_folder(folder: Path) -> None:
    """Create a folder if need be, and remove what killed writers left in it."""
    folder.mkdir(parents=True, exist_ok=True)
    place = folder.absolute()
    if place not in _SWEPT:
        _SWEPT.add(place)
        with contextlib.suppress(OSError):  # a folder may be writable and yet not readable
            for entry in list(place.iterdir()):
                if TEMPORARY.fullmatch(entry.name):
                    _remove_leftover(entry)


def new_folder(folder: Path) -> None:
    """Create a folder that must not exist yet.

    Raises:
      OSError: if the folder cannot be created, or something has its name.
    """
    try:
        folder.mkdir()
    except OSError as error:
        raise _cannot_write(folder.parent, error, folder.name) from error


def move(path: Path, target: Path) -> None:
    """Rename a file, a folder or a link, within one file system and in one step.

    Raises:
      OSError: if one of the folders cannot be written.
    """
    try:
        path.rename(target)
    except OSError as error:
        raise _cannot_write(target.parent, error, target.name) from error
    _sync_folder(target.parent)


def remove(path: Path) -> None:
    """Remove a file, or a folder with everything in it; links are removed, not followed."""
    import shutil  # the import takes 5 ms

    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def open_regular(path: AnyPath) -> BinaryIO:
    """Open a file for reading, after checking that it is a regular file or a link to one.

    Reading from anything else may never end.

    Raises:
      OSError: if there is no file, the file cannot be opened, or it is a folder, a pipe or a
        device.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe would wait for a writer
    try:
        _check_regular(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


@contextlib.contextmanager
def locked(directory: AnyPath) -> Iterator[None]:
    """Hold the lock of a folder, so that nothing changes there between a read and a write.

    A second process waits. On network folders without locks no process waits.

    Raises:
      OSError: if the lock is a link, a pipe or a device.
    """
    path = Path(directory) / ".lock"
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        raise _cannot_write(Path(directory), error, path.name) from error
    try:
        _check_regular(path, os.fstat(descriptor))
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def check_writable(directory: AnyPath) -> None:
    """Create a folder if need be and check that it can be written, before minutes of work.

    Raises:
      OSError: if the folder cannot be written.
    """
    directory = Path(directory)
    try:
        make_folder(directory)
        with _temporary_file(directory) as (temporary, _):
            temporary.unlink()
    except OSError as error:
        raise _cannot_write(directory, error) from error


@contextlib.contextmanager
def _temporary_file(folder: Path) -> Iterator[tuple[Path, BinaryIO]]:
    """Yield a new file of a random name in a folder, locked; removed if the block fails."""
    while True:
        path = folder / _random_name()
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        with os.fdopen(os.open(path, flags, 0o666), "r+b") as file:
            try:
                if not _lock_alone(file.fileno(), path):
                    continue
                yield path, file
            except BaseException:
                path.unlink(missing_ok=True)
                raise
            return


def _temporary_folder(parent: Path) -> tuple[Path, int]:
    """Return a new folder of a random name in a folder, and its descriptor, which holds a lock."""
    while True:
        path = parent / _random_name()
        path.mkdir()
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except FileNotFoundError:  # another process took the folder for a leftover
            continue
        except OSError:
            path.rmdir()
            raise
        if _lock_alone(descriptor, path):
            return path, descriptor
        os.close(descriptor)


def _lock_alone(descriptor: int, path: Path) -> bool:
    """Lock what is new; return False where another process took it for a leftover meanwhile."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network folders have no locks, and there no leftover is removed
        return True
    return path.exists()


def _remove_leftover(path: Path) -> None:
    """Remove a temporary file or folder unless its writer is still alive."""
    with contextlib.suppress(OSError):  # gone, of somebody else, or locked by its writer
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove(path)
        finally:
            os.close(descriptor)


def _random_name() -> str:
    return f".swerve.{os.urandom(8).hex()}.tmp"


def _check_replaceable(path: Path) -> None:
    """Raise OSError where a folder, a pipe or a device is in the place of a file."""
    try:
        found = path.stat()
    except OSError:  # nothing there, a link that leads nowhere, or a folder that is not there yet
        return
    _check_regular(path, found)


def _check_regular(path: AnyPath, found: os.stat_result) -> None:
    """Raise OSError for anything but a regular file."""
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "special file")
        raise OSError(f"{path}: expected a file, got a {kind}: name another file")


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # network folders may refuse; the file itself is safe
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _cannot_write(folder: Path, error: OSError, name: str = "") -> OSError:
    what = f"cannot write {name} in {folder}" if name else f"cannot write in {folder}"
    reason = error.strerror
    if isinstance(error, FileExistsError | NotADirectoryError):
        files = [path for path in (folder, *folder.parents) if path.exists() and not path.is_dir()]
        reason = f"{files[0]} is a file, no folder" if files else reason
    return OSError(
        error.errno, f"{what}: {reason}; choose a folder that you can write, with space left"
    )
