"""One bit per trajectory and hypothesis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cells import PLANE, as_list, fewer

from swerve.hypotheses.bits import unpack
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
