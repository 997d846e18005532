"""The parts of the compiled renderer on their own: lanes, depth order, lists. Whole pictures are in test_render.py."""

from __future__ import annotations

import numba as nb
import numpy as np
import pytest

from rtgs.renderer.cpu import channels, layout, simd, tiles
from rtgs.renderer.cpu.simd import LANES, load, store, take_next


@nb.njit
def _apply(which, x, out):
    for at in range(0, len(x), LANES):
        v = load(x, at)
        if which == 0:
            store(out, at, simd.exp2_below_one(v))
        elif which == 1:
            store(out, at, simd.exponential(v))
        elif which == 2:
            store(out, at, simd.log2(v))
        elif which == 3:
            store(out, at, simd.negative_magnitude(v))
        elif which == 4:
            store(out, at, simd.where(v > 0.0, simd.square_root(v), -v))
        elif which == 5:
            store(out, at, simd.minimum(simd.maximum(v, -1.0), 2.0))
        else:
            store(out, at, simd.floor(v) + simd.ceil(v) * 2.0 + simd.magnitude(v) / 4.0)


def _lanes(which: int, x: np.ndarray) -> np.ndarray:
    x = x.astype(np.float32)
    out = np.empty_like(x)
    _apply(which, x, out)
    return out


def test_exponentials_and_logarithm_are_good_to_float32() -> None:
    # Where the argument itself is not exact in float32, x·log₂e is rounded to 6e-8 of up to 126.
    t = np.linspace(-125.9, 0.0, 64_000)
    np.testing.assert_allclose(_lanes(0, t), np.exp2(t.astype(np.float32).astype(np.float64)), rtol=2.5e-7)
    x = np.linspace(-87.0, 87.0, 64_000)
    np.testing.assert_allclose(_lanes(1, x), np.exp(x.astype(np.float32).astype(np.float64)), rtol=1e-5)
    near = np.linspace(-8.0, 8.0, 64_000)
    np.testing.assert_allclose(_lanes(1, near), np.exp(near.astype(np.float32).astype(np.float64)), rtol=1e-6)
    a = np.exp(np.linspace(-20.0, 20.0, 64_000))
    np.testing.assert_allclose(_lanes(2, a), np.log2(a.astype(np.float32).astype(np.float64)), rtol=2e-7, atol=2e-7)
    exact = 2.0 ** np.arange(-16, 16)
    np.testing.assert_array_equal(_lanes(2, exact), np.arange(-16, 16))
    assert np.isfinite(_lanes(1, np.full(16, 1e4))).all() and (_lanes(1, np.full(16, -1e4)) < 1e-37).all()


def test_lane_functions_are_numpys() -> None:
    x = np.random.default_rng(0).normal(size=160).astype(np.float32) * 3
    np.testing.assert_array_equal(_lanes(3, x), -np.abs(x))
    np.testing.assert_array_equal(_lanes(4, x), np.where(x > 0, np.sqrt(np.abs(x)), -x))
    np.testing.assert_array_equal(_lanes(5, x), np.clip(x, -1, 2))
    np.testing.assert_allclose(_lanes(6, x), np.floor(x) + 2 * np.ceil(x) + np.abs(x) / 4, rtol=1e-6)


@nb.njit
def _reduce(x, wide):
    v = load(x, 0)
    bits = simd.mask_bits(v > 0.0)
    lowest = simd.lowest_bit(bits) if bits != 0 else -1
    a_sum, b_sum = simd.total(v), simd.total(load(wide, 0))
    return a_sum, b_sum, bits, lowest, simd.any_lane(v > 2.0), simd.total(simd.widen(v)), simd.total(simd.lane_numbers())


@pytest.mark.parametrize("seed", range(4))
def test_sums_and_masks(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=16).astype(np.float32)
    wide = np.random.default_rng(seed + 9).normal(size=16)
    a_sum, b_sum, bits, lowest, any_above, widened, numbers = _reduce(x, wide)
    assert a_sum == pytest.approx(x.sum(), abs=1e-6) and b_sum == pytest.approx(wide.sum(), abs=1e-13)
    assert bits == sum(1 << k for k in range(16) if x[k] > 0) and lowest == np.flatnonzero(x > 0)[0]
    assert any_above == (x > 2).any() and widened == pytest.approx(x.astype(np.float64).sum(), abs=1e-13) and numbers == 120


