"""Steps that are written out for the number of channels."""

from __future__ import annotations

import numba as nb
import numpy as np
import pytest

from rtgs.renderer.cpu import channels, simd
from rtgs.renderer.cpu.simd import LANES, load


@nb.njit
def _weighted_blocks(registers, values, short, colors, image, sums):  # type: ignore[no-untyped-def]  # as in test_simd.py
    for at in range(0, len(values), LANES):
        simd.store_uint16(short, at, load(values, at))
    channels.store_all(image, channels.add_weighted(channels.no_lanes(registers), short, 0, colors, 1))
    channels.add_products(sums, channels.SUMMED, channels.load_all(registers, image), short, 0)


@pytest.mark.parametrize("count", [1, 3, 7])
def test_blocks_of_sixteen_bit_weights(count: int) -> None:
    """A block's picture by one splat, and what the splat gets of that picture."""
    rng, size = np.random.default_rng(count), channels.REGISTERS * LANES
    values = np.concatenate([[0.0, 0.99, 1.0, 32767.5, 32768.0, 65535.0, 65535.9, 255.5], np.linspace(0, 65535, size - 8)])
    short, colors = np.empty(size, np.uint16), rng.normal(size=count + 1).astype(np.float32)
    image, sums = np.empty(count * size, np.float32), np.ones((count + 2) * channels.SUMMED, np.float32)
    _weighted_blocks((0,) * (count * channels.REGISTERS), values.astype(np.float32), short, colors, image, sums)
    weights = np.floor(values).astype(np.float32)
    np.testing.assert_array_equal(short, weights)
    np.testing.assert_allclose(image.reshape(count, size), colors[1:, None] * weights, rtol=1e-6)
    totals = sums.reshape(-1, channels.SUMMED).sum(1) - channels.SUMMED
    np.testing.assert_allclose(totals[1:-1], image.reshape(count, size) @ weights, rtol=1e-5)
    assert totals[0] == totals[-1] == 0
