"""Files that hold results: atomic, versioned, checksummed, and never a pickle.

    file = ZIP(header.json, <name>.npy, ...),   uncompressed, one CRC-32 for each member

header.json has the keys `format` (the kind of file), `version`, `arrays` (their names) and those
of the caller. Members are read and verified one by one, when they are first asked for, so a
summary costs nothing of the bulk stored beside it; any ZIP tool and `numpy.load` read the file
too. Small records are JSON with the CRC-32 of their own canonical text.

A file is written beside its final place under another name, `.<file>.tmp`, and moved when it is
complete: readers see the old content or the new. Reading changes nothing.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

if TYPE_CHECKING:
    import zipfile

HEADER = "header.json"
RESERVED = ("format", "version", "arrays")

ARRAY_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*")
ARRAY_KINDS = "biufcU"
"""What may be stored: booleans, numbers and text; no objects, whose files would be pickles."""

AnyPath = str | os.PathLike[str]


class StoreError(ValueError):
    """A stored file that cannot be used: cut short, altered, or of another kind or version."""

    def __init__(self, path: AnyPath, problem: str, remedy: str) -> None:
        super().__init__(f"{path}: {problem}. The file was left as it was; {remedy}")


class StoredFile:
    """A stored file, open for reading; made by `open_file`, closed by `with` or when dropped.

    What it reads is what the path held when it was opened, even if that is replaced meanwhile.

    Attributes:
      path: the file.
      header: what was given to `write` as header.
      names: the names of the arrays.
    """

    def __init__(
        self, path: Path, archive: zipfile.ZipFile, header: dict[str, Any], names: tuple[str, ...]
    ) -> None:
        self.path = path
        self.header = header
        self.names = names
        self._archive = archive

    def array(self, name: str) -> np.ndarray:
        """Read and verify an array.

        Raises:
          StoreError: if there is no such array, or it was altered.
        """
        if name not in self.names:
            raise StoreError(
                self.path,
                f"no array {name!r}, only {', '.join(self.names) or 'none'}",
                "make it again with this version of swerve",
            )
        data = io.BytesIO(_read_member(self.path, self._archive, f"{name}.npy"))
        try:
            return np.lib.format.read_array(data, allow_pickle=False)
        except ValueError as error:
            raise _altered(self.path, f"array {name!r} cannot be read ({error})") from error

    def close(self) -> None:
        """Close the file; no array can be read afterwards."""
        self._archive.close()

    def __enter__(self) -> StoredFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def write(
    path: AnyPath,
    kind: str,
    version: int,
    header: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
) -> None:
    """Write a file, atomically; its folder is created if need be.

    Args:
      path: where; a file that is there is replaced.
      kind: what the file holds, such as "evidence".
      version: of this kind's contents; increase it when they change.
      header: JSON data, with none of the keys in RESERVED.
      arrays: numbers, booleans or text of any shape, by name; a name may have parts, as in "a/b".

    Raises:
      ValueError: if a name or a dtype cannot be stored, or the header has NaN or infinite numbers.
      TypeError: if the header holds what JSON cannot.
      OSError: if the folder cannot be written; then the file that was there is still there.
    """
    import zipfile  # takes 10 ms

    arrays = {name: _storable(name, array) for name, array in arrays.items()}
    clash = [key for key in RESERVED if key in header]
    if clash:
        raise ValueError(f"header: the keys {', '.join(RESERVED)} are taken, got {clash}; rename")
    fields = {"format": kind, "version": version, "arrays": list(arrays), **header}
    text = json.dumps(fields, allow_nan=False)

    def member(name: str) -> zipfile.ZipInfo:
        info = zipfile.ZipInfo(name)  # dated 1980: equal contents make equal files
        info.external_attr = 0o644 << 16
        return info

    def write_to(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(member(HEADER), text)
            for name, array in arrays.items():
                with archive.open(member(f"{name}.npy"), "w", force_zip64=True) as stream:
                    np.lib.format.write_array(stream, array, allow_pickle=False)

    _replace(Path(path), write_to)


def open_file(path: AnyPath, kind: str, version: int) -> StoredFile:
    """Open a file and verify its header.

    Args:
      path: the file.
      kind: what it has to hold.
      version: the version that can be read.

    Raises:
      StoreError: if it is cut short, altered, not a Swerve file, or of another kind or version.
      OSError: if it does not exist or cannot be opened.
    """
    import zipfile

    path = Path(path)
    with path.open("rb") as file:
        magic = file.read(4)
    if not b"PK\x03\x04".startswith(magic):
        raise _foreign(path, "not a Swerve file, or altered where it begins")
    try:
        archive = zipfile.ZipFile(path)
    except Exception as error:  # damage shows as any of a dozen types
        raise _altered(path, f"cut short or altered ({error})") from error
    if HEADER not in archive.namelist():
        raise _foreign(path, f"not a Swerve file, or altered: it has no {HEADER}")
    header = _parse(path, _read_member(path, archive, HEADER))
    if not all(key in header for key in RESERVED):
        raise _foreign(path, f"not a Swerve file: its {HEADER} lacks one of {', '.join(RESERVED)}")
    found_kind, found_version, names = (header.pop(key) for key in RESERVED)
    if found_kind != kind:
        raise StoreError(
            path, f"expected a file of kind {kind!r}, got {found_kind!r}", "give the other file"
        )
    if found_version > version:
        raise StoreError(
            path,
            f"written in version {found_version} of kind {kind!r}, this swerve reads {version}",
            "upgrade swerve: pip install --upgrade swerve",
        )
    if found_version < version:
        raise StoreError(
            path,
            f"written in version {found_version} of kind {kind!r}, this swerve reads {version} "
            f"and no longer that one",
            "make it again, or read it with the swerve that wrote it",
        )
    if set(archive.namelist()) != {HEADER, *(f"{name}.npy" for name in names)}:
        raise _altered(path, f"altered: expected the arrays {', '.join(names)} and no others")
    return StoredFile(path, archive, header, tuple(names))


def write_json(path: AnyPath, data: Any) -> None:
    """Write a small record of JSON data, atomically; its folder is created if need be.

    Raises:
      ValueError: if the data have NaN or infinite numbers.
      TypeError: if the data hold what JSON cannot.
      OSError: if the folder cannot be written; then the file that was there is still there.
    """
    record = {"crc32": _checksum(data), "data": data}
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    write_text(path, text)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file, atomically; its folder is created if need be.

    Raises:
      OSError: if the folder cannot be written; then the file that was there is still there.
    """
    write_bytes(path, text.encode())


