"""Change documents at random, as damage, other programs and strangers do.

Input number k of a target is made by a generator of random numbers with the seed k, so that a
failure is repeated by its number alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

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
