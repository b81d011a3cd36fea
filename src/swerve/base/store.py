"""Store results in files that are versioned and checksummed, and never a pickle.

    file = ZIP(header.json, <name>.npy, ...),   uncompressed, one CRC-32 for each member

header.json has the keys `format` (the kind of file), `version`, `arrays` (the names of the arrays)
and the keys of the caller. Each member is read and verified when it is first needed, so that
reading a summary does not read the large arrays stored beside it. Any ZIP tool and `numpy.load`
read the file too. Small records are JSON with the CRC-32 of their own canonical text.

Files are written as in `files`: readers see the old content or the new content. Reading changes
nothing. Reading arrays takes no more memory than the file has bytes: only regular files are read,
members are not compressed and together no larger than the file, and the size of an array is that of
its member. JSON takes more memory than it has bytes, and is limited in size, items and depth, so
that reading it takes some 1 GB at most. `schema` checks what a file holds.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from swerve.base import json_text
from swerve.base.files import AnyPath, open_regular, replace, write_text

if TYPE_CHECKING:
    import zipfile

HEADER = "header.json"
RESERVED = ("format", "version", "arrays")
"""Keys that every header has, and that a caller may not use."""

ARRAY_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*")
ARRAY_KINDS = "biufcU"
"""Kinds of dtype that may be stored: booleans, numbers and text; objects would be pickled."""


class StoreError(ValueError):
    """Raised for a stored file that is cut short, altered, or of another kind or version."""

    def __init__(self, path: AnyPath, problem: str, remedy: str) -> None:
        super().__init__(f"{path}: {problem}. The file was left as it was; {remedy}")
        self._arguments = path, problem, remedy

    def __reduce__(self) -> tuple[type[StoreError], tuple[AnyPath, str, str]]:
        return StoreError, self._arguments  # an exception is made again from its message alone


class StoredFile:
    """A stored file, open for reading; made by `open_file`, closed by `with` or when dropped.

    The content stays as it was when the file was opened, even if the file is replaced meanwhile.

    Attributes:
      path: the file.
      header: the header that was given to `write`.
      names: the names of the arrays.
    """

    def __init__(
        self,
        path: Path,
        file: BinaryIO,
        archive: zipfile.ZipFile,
        header: dict[str, Any],
        names: tuple[str, ...],
    ) -> None:
        self.path = path
        self._file = file
        self.header = header
        self.names = names
        self._archive = archive

    def array(self, name: str) -> np.ndarray:
        """Read and verify an array.

        Raises:
          StoreError: if there is no such array, or the array was altered.
        """
        if name not in self.names:
            raise StoreError(
                self.path,
                f"no array {name!r}, only {', '.join(self.names) or 'none'}",
                "make it again with this version of swerve",
            )
        data = io.BytesIO(_read_member(self.path, self._archive, f"{name}.npy"))
        try:
            _check_size(data)
            return np.lib.format.read_array(data, allow_pickle=False)
        except Exception as error:  # a header that nobody wrote raises any of a dozen types
            raise _altered(self.path, f"array {name!r} cannot be read ({error})") from error

    def close(self) -> None:
        """Close the file; no array can be read afterwards."""
        self._archive.close()
        self._file.close()

    def __del__(self) -> None:
        self.close()

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
    """Write a file at once; its folder is created if need be.

    Args:
      path: path of the file; an existing file is replaced.
      kind: kind of file, such as "evidence".
      version: version of this kind of file; increase the version when the contents change.
      header: JSON data, with none of the keys in RESERVED.
      arrays: numbers, booleans or text of any shape, by name; a name may have parts, as in "a/b".

    Raises:
      ValueError: if a name or a dtype cannot be stored, or the header has NaN or infinite numbers,
        or is larger, of more items or more deeply nested than what is read.
      TypeError: if the header holds data that JSON cannot hold.
      OSError: if the folder cannot be written; a file that existed there is still there.
    """
    import zipfile  # the import takes 10 ms

    arrays = {name: _storable(name, array) for name, array in arrays.items()}
    clash = [key for key in RESERVED if key in header]
    if clash:
        raise ValueError(f"header: the keys {', '.join(RESERVED)} are taken, got {clash}; rename")
    fields = {"format": kind, "version": version, "arrays": list(arrays), **header}
    text = json.dumps(fields, allow_nan=False)
    json_text.check(text.encode())

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

    replace(Path(path), write_to)


def open_file(path: AnyPath, kind: str, version: int) -> StoredFile:
    """Open a file and verify its header.

    Args:
      path: the file.
      kind: kind that the file must have.
      version: version that can be read.

    Raises:
      StoreError: if the file is cut short, altered, not a Swerve file, or of another kind or
        version.
      OSError: if the file does not exist or cannot be opened.
    """
    path = Path(path)
    file = open_regular(path)
    try:
        archive = _open_archive(path, file)
        header = _parse(path, _read_member(path, archive, HEADER))
        if not all(key in header for key in RESERVED):
            raise _foreign(
                path, f"not a Swerve file: its {HEADER} lacks one of {', '.join(RESERVED)}"
            )
        found_kind, found_version, names = (header.pop(key) for key in RESERVED)
        if found_kind != kind:
            raise StoreError(
                path, f"expected a file of kind {kind!r}, got {found_kind!r}", "give the other file"
            )
        _check_version(path, kind, version, found_version)
        _check_arrays(path, archive, names)
    except BaseException:
        file.close()
        raise
    return StoredFile(path, file, archive, header, tuple(names))


def write_json(path: AnyPath, data: Any) -> None:
    """Write a small record of JSON data at once; its folder is created if need be.

    Raises:
      ValueError: if the data have NaN or infinite numbers, or are larger, of more items or more
        deeply nested than what is read.
      TypeError: if the data are of types that JSON cannot hold.
      OSError: if the folder cannot be written; a file that existed there is still there.
    """
    record = {"crc32": _checksum(data), "data": data}
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    json_text.check(text.encode())
    write_text(path, text)


def read_json(path: AnyPath) -> Any:
    """Read a record that `write_json` wrote.

    Raises:
      StoreError: if the file is cut short, altered, or not such a record.
      OSError: if the file does not exist or cannot be opened.
    """
    path = Path(path)
    with open_regular(path) as file:
        record = _parse(path, file.read(json_text.MAX_BYTES + 1) or b"")
    if record.keys() != {"crc32", "data"}:
        raise _foreign(path, "not a Swerve record, or altered: expected the keys crc32 and data")
    if record["crc32"] != _checksum(record["data"]):
        raise _altered(path, "altered: its checksum does not match its data")
    return record["data"]


def _open_archive(path: Path, file: BinaryIO) -> zipfile.ZipFile:
    """Return the archive in a file, which begins like a ZIP file and has a header.

    Nothing in the archive is compressed, so that what is read from it is no larger than the file.
    """
    import zipfile

    if not b"PK\x03\x04".startswith(file.read(4)):
        raise _foreign(path, "not a Swerve file, or altered where it begins")
    try:
        archive = zipfile.ZipFile(file)
    except Exception as error:  # a damaged file raises any of a dozen types
        raise _altered(path, f"cut short or altered ({error})") from error
    members = archive.infolist()
    if HEADER not in archive.namelist():
        raise _foreign(path, f"not a Swerve file, or altered: it has no {HEADER}")
    for member in members:
        if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
            raise _altered(path, f"altered: {member.filename!r} is compressed")
    if sum(member.file_size for member in members) > os.fstat(file.fileno()).st_size:
        raise _altered(path, "altered: its parts have more bytes than the file")
    return archive


def _check_arrays(path: Path, archive: zipfile.ZipFile, names: Any) -> None:
    """Raise StoreError unless an archive has the arrays that its header names, each once."""
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise _altered(path, f"altered: expected the names of arrays, got {names!r:.100}")
    if sorted(archive.namelist()) != sorted([HEADER, *(f"{name}.npy" for name in names)]):
        raise _altered(path, f"altered: expected the arrays {', '.join(names)} and no others")


def _check_size(data: io.BytesIO) -> None:
    """Raise ValueError unless an array fills its member; else much more memory might be taken."""
    version = np.lib.format.read_magic(data)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the array format")
    reads = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
    shape, _, dtype = reads[version[0]](data)
    size = data.getbuffer().nbytes - data.tell()
    if not dtype.hasobject and math.prod(shape) * dtype.itemsize != size:
        raise ValueError(f"shape {shape} and type {dtype} are not those of {size} bytes")
    data.seek(0)


def _check_version(path: Path, kind: str, version: int, found: Any) -> None:
    """Raise StoreError where the version found in a file is not the version that can be read."""
    if type(found) is not int:
        raise _altered(path, f"altered: its version is {found!r:.100}")
    if found > version:
        raise StoreError(
            path,
            f"written in version {found} of kind {kind!r}, this swerve reads {version}",
            "upgrade swerve: pip install --upgrade swerve",
        )
    if found < version:
        raise StoreError(
            path,
            f"written in version {found} of kind {kind!r}, this swerve reads {version} "
            f"and no longer version {found}",
            "make it again, or read it with the swerve that wrote it",
        )


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
        return archive.read(name)  # zipfile compares the CRC-32
    except MemoryError:
        raise
    except Exception as error:  # a damaged file raises any of a dozen types
        raise _altered(path, f"altered ({error})") from error


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    try:
        data = json_text.parse(text)
    except ValueError as error:
        raise _altered(path, f"cut short or altered, not JSON ({error})") from error
    if not isinstance(data, dict):
        raise _foreign(path, "not a Swerve file: expected a JSON object")
    return data


def _checksum(data: Any) -> str:
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return f"{zlib.crc32(canonical.encode()):08x}"


def _altered(path: Path, problem: str) -> StoreError:
    return StoreError(path, problem, "copy it again from its source, or make it again")


def _foreign(path: Path, problem: str) -> StoreError:
    return StoreError(path, problem, "give a file that swerve wrote")
