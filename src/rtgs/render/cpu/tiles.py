"""Which splats touch which 16×16 tile, in depth order.

One depth sort of the splats and one counting sort into tiles in that order; no sort per tile. Both passes of the counting sort
run over fixed blocks of ranks, so the lists come out the same for any number of threads.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.render.cpu.projection import COLORS, TILE, tile_rows, tile_span

_BLOCKS = 16


@nb.njit(parallel=True, cache=True, error_model="numpy")
def pack(splats, colors, order, packed):
    """Gather splats and colours `[V, 8 + C]` by rank: a tile then reads memory in rising order."""
    for block in nb.prange(_BLOCKS):
        for rank in range(block * len(order) // _BLOCKS, (block + 1) * len(order) // _BLOCKS):
            i = order[rank]
            for k in range(COLORS):
                packed[rank, k] = splats[i, k]
            for k in range(colors.shape[1]):
                packed[rank, COLORS + k] = colors[i, k]


@nb.njit(parallel=True, cache=True, error_model="numpy")
def _count(packed, width, height, tiles_x, counts):
    for block in nb.prange(_BLOCKS):
        for rank in range(block * len(packed) // _BLOCKS, (block + 1) * len(packed) // _BLOCKS):
            s = packed[rank]
            first, last = tile_rows(s, height)
            for row in range(first, last):
                left, right = tile_span(s, row, width, height)
                for tile in range(row * tiles_x + left, row * tiles_x + right):
                    counts[block, tile] += 1


@nb.njit(cache=True)
def _offsets(counts, tile_starts):
    """Running sums, tile by tile and block by block; `counts` becomes where each block writes next."""
    total = 0
    for tile in range(counts.shape[1]):
        tile_starts[tile] = total
        for block in range(counts.shape[0]):
            n = counts[block, tile]
            counts[block, tile] = total
            total += n
    tile_starts[counts.shape[1]] = total


@nb.njit(parallel=True, cache=True, error_model="numpy")
def _scatter(packed, width, height, tiles_x, cursor, starts, ranks, slots):
    for block in nb.prange(_BLOCKS):
        for rank in range(block * len(packed) // _BLOCKS, (block + 1) * len(packed) // _BLOCKS):
            s = packed[rank]
            at = starts[rank]
            first, last = tile_rows(s, height)
            for row in range(first, last):
                left, right = tile_span(s, row, width, height)
                for tile in range(row * tiles_x + left, row * tiles_x + right):
                    slot = cursor[block, tile]
                    cursor[block, tile] = slot + 1
                    ranks[slot] = rank
                    slots[at] = slot
                    at += 1


def bin_splats(
    packed: NDArray[np.float32], starts: NDArray[np.int64], width: int, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Lists of splats per tile.

    Args:
        packed: `[V, 8 + C]`, by rank.
        starts: `[V + 1]`, running sum of the tiles each splat touches.

    Returns:
        tile_starts `[T + 1]` into ranks; ranks `[S]`, rising within a tile; slots `[S]`, for each splat from `starts[rank]` on,
        its places in `ranks`.
    """
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    counts = np.zeros((_BLOCKS, tiles_x * tiles_y), np.int64)
    _count(packed, width, height, tiles_x, counts)
    tile_starts = np.empty(tiles_x * tiles_y + 1, np.int64)
    _offsets(counts, tile_starts)
    ranks = np.empty(starts[-1], np.int32)
    slots = np.empty(starts[-1], np.int32)
    _scatter(packed, width, height, tiles_x, counts, starts, ranks, slots)
    return tile_starts, ranks, slots


def balanced(tile_starts: NDArray[np.int64], threads: int) -> NDArray[np.int64]:
    """An order of the tiles in which equal shares carry equal work: tiles by falling length, dealt round."""
    by_length = np.argsort(-np.diff(tile_starts), kind="stable")
    return np.concatenate([by_length[t::threads] for t in range(threads)])