@nb.njit
def _weighted_blocks(registers, values, short, colors, image, sums):
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


@nb.njit
def _copy_half(to, start, array, index):
    simd.copy_half(to, start, array, index)


@pytest.mark.parametrize("kind", [np.float32, np.uint16])
def test_half_a_register_is_copied(kind: type) -> None:
    array, to = np.arange(40).astype(kind), np.zeros(40, kind)
    _copy_half(to, 3, array, 21)
    np.testing.assert_array_equal(to[3:11], array[21:29])
    assert not to[:3].any() and not to[11:].any()


@pytest.mark.parametrize("spread", [0.0, 1e-6, 1.0, 1e6])
@pytest.mark.parametrize("n", [0, 1, 17, 5000])
def test_depth_order_is_a_stable_sort(n: int, spread: float) -> None:
    rng = np.random.default_rng(n)
    depths = (2.0 + spread * rng.uniform(size=n)).astype(np.float32)
    depths[rng.uniform(size=n) < 0.3] = 2.0  # equals keep the model's order
    visible = (rng.uniform(size=n) < 0.7).astype(np.int32)
    kept = np.flatnonzero(visible)
    expected = kept[np.argsort(depths[kept], kind="stable")]
    order, starts = tiles.depth_order(depths.view(np.uint32), visible)
    np.testing.assert_array_equal(order, expected)
    np.testing.assert_array_equal(starts, np.concatenate([[0], np.cumsum(visible)]))


def test_lists_hold_each_splat_once_in_each_tile_of_its_box_front_to_back() -> None:
    rng = np.random.default_rng(1)
    n, columns, rows = 500, 7, 5
    first = np.stack([rng.integers(0, columns, n), rng.integers(0, rows, n)], 1)
    extent = np.minimum(rng.integers(1, 4, (n, 2)), np.array([columns, rows]) - first)
    boxes = np.concatenate([first, extent], 1).astype(np.int16)
    counts = (extent.prod(1) * (rng.uniform(size=n) < 0.8)).astype(np.int32)
    order = rng.permutation(np.flatnonzero(counts)).astype(np.int32)
    pair_starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    tile_starts, entries, places = tiles.bin_splats(order, boxes, pair_starts, columns, rows)
    assert tile_starts[-1] == counts.sum() == len(places)
    rank = np.full(n, -1)
    rank[order] = np.arange(len(order))
    for tile in range(columns * rows):
        listed = entries[tile_starts[tile] : tile_starts[tile + 1]]
        x, y = tile % columns, tile // columns
        inside = (first[:, 0] <= x) & (x < first[:, 0] + extent[:, 0]) & (first[:, 1] <= y) & (y < first[:, 1] + extent[:, 1])
        assert set(listed) == set(np.flatnonzero(inside & (counts > 0)))
        assert (np.diff(rank[listed]) > 0).all()
    for i in order:
        spots = [
            (r, c) for r in range(boxes[i, 1], boxes[i, 1] + boxes[i, 3]) for c in range(boxes[i, 0], boxes[i, 0] + boxes[i, 2])
        ]
        for j, (r, c) in enumerate(spots):
            assert entries[tile_starts[r * columns + c] + places[pair_starts[i] + j]] == i


def test_long_lists_are_taken_first() -> None:
    lengths = np.random.default_rng(2).integers(0, 50, 37)
    order = tiles.longest_first(np.concatenate([[0], np.cumsum(lengths)]))
    assert sorted(order) == list(range(37)) and (np.diff(lengths[order]) <= 0).all()


@nb.njit(parallel=True)
def _drawn(threads, numbers):  # type: ignore[no-untyped-def]
    taken, found = np.zeros(1, np.int64), np.zeros((threads, numbers), np.int64)
    for thread in nb.prange(threads):
        for _ in range(numbers):
            number = take_next(taken)
            if number >= numbers:
                break
            found[thread, number] += 1
    return found


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_draw_every_number_once(threads: int) -> None:
    assert (_drawn(threads, 20_000).sum(axis=0) == 1).all()


def test_small_pictures_have_enough_tiles_to_share() -> None:
    assert [layout.tile_side(*size) for size in ((1920, 1080), (400, 400), (320, 256), (160, 120), (1, 1))] == [
        64,
        64,
        32,
        16,
        16,
    ]
