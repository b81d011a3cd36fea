"""Read JSON that others may have written, within limits of size, items and depth."""

from __future__ import annotations

import json
import re
from typing import Any, NoReturn

import numpy as np

MAX_BYTES = 2**26  # of JSON in a file: above a map of 2^28 cells at random, or 500,000 boxes
MAX_ITEMS = 2**22  # brackets and commas: each may take a hundred bytes of memory, not of the file
MAX_DEPTH = 100  # brackets within brackets: far above a union of unions of constraints

_STRING = re.compile(rb'"[^"]*+"')
_NO_MARK = bytes(set(range(256)) - set(b'[]{}"'))
_HALF = rb"\\u[dD][%s][0-9a-fA-F]{2}"  # of a character beyond 16 bits, escaped
_PAIR = re.compile(_HALF % b"89abAB" + _HALF % b"c-fC-F")
_LONE = re.compile(_HALF % b"89a-fA-F")
_OPENING = np.frombuffer(b"[{", np.uint8)


def parse(text: bytes) -> Any:
    """Return the data of JSON.

    Raises:
      ValueError: if the text is no JSON in UTF-8, as RFC 8259 has it, or exceeds a limit.
    """
    check(text)
    return json.loads(text.decode(), parse_constant=_refuse)


def check(text: bytes) -> None:
    """Raise ValueError where JSON has more bytes, items or depth than a stored file may have.

    Half a character of a text is refused as well: it has no UTF-8.
    """
    if len(text) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES:,} bytes")
    num = max(sum(map(text.count, (b"[", b"{", b","))), sum(map(text.count, (b"]", b"}"))))
    if num > MAX_ITEMS:
        raise ValueError(f"more than {MAX_ITEMS:,} brackets and commas")
    unescaped = text.replace(b"\\\\", b"").replace(b'\\"', b"")
    brackets = np.frombuffer(_STRING.sub(b"", unescaped.translate(None, _NO_MARK)), np.uint8)
    change = 2 * np.isin(brackets, _OPENING).astype(np.int8) - 1
    if change.cumsum(dtype=np.int32).max(initial=0) > MAX_DEPTH:
        raise ValueError(f"nested more than {MAX_DEPTH} deep")
    if _LONE.search(unescaped) and (half := _LONE.search(_PAIR.sub(b"", unescaped))):
        raise ValueError(f"{half[0].decode()} is half a character")


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")
