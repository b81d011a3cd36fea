"""Change documents at random, as damage, other programs and strangers do.

Input number k of a target is made by a generator of random numbers with the seed k, so that a
failure is repeated by its number alone.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from random import Random
from typing import Any

from support.wrong_contents import JSON_VALUES

TOKENS = [
    b"", b"\x00", b"\n", b"\r", b"\r\n", b",", b",,", b'"', b'""', b"'", b" ", b"\t", b"\xff",
    b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\x1b[31m", b"nan", b"NaN", b"inf", b"-Infinity", b"1e308",
    b"1e400", b"-1e-400", b"0", b"-0", b"00", b"1_0", b"0x10", b"1e", b".", b"-", b"+", b"9" * 30,
    b"9" * 5000, b"1" + b"0" * 400, b"\xd9\xa1", b"true", b"null", b"None", b"{", b"}", b"[", b"]",
    b":", b"[" * 2000, b'{"a":' * 500, b"\\ud800", b"\\u0000", b"#", b";", b"x", b"t", b"id",
    b"end", b"theta", b"demo", b"a" * 300, b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"\xff" * 10,
    b"\x80\x00\x00\x00\x00\x00\x00\x00",
]  # fmt: skip


def mutated(document: bytes, others: Sequence[bytes], random: Random) -> bytes:
    """Return a document after one to four changes.

    Args:
      document: the document.
      others: documents of which parts may be taken.
      random: source of randomness.
    """
    for _ in range(random.choice((1, 1, 1, 2, 3, 4))):
        document = _changed(document, others, random)
    return document


def _changed(document: bytes, others: Sequence[bytes], random: Random) -> bytes:
    start, end = sorted(random.randrange(len(document) + 1) for _ in range(2))
    if random.random() < 0.8:  # most changes are small
        end = min(end, start + random.randrange(9))
    before, part, after = document[:start], document[start:end], document[end:]
    kind = random.randrange(8)
    if kind == 0:
        part = random.choice(TOKENS)
    elif kind == 1:
        part += random.choice(TOKENS)
    elif kind == 2:
        part = b""
    elif kind == 3:
        part *= random.choice((2, 3, 50))
    elif kind == 4:
        part = bytes(random.randrange(256) for _ in part)
    elif kind == 5 and part:
        at = random.randrange(len(part))
        part = part[:at] + bytes([part[at] ^ 1 << random.randrange(8)]) + part[at + 1 :]
    elif kind == 6:
        other = random.choice(others)
        first = random.randrange(len(other) + 1)
        part = other[first : first + random.randrange(40)]
    elif kind == 7 and random.random() < 0.3:
        after = b""
    return before + part + after


def mutated_json(data: Any, random: Random) -> Any:
    """Return JSON data after one to three changes of a member, wherever it is.

    A member becomes another value or the value of another member, or is dropped, doubled, added or
    scaled.

    Args:
      data: the data, an object or an array.
      random: source of randomness.
    """
    data = copy.deepcopy(data)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        members = [(parent, key) for parent in _parents(data) for key in _keys(parent)]
        if not members:
            return random.choice(JSON_VALUES)
        parent, key = random.choice(members)
        value, kind = parent[key], random.randrange(7)
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, list):
            parent.insert(key, copy.deepcopy(value))
        elif kind == 1:
            parent[f"{key}{random.randrange(3)}"] = value
        elif kind == 2:
            other, place = random.choice(members)
            parent[key] = copy.deepcopy(other[place])
        elif kind == 3 and isinstance(value, int | float) and not isinstance(value, bool):
            factor = random.choice((-1, 0.5, 2, 1000, 10**9, 1e300))
            parent[key] = value * (factor if abs(value) < 2**64 else -1)  # no float holds 10^309
        elif kind == 4 and isinstance(value, str):
            text = mutated(value.encode(), [value.encode()], random)
            parent[key] = text.decode("utf-8", "replace")
        else:
            parent[key] = random.choice((*JSON_VALUES, "\x1b[31m", 2**31, 2**63, "a" * 300))
    return data


def _parents(data: Any) -> list[Any]:
    """Return all objects and arrays in JSON data."""
    found = [data] if isinstance(data, dict | list) else []
    return [*found, *(part for one in found for key in _keys(one) for part in _parents(one[key]))]


def _keys(parent: Any) -> list[Any]:
    return list(parent) if isinstance(parent, dict) else list(range(len(parent)))
