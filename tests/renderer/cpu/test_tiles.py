"""Depth order and the tiles' lists of splats."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.renderer.cpu import tiles


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
