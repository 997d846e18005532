"""Which splats touch which tile (`layout.tile_side`), in depth order.

One radix sort of the depths and one counting sort into tiles in that order; no sort per tile. A splat enters the lists of all tiles
of its bounding box: whether its ellipse reaches a tile's pixels is cheaper to ask when the tile comes to it, since most never do.
The counting sort runs over fixed blocks, so the lists come out the same for any number of threads.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import kernel

_BLOCKS = 16
_PADDING = 16  # entries that `blend` may look ahead
_DIGIT_BITS = 12


@kernel()
def depth_order(depths, tiles):
    """Visible Gaussians (`tiles` > 0) by rising depth, equals in model order, `[V]` int32; and the running sum of `tiles`, `[N + 1]`.

    One thread: two or three passes over memory gain nothing from a second one, and each would have to wake it.

    Args:
        depths: `[N]`, the bits of positive float32 as uint32, which rise as the numbers do.
    """
    n, visible, low, high = len(depths), 0, np.uint32(0xFFFFFFFF), np.uint32(0)
    starts = np.empty(n + 1, np.int64)
    starts[0] = 0
    for i in range(n):
        starts[i + 1] = starts[i] + tiles[i]
        if tiles[i] > 0:
            visible += 1
            low, high = min(low, depths[i]), max(high, depths[i])
    # Depth above, index below: one number to move.
    keys, other = np.empty(visible, np.uint64), np.empty(visible, np.uint64)
    at = 0
    for i in range(n):
        if tiles[i] > 0:
            keys[at] = (np.uint64(depths[i] - low) << np.uint64(32)) | np.uint64(i)
            at += 1
    span, bits = np.int64(high) - np.int64(low), 1
    while span >> bits > 0:
        bits += 1
    passes = (bits + _DIGIT_BITS - 1) // _DIGIT_BITS
    digit = (bits + passes - 1) // passes
    mask = np.uint64((1 << digit) - 1)
    for p in range(passes):
        shift = np.uint64(32 + p * digit)
        places = np.zeros((1 << digit) + 1, np.int64)
        for k in range(visible):
            places[((keys[k] >> shift) & mask) + np.uint64(1)] += 1
        for value in range(1 << digit):
            places[value + 1] += places[value]
        for k in range(visible):
            value = (keys[k] >> shift) & mask
            to = places[value]
            places[value] = to + 1
            other[to] = keys[k]
        keys, other = other, keys
    order = np.empty(visible, np.int32)
    for k in range(visible):
        order[k] = keys[k] & np.uint64(0xFFFFFFFF)
    return order, starts


@kernel(parallel=True)
def _bin(order, boxes, pair_starts, tiles_x, tile_count, total):
    counts = np.zeros((_BLOCKS, tile_count), np.int32)
    for block in nb.prange(_BLOCKS):
        for rank in range(block * len(order) // _BLOCKS, (block + 1) * len(order) // _BLOCKS):
            i = order[rank]
            tile, column, columns = boxes[i, 1] * tiles_x + boxes[i, 0], 0, boxes[i, 2]
            for _ in range(pair_starts[i], pair_starts[i + 1]):
                counts[block, tile] += 1
                column += 1
                tile += tiles_x - columns + 1 if column == columns else 1
                column = 0 if column == columns else column
    tile_starts = np.empty(tile_count + 1, np.int64)
    start = 0
    for tile in range(tile_count):
        tile_starts[tile] = start
        place = 0
        for block in range(_BLOCKS):
            count = counts[block, tile]
            counts[block, tile] = place
            place += count
        start += place
    tile_starts[tile_count] = start
    entries, places = np.empty(total + _PADDING, np.int32), np.empty(total, np.int32)
    entries[total:] = 0
    for block in nb.prange(_BLOCKS):
        for rank in range(block * len(order) // _BLOCKS, (block + 1) * len(order) // _BLOCKS):
            i = order[rank]
            tile, column, columns = boxes[i, 1] * tiles_x + boxes[i, 0], 0, boxes[i, 2]
            for at in range(pair_starts[i], pair_starts[i + 1]):
                place = counts[block, tile]
                counts[block, tile] = place + 1
                entries[tile_starts[tile] + place] = i
                places[at] = place
                column += 1
                tile += tiles_x - columns + 1 if column == columns else 1
                column = 0 if column == columns else column
    return tile_starts, entries, places


def bin_splats(
    order: NDArray[np.int32], boxes: NDArray[np.int16], pair_starts: NDArray[np.int64], tiles_x: int, tiles_y: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Lists of splats per tile.

    Args:
        order: `[V]`, front to back.
        boxes: `[N, 4]`, first tile column and row, columns, rows.
        pair_starts: `[N + 1]`, running sum of the tiles in each box (none where not visible).

    Returns:
        tile_starts `[T + 1]` into entries; entries `[S + padding]`, Gaussians front to back; places `[S]`, where in each of its
        tiles' lists a Gaussian stands, tile by tile of its box from `pair_starts[i]` on.
    """
    lists: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]] = _bin(
        order, boxes, pair_starts, tiles_x, tiles_x * tiles_y, int(pair_starts[-1])
    )
    return lists


def longest_first(tile_starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The tiles `[T]` by falling length of their lists: threads take one after the other, and end with the small ones."""
    return np.argsort(-np.diff(tile_starts), kind="stable")
