"""A view's weights, computed once and kept: W and its transpose as products with a sparse matrix.

A splat and a patch that it contributes to are a *meeting*; its rows that are not 0 are kept as sixteen multiples of 1/65535 each,
patch by patch and front to back. That is 32 bytes a row, where to composite it again takes an exponential and the transmittance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.render.cpu.channels import add_scaled, no_lanes
from rtgs.render.cpu.layout import BATCH, ETA, PATCH, SPLAT, X, Y
from rtgs.render.cpu.patch import (
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
from rtgs.render.cpu.planes import add_each, products
from rtgs.render.cpu.simd import (
    LANES,
    any_lane,
    lanes_of,
    load,
    load_uint16,
    lowest_bit,
    negative_magnitude,
    prefetch,
    store,
    store_uint16,
    take_next,
    total,
    where,
)
from rtgs.render.cpu.splats import Splats
from rtgs.render.settings import TRANSMITTANCE_MIN

UNIT = 65535
AHEAD = 128  # rows that are asked for before their turn: a view's weights come from memory, which takes as long as the arithmetic


@nb.njit(cache=True, error_model="numpy")
def _weigh_patch(batch, boxes, count, x, y, state, at, alive, rows, entries, ends, keep, splats, masks, weights):
    """One plane at `at`: transmittance. `ends`: meetings and rows of the patch so far. Returns the rows that are still alive."""
    meeting, row = ends[0], ends[1]
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            k = group + lowest_bit(bits)
            s = SPLAT * k
            bits &= bits - 1
            reached, eta = rows_reached(batch, s, batch[s + X] - x, batch[s + Y] - y, alive, rows), batch[s + ETA]
            kept = 0
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
                if any_lane(w >= F(1)):
                    if keep:
                        store_uint16(weights, row * LANES, w)
                    row += 1
                    kept |= 1 << r
            if kept != 0:
                if keep:
                    splats[meeting], masks[meeting] = entries[k], kept
                meeting += 1
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    ends[0], ends[1] = meeting, row
    return alive


@nb.njit(cache=True, error_model="numpy")
def _weigh_tile(start, end, entries, splat_rows, left, top, side, alpha, ends, keep, splats, masks, weights):
    """Returns how many list entries the tile needed: whole batches."""
    down, across = patches_of(side, top, left, alpha.shape)
    state, alive = aligned(down * across * AREA), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    for p in range(down * across):
        fill(state, p * AREA, F(1))
        alive[p] = (1 << min(PATCH, alpha.shape[0] - top - p // across * PATCH)) - 1
    first, living = start, down * across
    while first < end and living > 0:
        count, living = min(BATCH, end - first), 0
        load_batch(entries, first, count, splat_rows, F(left), F(top), batch, boxes)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = F(p % across * PATCH), F(p // across * PATCH)
                which = (batch, boxes, count, x, y, state, p * AREA, alive[p], rows, entries[first:], ends[p])
                alive[p] = _weigh_patch(*which, keep, splats, masks, weights)
                living += 1 if alive[p] != 0 else 0
        first += count
    for p in range(down * across):
        place_alpha(state, p * AREA, top + p // across * PATCH, left + p % across * PATCH, alpha)
    return first - start


@nb.njit(parallel=True, cache=True, error_model="numpy")
def _weigh(tile_order, threads, tile_starts, entries, splat_rows, side, alpha, used, ends, keep, splats, masks, weights):
    """Fill `alpha` and `used` as `blend` does, and add to `ends` `[P, 2]` each patch's meetings and rows; with `keep`, which begins
    where `ends` says, write them too."""
    across, patches = (alpha.shape[1] + side - 1) // side, (side // PATCH) ** 2
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            which = (tile_starts[tile], tile_starts[tile + 1], entries, splat_rows, left, top, side, alpha)
            its_ends = ends[tile * patches : (tile + 1) * patches]
            used[tile] = _weigh_tile(*which, its_ends, keep, splats, masks, weights)


@nb.njit(cache=True, error_model="numpy")
def _by_splat(splats, gaussians):
    """The Gaussians with a meeting `[V]`, where in `order` theirs begin `[V + 1]`, and `order` `[M]`."""
    counts = np.zeros(gaussians, np.int32)
    for s in splats:
        counts[s] += 1
    seen = np.flatnonzero(counts).astype(np.int32)
    starts, order = np.zeros(len(seen) + 1, np.int32), np.empty(len(splats), np.int32)
    for v in range(len(seen)):
        starts[v + 1] = starts[v] + counts[seen[v]]
        counts[seen[v]] = starts[v]  # from here on: where the next one goes
    for m in range(len(splats)):
        order[counts[splats[m]]] = m
        counts[splats[m]] += 1
    return seen, starts, order


@nb.njit(inline="always")
def _fetch_planes(image, top, left, state):
    """A patch of `[C, H, W]`; zero beyond the picture."""
    channels, height, width = image.shape
    flat = image.reshape(-1)
    for c in range(channels):
        for r in range(PATCH):
            at, start = c * AREA + r * PATCH, (c * height + top + r) * width + left
            if top + r >= height:
                store(state, at, lanes_of(F(0)))
            elif left + PATCH <= width:
                store(state, at, load(flat, start))
            else:
                for i in range(PATCH):
                    state[at + i] = flat[start + i] if left + i < width else F(0)


@nb.njit(inline="always")
def _place_planes(state, factor, top, left, image):
    """The patch, times `factor`, into `[C, H, W]`."""
    channels, height, width = image.shape
    flat = image.reshape(-1)
    for c in range(channels):
        for r in range(min(PATCH, height - top)):
            at, start = c * AREA + r * PATCH, (c * height + top + r) * width + left
            if left + PATCH <= width:
                store(flat, start, load(state, at) * factor)
            else:
                for i in range(width - left):
                    flat[start + i] = state[at + i] * factor


@nb.njit(nogil=True, cache=True, error_model="numpy")
def _image(side, starts, splats, masks, weights, channels, through, colors, background, image):
    """`image` `[C, H, W]` = W·colors + through · background; colors `[N · C]`, background `[C]`, through `[H · W]`."""
    across, patches = (image.shape[2] + side - 1) // side, (side // PATCH) ** 2
    state = aligned(len(channels) * AREA)
    for tile in range((len(starts) - 1) // patches):
        left, top = tile % across * side, tile // across * side
        down, columns = patches_of(side, top, left, image.shape[1:])
        for p in range(down * columns):
            for c in range(len(channels)):
                fill(state, c * AREA, F(0))
            meeting, row = starts[tile * patches + p]
            for m in range(meeting, starts[tile * patches + p + 1, 0]):
                bits, color = np.int64(masks[m]), splats[m] * len(channels)
                while bits != 0:
                    i = lowest_bit(bits) * PATCH
                    bits &= bits - 1
                    prefetch(weights, (row + AHEAD) * LANES)
                    w = load_uint16(weights, row * LANES)
                    row += 1
                    for c in range(len(channels)):
                        store(state, i, load(state, i) + w * colors[color + c])
                        i += AREA
            _place_planes(state, F(1 / UNIT), top + p // columns * PATCH, left + p % columns * PATCH, image)
    add_each(image.reshape(len(channels), -1), background, through.reshape(1, -1))


@nb.njit(cache=True, error_model="numpy")
def _gather(seen, seen_starts, order, sums, out):
    """out `[N, C]` = Σ of each Gaussian's meetings, where it has any."""
    channels = out.shape[1]
    for v in range(len(seen)):
        for j in range(seen_starts[v], seen_starts[v + 1]):
            for c in range(channels):
                out[seen[v], c] += sums[order[j] * channels + c]


