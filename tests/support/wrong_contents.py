"""Wrong contents in well-formed files: each field of a file dropped, retyped, resized and so on."""

from __future__ import annotations

import copy
import io
import json
import math
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from swerve.base import store

Case = tuple[str, Any]
JSON_VALUES = (
    None,
    True,
    "text",
    "",
    -1,
    0,
    1.5,
    10**400,
    1e308,
    math.nan,
    -math.inf,
    [],
    {},
    [[]],
)


def read_zip(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header and the arrays of a stored file, unchecked."""
    with zipfile.ZipFile(path) as archive:
        header = json.loads(archive.read("header.json"))
        names = [name for name in archive.namelist() if name.endswith(".npy")]
        arrays = {x.removesuffix(".npy"): np.load(io.BytesIO(archive.read(x))) for x in names}
    return header, arrays


def write_zip(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write a header, with whatever JSON of Python may hold, and arrays that match their names."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.json", json.dumps(header | {"arrays": list(arrays)}))
        for name, array in arrays.items():
            stream = io.BytesIO()
            np.lib.format.write_array(stream, array, allow_pickle=False)
            archive.writestr(f"{name}.npy", stream.getvalue())


def write_record(path: Path, data: Any) -> None:
    """Write a record with its right checksum, with whatever JSON of Python may hold."""
    path.write_text(json.dumps({"crc32": store._checksum(data), "data": data}))


def wrong_json(data: Any, at: str = "$") -> Iterator[Case]:
    """Yield a description and a changed copy of JSON data, for each change of each field."""
    for value in JSON_VALUES:
        if type(value) is not type(data) or value != data:
            yield f"{at} = {value!r:.20}", value
    if isinstance(data, dict):
        yield f"{at}: one more", data | {"one more": 1}
        for key, value in data.items():
            yield f"{at}.{key} dropped", {k: v for k, v in data.items() if k != key}
            for what, changed in wrong_json(value, f"{at}.{key}"):
                yield what, data | {key: changed}
    elif isinstance(data, list) and data:
        yield f"{at}: one less", data[:-1]
        yield f"{at}: twice", data + data
        yield f"{at}: reversed", data[::-1]
        for k in {0, len(data) - 1}:
            for what, changed in wrong_json(data[k], f"{at}[{k}]"):
                yield what, [*data[:k], changed, *data[k + 1 :]]
    elif isinstance(data, int | float) and not isinstance(data, bool):
        for value in (-data, 1000 * data, data / 1000, data + 1):
            yield f"{at} = {value!r}", value


def wrong_array(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield a description and a changed copy of an array: type, shape and numbers."""
    for kind in ("?", "i8", "u1", "f2", "c16", "U3"):
        if np.dtype(kind).kind != array.dtype.kind:
            with np.errstate(all="ignore"):
                yield f"as {kind}", np.nan_to_num(array).astype(kind)
    yield "one axis more", array[None]
    yield "one number", array.reshape(-1)[0]
    yield "one less", array[:-1]
    yield "twice", np.concatenate([array, array])
    yield "without rows", array[:0]
    yield "without columns", array[..., :0]
    yield "transposed", array.T.copy()
    for value in (-1, 1, 100, -1e30, 1e30, math.nan, math.inf, -math.inf):
        if array.dtype.kind == "f" or (math.isfinite(value) and abs(value) < 1e30 and value >= 0):
            changed = array.copy()
            changed.reshape(-1)[:1] = value
            yield f"one is {value}", changed
            yield f"all are {value}", np.full_like(array, value)
    if array.dtype.kind != "U":
        yield "negated", -array
        yield "large", (array + np.array(120).astype(array.dtype)) * np.array(2).astype(array.dtype)


def wrong_files(path: Path) -> Iterator[tuple[str, dict[str, Any], dict[str, np.ndarray]]]:
    """Yield a description, the header and the arrays of each wrong version of a stored file."""
    header, arrays = read_zip(path)
    fields = {key: value for key, value in header.items() if key not in store.RESERVED}
    reserved = {key: header[key] for key in store.RESERVED}
    for what, changed in wrong_json(fields):
        if isinstance(changed, dict):
            yield what, reserved | copy.deepcopy(changed), arrays
    for name, array in arrays.items():
        yield f"{name} dropped", header, {k: x for k, x in arrays.items() if k != name}
        for what, changed in wrong_array(array):
            yield f"{name} {what}", header, arrays | {name: changed}
    yield "one more array", header, arrays | {"one/more": np.zeros(3)}
    yield "no array", header, {}
