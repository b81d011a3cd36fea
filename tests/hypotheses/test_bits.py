"""One bit per trajectory and hypothesis."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cells import PLANE, as_list, fewer

from swerve.hypotheses.bits import (
    blocks,
    bytes_of,
    entered_blocks,
    no_bits,
    num_bits,
    num_bytes,
    pack,
    select,
    select_one,
    set_one,
    set_pairs,
    unpack,
    unpack_range,
)
from swerve.hypotheses.grid import grid

seeds = st.integers(0, 2**32 - 1)


class TestPacking:
    @fewer
    @given(seed=seeds, num=st.integers(1, 40), shape=st.sampled_from([(), (3,), (2, 0), (2, 3)]))
    def test_round_trip(self, seed, num, shape) -> None:
        booleans = np.random.default_rng(seed).random((*shape, num)) < 0.5
        bits = np.packbits(booleans, axis=-1, bitorder="little")
        assert bits.shape[-1] == -(-num // 8)
        np.testing.assert_array_equal(unpack(bits, num), booleans, strict=True)

    @pytest.mark.parametrize("num", [1, 7, 8, 9, 20])
    @pytest.mark.parametrize("as_boxes", [True, False])
    def test_bit_h_and_7_of_byte_h_over_8(self, num: int, as_boxes: bool) -> None:
        cells = grid(x=(0.0, float(num), num))
        hypotheses = as_list(cells) if as_boxes else cells
        for h in range(num):
            states = np.array([[[h + 0.5, 0.0]] * 2])
            bits = hypotheses.violations(states, PLANE, True)
            expected = np.zeros((1, -(-num // 8)), np.uint8)
            expected[0, h >> 3] = 1 << (h & 7)
            np.testing.assert_array_equal(bits, expected, strict=True)


class TestParts:
    """Every function that reads or writes a part of the bits agrees with all of them unpacked."""

    NUM = 83
    ENTERED = np.random.default_rng(0).random((40, NUM)) < 0.1
    BITS = pack(ENTERED)

    def test_sizes(self) -> None:
        assert [num_bytes(num) for num in (1, 8, 9, self.NUM)] == [1, 1, 2, 11]
        assert num_bits(self.BITS) == 88
        np.testing.assert_array_equal(no_bits(3, self.NUM), np.zeros((3, 11), np.uint8))

    def test_some_hypotheses(self) -> None:
        chosen = np.array([82, 0, 7, 8, 8, 41])
        expected = self.ENTERED[:, chosen].astype(np.uint8)
        np.testing.assert_array_equal(select(self.BITS, chosen), expected, strict=True)
        in_jax = select(jnp.asarray(self.BITS), jnp.asarray(chosen))
        np.testing.assert_array_equal(np.asarray(in_jax), expected, strict=True)

    def test_one_hypothesis_of_some_rows(self) -> None:
        rows = np.array([3, 3, 39, 0])
        for h in range(self.NUM):
            found = select_one(self.BITS, rows, h)
            np.testing.assert_array_equal(found, self.ENTERED[rows, h], strict=True)
            every = select_one(self.BITS, slice(None), h)
            np.testing.assert_array_equal(every, self.ENTERED[:, h], strict=True)

    @pytest.mark.parametrize(("first", "stop"), [(0, 83), (8, 9), (16, 64), (80, 83)])
    def test_a_range_of_hypotheses(self, first: int, stop: int) -> None:
        found = unpack_range(self.BITS, first, stop)
        np.testing.assert_array_equal(found, self.ENTERED[:, first:stop], strict=True)

    @pytest.mark.parametrize("size", [1, 3, 11, 20])
    def test_blocks_of_bytes(self, size: int) -> None:
        found = np.zeros((40, 88), np.uint8)
        for hypotheses, bits in blocks(self.BITS, size):
            assert bits.shape[1] <= 8 * size
            found[:, hypotheses] += bits
        np.testing.assert_array_equal(found[:, : self.NUM], self.ENTERED)

    @pytest.mark.parametrize("size", [1, 3, 20])
    def test_blocks_of_bytes_that_are_entered(self, size: int) -> None:
        entered = self.ENTERED & ~np.isin(np.arange(self.NUM) // 8, [0, 4, 5])
        found, seen = np.zeros((40, 88), np.uint8), []
        for hypotheses, bits in entered_blocks(pack(entered), size):
            found[:, hypotheses] += bits
            seen += np.unique(hypotheses // 8).tolist()
        np.testing.assert_array_equal(found[:, : self.NUM], entered)
        assert seen == [1, 2, 3, 6, 7, 8, 9, 10]

    def test_bytes_that_hold_some_hypotheses(self) -> None:
        chosen = np.array([82, 0, 7, 8, 41])
        columns, place = bytes_of(chosen)
        assert columns.tolist() == [0, 1, 5, 10]
        unpacked = unpack(self.BITS[:, columns], 8 * len(columns))
        np.testing.assert_array_equal(unpacked[:, place], self.ENTERED[:, chosen])

    def test_bits_are_set_one_by_one_and_by_pairs(self) -> None:
        by_column, by_pair = no_bits(40, self.NUM), no_bits(40, self.NUM)
        for h in range(self.NUM):
            set_one(by_column, h, self.ENTERED[:, h])
        set_pairs(by_pair, *np.nonzero(self.ENTERED))
        np.testing.assert_array_equal(by_column, self.BITS, strict=True)
        np.testing.assert_array_equal(by_pair, self.BITS, strict=True)