def write_bytes(path: AnyPath, content: bytes) -> None:
    """Write any file, atomically; its folder is created if need be.

    Raises:
      OSError: if the folder cannot be written; then the file that was there is still there.
    """
    _replace(Path(path), lambda file: file.write(content))


def read_json(path: AnyPath) -> Any:
    """Read a record that `write_json` wrote.

    Raises:
      StoreError: if it is cut short, altered, or not such a record.
      OSError: if it does not exist or cannot be opened.
    """
    path = Path(path)
    record = _parse(path, path.read_bytes())
    if record.keys() != {"crc32", "data"}:
        raise _foreign(path, "not a Swerve record, or altered: expected the keys crc32 and data")
    if record["crc32"] != _checksum(record["data"]):
        raise _altered(path, "altered: its checksum does not match its data")
    return record["data"]


@contextlib.contextmanager
def locked(directory: AnyPath) -> Iterator[None]:
    """Hold the lock of a folder, so that what is read there is still so when it is written.

    Whoever comes second waits. Where there are no locks, as on some network folders, nobody does.
    """
    with (Path(directory) / ".lock").open("ab") as file:
        with contextlib.suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def check_writable(directory: AnyPath) -> None:
    """Create a folder if need be and make sure of writing in it, before work that takes minutes.

    Raises:
      OSError: if it cannot be written.
    """
    import tempfile

    directory = Path(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise _cannot_write(directory, error) from error


def _storable(name: str, array: np.ndarray) -> np.ndarray:
    array = np.asarray(array)
    if not ARRAY_NAME.fullmatch(name):
        raise ValueError(f"array {name!r}: expected letters, digits, _, -, . and / in its name")
    if array.dtype.kind not in ARRAY_KINDS:
        raise ValueError(
            f"array {name!r}: cannot store dtype {array.dtype}; expected booleans, numbers or text"
        )
    return array


def _read_member(path: Path, archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        return archive.read(name)  # which compares the CRC-32
    except MemoryError:
        raise
    except Exception as error:  # damage shows as any of a dozen types
        raise _altered(path, f"altered ({error})") from error


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    try:
        data = json.loads(text)
    except ValueError as error:
        raise _altered(path, f"cut short or altered, not JSON ({error})") from error
    if not isinstance(data, dict):
        raise _foreign(path, "not a Swerve file: expected a JSON object")
    return data


def _checksum(data: Any) -> str:
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return f"{zlib.crc32(canonical.encode()):08x}"


def _replace(path: Path, write_to: Callable[[BinaryIO], object]) -> None:
    """Write a file under another name and move it to its place when it is complete."""
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
    """Open the temporary file; who comes second waits, and a killed process has lost its lock."""
    while True:
        file = os.fdopen(os.open(temporary, os.O_RDWR | os.O_CREAT, 0o666), "r+b")
        with contextlib.suppress(OSError):  # some network folders have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        with contextlib.suppress(FileNotFoundError):  # moved or removed by who came first
            if os.path.samestat(os.fstat(file.fileno()), temporary.stat()):
                file.truncate()
                return file
        file.close()


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # some network folders cannot; the file itself is safe
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


def _altered(path: Path, problem: str) -> StoreError:
    return StoreError(path, problem, "copy it again from its source, or make it again")


def _foreign(path: Path, problem: str) -> StoreError:
    return StoreError(path, problem, "give a file that swerve wrote")