@nb.njit(nogil=True, cache=True, error_model="numpy")
def _adjoint(side, starts, splats, masks, weights, channels, through, image, seen, seen_starts, order, out):
    """`out` `[N, C]` = Wᵀ·image of `[C, H, W]`, where it is not 0. Returns Σ through · image `[1, C]`."""
    sums = np.empty(len(splats) * len(channels), np.float32)  # of each meeting
    across, patches = (image.shape[2] + side - 1) // side, (side // PATCH) ** 2
    state = aligned(len(channels) * AREA)
    for tile in range((len(starts) - 1) // patches):
        left, top = tile % across * side, tile // across * side
        down, columns = patches_of(side, top, left, image.shape[1:])
        for p in range(down * columns):
            _fetch_planes(image, top + p // columns * PATCH, left + p % columns * PATCH, state)
            meeting, row = starts[tile * patches + p]
            for m in range(meeting, starts[tile * patches + p + 1, 0]):
                bits, colors = np.int64(masks[m]), no_lanes(channels)
                while bits != 0:
                    i = lowest_bit(bits) * PATCH
                    bits &= bits - 1
                    prefetch(weights, (row + AHEAD) * LANES)
                    colors = add_scaled(colors, load_uint16(weights, row * LANES), state, i, AREA)
                    row += 1
                for c in range(len(channels)):
                    sums[m * len(channels) + c] = F(1 / UNIT) * total(colors[c])
    _gather(seen, seen_starts, order, sums, out)
    return products(through.reshape(1, -1), image.reshape(len(channels), -1))


@dataclass(frozen=True, eq=False)
class Survey:
    """What is known of a view before its weights are kept.

    Attributes:
        alpha: `[H, W]`. used: `[T]`, how many of its list entries each tile needed.
        ends: `[P, 2]`: meetings and rows of each patch of each tile (of the whole tile, in the picture or not).
    """

    alpha: NDArray[np.float32]
    used: NDArray[np.int64]
    ends: NDArray[np.int64]

    @staticmethod
    def of(splats: Splats) -> Survey:
        tiles = len(splats.tile_starts) - 1
        ends = np.zeros((tiles * (splats.side // PATCH) ** 2, 2), np.int64)
        survey = Survey(np.empty(splats.shape, np.float32), np.empty(tiles, np.int64), ends)
        nothing: list[Any] = [np.empty(0, np.int32), np.empty(0, np.uint16), np.empty(0, np.uint16)]
        arguments: list[Any] = [*splats.lists, survey.alpha, survey.used, ends, False, *nothing]
        _weigh(*arguments)
        return survey

    @property
    def nbytes(self) -> int:
        """What the weights would take."""
        meetings, rows = self.ends.sum(0)
        per_meeting = 4 + 2 + 4 + 4 + 4  # splats, masks, order; seen and its starts at the most
        return int(2 * LANES * rows + per_meeting * meetings + 16 * (len(self.ends) + 1) + 4 + self.alpha.nbytes)


@dataclass(frozen=True, eq=False)
class Weights:
    """W of one view. Its products are one thread's work and let go of Python's lock: views go side by side.

    Attributes:
        side: as in `Splats`. starts: `[P + 1, 2]`, meetings and rows before each patch of each tile.
        splats: `[M]`, of each meeting. masks: `[M]`, bits of its rows. weights: `[R · 16]`.
        seen: `[V]`, Gaussians with a meeting; theirs are `order[seen_starts[v] : seen_starts[v + 1]]`.
        through: `[H, W]`, 1 − α.
    """

    side: int
    starts: NDArray[np.int64]
    splats: NDArray[np.int32]
    masks: NDArray[np.uint16]
    weights: NDArray[np.uint16]
    seen: NDArray[np.int32]
    seen_starts: NDArray[np.int32]
    order: NDArray[np.int32]
    through: NDArray[np.float32]
    gaussians: int

    @staticmethod
    def of(splats: Splats, survey: Survey) -> Weights:
        starts = np.zeros((len(survey.ends) + 1, 2), np.int64)
        np.cumsum(survey.ends, axis=0, out=starts[1:])
        meetings, rows = starts[-1]
        whose, masks, weights = np.empty(meetings, np.int32), np.empty(meetings, np.uint16), np.empty(rows * LANES, np.uint16)
        alpha, used = np.empty_like(survey.alpha), np.empty_like(survey.used)
        arguments: list[Any] = [*splats.lists, alpha, used, starts[:-1].copy(), True, whose, masks, weights]
        _weigh(*arguments)
        gaussians = len(splats.tiles)
        seen, seen_starts, order = _by_splat(whose, gaussians)
        return Weights(splats.side, starts, whose, masks, weights, seen, seen_starts, order, 1.0 - alpha, gaussians)

    @property
    def shape(self) -> tuple[int, int]:
        return self.through.shape

    def _matrix(self, channels: int) -> list[Any]:
        return [self.side, self.starts, self.splats, self.masks, self.weights, (0,) * channels, self.through]

    def image(self, colors: NDArray[np.float32], background: NDArray[np.float32]) -> NDArray[np.float32]:
        """`[H, W, C]` of `[N, C]` and `[C]`; each channel lies in one piece."""
        image = np.empty((len(background), *self.shape), np.float32)
        arguments = [*self._matrix(len(background)), np.ascontiguousarray(colors, np.float32).ravel(), background, image]
        _image(*arguments)
        return image.transpose(1, 2, 0)

    def adjoint(self, image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`[N, C]` and `[C]` of `[H, W, C]`: the transpose."""
        planes = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)
        out = np.zeros((self.gaussians, len(planes)), np.float32)
        arguments = [*self._matrix(len(planes)), planes, self.seen, self.seen_starts, self.order, out]
        background = _adjoint(*arguments)
        return out, background[0]

    @property
    def nbytes(self) -> int:
        arrays = (self.starts, self.splats, self.masks, self.weights, self.seen, self.seen_starts, self.order, self.through)
        return sum(a.nbytes for a in arrays)
