"""A view's weights, computed once and kept: W and its transpose as products with a sparse matrix.

The picture is cut into blocks of 8×8 pixels. A splat and a block that it contributes to are a *meeting*. Its 64 weights are kept as
multiples of 1/65535, block by block and front to back: 128 bytes a meeting. To read them is cheaper than to composite again, which takes
exponentials and the transmittance. A block's pixels fill four registers a channel, which hold them while its meetings are added. The
background counts as one more splat behind all the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import inlined, kernel
from rtgs.renderer.cpu.channels import REGISTERS, SUMMED, add_products, add_weighted, load_all, no_lanes, store_all
from rtgs.renderer.cpu.layout import BATCH, ETA, PATCH, SPLAT, X, Y
from rtgs.renderer.cpu.patch import (
    AREA,
    F,
    aligned,
    candidates,
    fill,
    load_batch,
    opacity,
    patches_of,
    place_alpha,
    rows_reached,
    still_alive,
    time_to_look,
)
from rtgs.renderer.cpu.simd import (
    LANES,
    copy_half,
    lanes_of,
    load,
    lowest_bit,
    magnitude,
    mask_bits,
    negative_magnitude,
    prefetch,
    store,
    store_uint16,
    take_next,
    where,
)
from rtgs.renderer.cpu.splats import Splats
from rtgs.renderer.settings import TRANSMITTANCE_MIN

UNIT = 65535
BACKGROUND = -1  # among splats
BLOCK = 8  # pixels a side: a quarter of a patch
PIXELS = BLOCK * BLOCK
assert PIXELS == REGISTERS * LANES and 2 * BLOCK == PATCH == LANES
LINE = 32  # weights in a cache line
AHEAD = 32  # meetings whose weights are asked for before their turn, where sums are added to here and there in between


class Meetings(NamedTuple):
    """W as a sparse matrix of blocks.

    Attributes:
        starts: `[B + 1]`, meetings before each block, blocks in the order of reading.
        splats: `[M]`, whose meeting, as a place in `seen`; V for the background's.
        weights: `[M · 64]`, in multiples of 1/65535.
        seen: `[V]`, Gaussians with a meeting.
    """

    starts: NDArray[np.int64]
    splats: NDArray[np.int32]
    weights: NDArray[np.uint16]
    seen: NDArray[np.int32]


@inlined
def _blocks_of(shape):
    """How many there are down and across."""
    return (shape[0] + BLOCK - 1) // BLOCK, (shape[1] + BLOCK - 1) // BLOCK


@kernel()
def _meet(splat, met, one, where_to, keep, splats, weights):
    """Enter a splat's meetings with the four blocks of a patch.

    Args:
        met: 32 bits, eight a block: a block is met where one of them is set.
        one: the splat's weights in the patch.
        where_to: row and column of the first block; how many blocks are down and across the picture; for each of these, where its next
            meeting goes.
        keep: whether meetings are written into `splats` and `weights`, or only counted.
    """
    row, column, blocks, ends = where_to
    for q in range(4):
        its_row, its_column = row + q // 2, column + q % 2
        if (met >> (BLOCK * q)) & 0xFF and its_row < blocks[0] and its_column < blocks[1]:
            block = its_row * blocks[1] + its_column
            m = ends[block]
            ends[block] = m + 1
            if keep:
                splats[m] = splat
                for r in range(BLOCK):
                    copy_half(weights, m * PIXELS + r * BLOCK, one, (r + BLOCK * (q // 2)) * LANES + BLOCK * (q % 2))


@kernel()
def _weigh_patch(batch, boxes, count, x, y, state, at, alive, rows, one, entries, where_to, keep, splats, weights):
    """One plane at `at`: transmittance. `one`: room for one splat's weights, all 0. `where_to`: see `_meet`. Returns the rows that are
    still alive."""
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            k = group + lowest_bit(bits)
            s = SPLAT * k
            bits &= bits - 1
            reached, eta = rows_reached(batch, s, batch[s + X] - x, batch[s + Y] - y, alive, rows), batch[s + ETA]
            kept = met = 0
            while reached != 0:
                r = lowest_bit(reached)
                reached &= reached - 1
                i = at + r * PATCH
                t = load(state, i)
                w = opacity(rows, r, eta) * t
                after = t - w
                is_open = after > F(TRANSMITTANCE_MIN)
                store(state, i, where(is_open, after, negative_magnitude(t)))
                w = where(is_open, w * F(UNIT) + F(0.5), F(0))
                pixels = mask_bits(w >= F(1))
                if pixels != 0:
                    met |= pixels << (LANES * (r // BLOCK))
                    if keep:
                        store_uint16(one, r * LANES, w)
                        kept |= 1 << r
            if met != 0:
                _meet(entries[k], met, one, where_to, keep, splats, weights)
            while kept != 0:
                store_uint16(one, lowest_bit(kept) * LANES, lanes_of(F(0)))
                kept &= kept - 1
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    return alive


@kernel()
def _weigh_background(state, at, one, where_to, keep, splats, weights):
    """What the transmittances at `at` leave of it: something in every block, since compositing ends before they are 0."""
    for r in range(PATCH):
        store_uint16(one, r * LANES, magnitude(load(state, at + r * PATCH)) * F(UNIT) + F(0.5))
    _meet(BACKGROUND, -1, one, where_to, keep, splats, weights)


@kernel()
def _weigh_tile(start, end, entries, splat_rows, left, top, side, alpha, ends, keep, splats, weights):
    """Returns how many list entries the tile needed: whole batches."""
    down, across = patches_of(side, top, left, alpha.shape)
    blocks = _blocks_of(alpha.shape)
    state, alive = aligned(down * across * AREA), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    one = np.zeros(AREA, np.uint16)
    for p in range(down * across):
        fill(state, p * AREA, F(1))
        alive[p] = (1 << min(PATCH, alpha.shape[0] - top - p // across * PATCH)) - 1
    first, living = start, down * across
    while first < end and living > 0:
        count, living = min(BATCH, end - first), 0
        load_batch(entries, first, count, splat_rows, F(left), F(top), batch, boxes)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = p % across * PATCH, p // across * PATCH
                which = (batch, boxes, count, F(x), F(y), state, p * AREA, alive[p], rows, one, entries[first:])
                where_to = ((top + y) // BLOCK, (left + x) // BLOCK, blocks, ends)
                alive[p] = _weigh_patch(*which, where_to, keep, splats, weights)
                living += 1 if alive[p] != 0 else 0
        first += count
    for p in range(down * across):
        x, y = left + p % across * PATCH, top + p // across * PATCH
        place_alpha(state, p * AREA, y, x, alpha)
        _weigh_background(state, p * AREA, one, (y // BLOCK, x // BLOCK, blocks, ends), keep, splats, weights)
    return first - start


@kernel(parallel=True)
def _weigh(lists, alpha, used, ends, keep, splats, weights):
    """Fill `alpha` and `used` as `blend` does, and add each block's meetings to `ends` `[B]`; with `keep`, which begins where `ends`
    says, write them too."""
    tile_order, threads, tile_starts, entries, splat_rows, side = lists
    across = (alpha.shape[1] + side - 1) // side
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            which = (tile_starts[tile], tile_starts[tile + 1], entries, splat_rows, left, top, side, alpha)
            used[tile] = _weigh_tile(*which, ends, keep, splats, weights)


@kernel()
def _renumbered(splats, gaussians):
    """The Gaussians with a meeting `[V]`, and splats as their places among these, V for the background."""
    place = np.zeros(gaussians, np.int32)
    for s in splats:
        if s != BACKGROUND:
            place[s] = 1
    seen = np.flatnonzero(place).astype(np.int32)
    for v in range(len(seen)):
        place[seen[v]] = v
    for m in range(len(splats)):
        splats[m] = place[splats[m]] if splats[m] != BACKGROUND else len(seen)
    return seen


@inlined
def _fetch(image, top, left, state):
    """A block of `[C, H, W]`; zero beyond the picture."""
    channels, height, width = image.shape
    flat = image.ravel()
    for c in range(channels):
        for r in range(BLOCK):
            at, start = c * PIXELS + r * BLOCK, (c * height + top + r) * width + left
            if top + r < height and left + BLOCK <= width:
                copy_half(state, at, flat, start)
            else:
                for i in range(BLOCK):
                    state[at + i] = flat[start + i] if top + r < height and left + i < width else F(0)


@inlined
def _place(state, top, left, image):
    """The block into `[C, H, W]`."""
    channels, height, width = image.shape
    flat = image.ravel()
    for c in range(channels):
        for r in range(min(BLOCK, height - top)):
            at, start = c * PIXELS + r * BLOCK, (c * height + top + r) * width + left
            if left + BLOCK <= width:
                copy_half(flat, start, state, at)
            else:
                for i in range(width - left):
                    flat[start + i] = state[at + i]


@kernel(concurrent=True)
def _image(meetings, registers, across, colors, background, image):
    """`image` `[C, H, W]` of colors `[N, C]` and background `[C]`. `across`: blocks. `registers`: a tuple as long as what a block's
    pixels fill of them."""
    starts, splats, weights, seen = meetings
    channels = len(image)
    state, theirs = aligned(channels * PIXELS), np.empty((len(seen) + 1) * channels, np.float32)
    for c in range(channels):
        for v in range(len(seen)):
            theirs[v * channels + c] = F(1 / UNIT) * colors[seen[v], c]
        theirs[len(seen) * channels + c] = F(1 / UNIT) * background[c]
    for block in range(len(starts) - 1):
        sums = no_lanes(registers)
        for m in range(starts[block], starts[block + 1]):
            sums = add_weighted(sums, weights, m * PIXELS, theirs, splats[m] * channels)
        store_all(state, sums)
        _place(state, block // across * BLOCK, block % across * BLOCK, image)


@inlined
def _taken(sums, at):
    """The sum that is kept in `SUMMED` parts, which are 0 from here on."""
    total = 0.0
    for i in range(at * SUMMED, (at + 1) * SUMMED):
        total += sums[i]
        sums[i] = 0
    return total


@kernel(concurrent=True)
def _adjoint(meetings, registers, across, image, colors, background):
    """The transpose, into colors `[N, C]`, where they are not 0, and background `[C]`, in float64."""
    starts, splats, weights, seen = meetings
    channels = len(image)
    state, sums = aligned(channels * PIXELS), np.zeros((len(seen) + 1) * channels * SUMMED, np.float32)
    background[:] = 0
    for block in range(len(starts) - 1):
        _fetch(image, block // across * BLOCK, block % across * BLOCK, state)
        pixels = load_all(registers, state)
        for m in range(starts[block], starts[block + 1]):
            for line in range(PIXELS // LINE):
                prefetch(weights, (m + AHEAD) * PIXELS + line * LINE)
            add_products(sums, splats[m] * channels * SUMMED, pixels, weights, m * PIXELS)
        for c in range(channels):  # what adds up over the whole picture is taken block by block, or its last digits would go
            background[c] += _taken(sums, len(seen) * channels + c) / UNIT
    for v in range(len(seen)):
        for c in range(channels):
            colors[seen[v], c] = _taken(sums, v * channels + c) / UNIT


@dataclass(frozen=True, eq=False)
class Survey:
    """What is known of a view before its weights are kept.

    Attributes:
        alpha: `[H, W]`. used: `[T]`, how many of its list entries each tile needed.
        counts: `[B]`, meetings of each block.
    """

    alpha: NDArray[np.float32]
    used: NDArray[np.int64]
    counts: NDArray[np.int64]

    @staticmethod
    def of(splats: Splats) -> Survey:
        down, across = _blocks_of(splats.shape)
        counts = np.zeros(down * across, np.int64)
        survey = Survey(np.empty(splats.shape, np.float32), np.empty(len(splats.tile_order), np.int64), counts)
        _weigh(splats.lists, survey.alpha, survey.used, counts, False, np.empty(0, np.int32), np.empty(0, np.uint16))
        return survey

    @property
    def nbytes(self) -> int:
        """What the weights would take."""
        per_meeting = 2 * PIXELS + 4 + 4  # splats; seen at the most
        return int(per_meeting * self.counts.sum()) + 8 * (len(self.counts) + 1)


@dataclass(frozen=True, eq=False)
class Weights:
    """W of one view. Its products run on one thread and release the GIL, so that several views can be used at once.

    Attributes:
        meetings: the matrix.
        gaussians: N.
        shape: H and W.
    """

    meetings: Meetings
    gaussians: int
    shape: tuple[int, int]

    @staticmethod
    def of(splats: Splats, survey: Survey) -> Weights:
        starts = np.zeros(len(survey.counts) + 1, np.int64)
        np.cumsum(survey.counts, out=starts[1:])
        whose, weights = np.empty(starts[-1], np.int32), _on_a_line(starts[-1] * PIXELS)
        alpha, used = np.empty_like(survey.alpha), np.empty_like(survey.used)
        _weigh(splats.lists, alpha, used, starts[:-1].copy(), True, whose, weights)
        gaussians = len(splats.tiles)
        return Weights(Meetings(starts, whose, weights, _renumbered(whose, gaussians)), gaussians, splats.shape)

    @property
    def seen(self) -> NDArray[np.int32]:
        """`[V]`, Gaussians with a meeting."""
        return self.meetings.seen

    @property
    def _across(self) -> int:
        return int(_blocks_of(self.shape)[1])

    def image(self, colors: NDArray[np.float32], background: NDArray[np.float32]) -> NDArray[np.float32]:
        """`[H, W, C]` of `[N, C]` and `[C]`; each channel lies in one piece."""
        channels = len(background)
        image, numbers = np.empty((channels, *self.shape), np.float32), np.ascontiguousarray(colors, np.float32)
        _image(self.meetings, (0,) * (REGISTERS * channels), self._across, numbers, background, image)
        return image.transpose(1, 2, 0)

    def adjoint(self, image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`[N, C]` and `[C]` of `[H, W, C]`: the transpose."""
        planes = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)
        channels = len(planes)
        colors, background = np.zeros((self.gaussians, channels), np.float32), np.empty(channels)
        _adjoint(self.meetings, (0,) * (REGISTERS * channels), self._across, planes, colors, background)
        return colors, background.astype(np.float32)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self.meetings)


def _on_a_line(count: int) -> NDArray[np.uint16]:
    """`[count]`, from the beginning of a cache line."""
    raw = np.empty(count + LINE, np.uint16)
    skip = -raw.ctypes.data % (2 * LINE) // 2
    return raw[skip : skip + count]
