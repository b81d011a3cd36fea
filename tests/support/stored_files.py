"""A small stored file, and what must happen when it is altered."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from swerve.base import store

KIND, VERSION = "evidence", 3
HEADER = {"swerve": "0.1.0", "beta": 0.67, "names": ["theta", "omega"], "none": None}
ARRAYS = {
    "summary/log_ratio": np.array([[0.5, -1.25]]),
    "bits": np.arange(5, dtype=np.uint8),
    "empty": np.zeros((0, 3), np.float32),
}


def read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    with store.open_file(path, KIND, VERSION) as stored:
        return stored.header, {name: stored.array(name) for name in stored.names}


def assert_same(content: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    header, arrays = content
    assert header == HEADER
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array, strict=True)


def child_environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def refuses(read: Callable[[Path], Any], path: Path) -> bool:
    """Return whether reading is refused; then the message has to say what is needed."""
    content = path.read_bytes()
    message = None
    try:
        read(path)
    except store.StoreError as error:
        message = str(error)
    assert path.read_bytes() == content
    assert message is None or (message.startswith(f"{path}: ") and "left as it was; " in message)
    return message is not None


def flips(content: bytes) -> Iterator[bytes]:
    for position in range(len(content)):
        for flip in (0x01, 0xFF):
            altered = bytearray(content)
            altered[position] ^= flip
            yield bytes(altered)
