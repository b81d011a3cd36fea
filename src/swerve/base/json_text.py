"""Read JSON that others may have written, within limits of size and depth."""

from __future__ import annotations

import json
import re
from typing import Any, NoReturn

import numpy as np

MAX_BYTES = 2**27  # of JSON in a file: far above the transitions of a large table
MAX_DEPTH = 100  # brackets within brackets: far above a union of unions of constraints

_STRING = re.compile(rb'"(?:[^"\\]|\\.)*+"', re.DOTALL)
_NO_BRACKET = bytes(set(range(256)) - set(b"[]{}"))
_OPENING = np.frombuffer(b"[{", np.uint8)


def parse(text: bytes) -> Any:
    """Return the data of JSON.

    Raises:
      ValueError: if the text is no JSON, as RFC 8259 has it, or exceeds a limit.
    """
    check(text)
    return json.loads(text, parse_constant=_refuse)


def check(text: bytes) -> None:
    """Raise ValueError where JSON is larger, or more deeply nested, than a stored file may be."""
    if len(text) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES:,} bytes")
    brackets = np.frombuffer(_STRING.sub(b"", text).translate(None, _NO_BRACKET), np.uint8)
    depth = np.cumsum(np.where(np.isin(brackets, _OPENING), 1, -1))
    if depth.max(initial=0) > MAX_DEPTH:
        raise ValueError(f"nested more than {MAX_DEPTH} deep")


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")
