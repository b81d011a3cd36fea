"""Pack bits: for each row, such as a trajectory, one bit per hypothesis, set if it is entered.

    bit of hypothesis h = bit h & 7 of byte h >> 3      (NumPy's bitorder="little")

Only this module knows this layout. Bits beyond H - 1 in the last byte are 0.

Shapes: N rows, H hypotheses, B = ceil(H / 8) bytes, M selected hypotheses, R selected rows, C bytes
that hold selected hypotheses, S sets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from swerve.base.arguments import whole_number


def num_bytes(num_hypotheses: int) -> int:
    """Return B, the number of bytes that hold one bit per hypothesis."""
    return (num_hypotheses + 7) // 8


def num_bits(bits: np.ndarray) -> int:
    """Return 8 B, the number of bits in a row of packed bits [..., B]: H rounded up."""
    return 8 * bits.shape[-1]


def no_bits(num_rows: int, num_hypotheses: int) -> np.ndarray:
    """Return packed bits [N, B] of rows that enter no hypothesis."""
    return np.zeros((num_rows, num_bytes(num_hypotheses)), np.uint8)


def pack(entered: np.ndarray) -> np.ndarray:
    """Return booleans [..., H] as packed bits [..., B]."""
    return np.packbits(entered, axis=-1, bitorder="little")


def unpack(bits: np.ndarray, num_hypotheses: int) -> np.ndarray:
    """Return booleans [..., H] from packed bits [..., B]."""
    unpacked = np.unpackbits(bits, axis=-1, count=num_hypotheses, bitorder="little")
    return unpacked.astype(bool)


def unpack_range(bits: np.ndarray, first: int, stop: int) -> np.ndarray:
    """Return booleans [..., stop - first] of hypotheses first (a multiple of 8) to stop - 1."""
    return unpack(bits[..., first // 8 : num_bytes(stop)], stop - first)


def select(bits: Any, hypotheses: Any) -> Any:
    """Return bits [N, M], 0 or 1, of hypotheses [M] in packed bits [N, B]; uint8, NumPy or JAX."""
    return bits[:, hypotheses >> 3] >> (hypotheses & 7).astype(np.uint8) & 1


def select_one(bits: np.ndarray, rows: np.ndarray | slice, hypothesis: int) -> np.ndarray:
    """Return [R] True where rows [R] of packed bits [N, B] enter one hypothesis."""
    return (bits[rows, hypothesis >> 3] >> (hypothesis & 7) & 1).astype(bool)


def set_one(bits: np.ndarray, hypothesis: int, entered: np.ndarray) -> None:
    """Set the bit of a hypothesis in the rows of packed bits [N, B] where `entered` [N] is True."""
    bits[:, hypothesis >> 3] |= np.left_shift(entered, hypothesis & 7, dtype=np.uint8)


def set_pairs(bits: np.ndarray, rows: np.ndarray, hypotheses: np.ndarray) -> None:
    """Set the bit of hypotheses[k] in row rows[k] of packed bits [N, B], a contiguous array."""
    flat = rows * bits.shape[1] + (hypotheses >> 3)
    np.bitwise_or.at(bits.reshape(-1), flat, np.left_shift(1, hypotheses & 7).astype(np.uint8))


def bytes_of(hypotheses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bytes [C] that hold hypotheses [M], and the places of these among the 8 C bits."""
    columns, place = np.unique(hypotheses >> 3, return_inverse=True)
    return columns, 8 * place + (hypotheses & 7)


def blocks(bits: np.ndarray, size: int) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield slices of hypotheses and their bits [N, M], 0 or 1, for `size` bytes at a time."""
    for first in range(0, bits.shape[1], size):
        unpacked = np.unpackbits(bits[:, first : first + size], axis=1, bitorder="little")
        yield slice(8 * first, 8 * first + unpacked.shape[1]), unpacked


def entered_blocks(bits: np.ndarray, size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield hypotheses [M] and their bits [N, M], 0 or 1, for `size` bytes at a time.

    Hypotheses of bytes in which no row has a bit set are left out.
    """
    entered = np.flatnonzero(np.bitwise_or.reduce(bits, axis=0, initial=0))
    for first in range(0, len(entered), size):
        columns = entered[first : first + size]
        unpacked = np.unpackbits(bits[:, columns], axis=1, bitorder="little")
        yield (8 * columns[:, None] + np.arange(8)).reshape(-1), unpacked


def pack_sets(sets: Sequence[Sequence[int]], num_hypotheses: int) -> np.ndarray:
    """Return sets of hypotheses as packed bits [S, B].

    Raises:
      ValueError: if a set is not a list of indices, or an index is not from 0 to H - 1.
    """
    members = np.zeros((len(sets), num_hypotheses), bool)
    for k, indices in enumerate(sets):
        if np.ndim(indices) != 1:
            raise ValueError(
                f"avoiding[{k}]: expected a list of hypotheses, as in [[], [3], [3, 7]], got "
                f"{indices!r}"
            )
        for index in indices:
            if whole_number(index, f"avoiding[{k}]", 0) >= num_hypotheses:
                last = num_hypotheses - 1
                raise ValueError(f"avoiding[{k}]: expected indices from 0 to {last}, got {index}")
            members[k, index] = True
    return pack(members)


def enters_set(bits: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Return [N] True where a row of packed bits [N, B] enters a member of a packed set [B]."""
    columns = np.flatnonzero(members)
    return np.asarray((bits[:, columns] & members[columns]).any(axis=1))
