"""Composite splats front to back: forwards, backwards (reverse mode) and sideways (with tangents, forward mode).

A tile (`layout.tile_side`) has one list of splats, front to back. They come in batches that fit the first-level cache; within a batch
each 16×16 patch of the tile takes the splats whose box it meets, sixteen boxes a comparison. A row of a patch is one register
(`simd.Lanes`). For a splat and a patch one register holds the sixteen rows and tells which of them the ellipse reaches; only those are
visited, and none whose pixels are all finished. The reverse kernels also run front to back: what remains of the pixel's colour is a
running difference, so no per-pixel lists are kept. Their sums over a tile are complete before they touch memory.

A finished pixel (the next splat would leave less than 1e-4 of the light) keeps its transmittance with a minus sign: it then fails
the same comparison for ever after.

Threads draw tiles from a common counter, the longest lists first, until none is left. In each section below, the kernel for a patch is
called by that for a tile, and that by the one for the picture.

Arguments that several kernels have:

| argument                  | what it is                                                                                      |
|---------------------------|-------------------------------------------------------------------------------------------------|
| `batch`, `boxes`, `count` | splats of a batch, and their bounding boxes (see `patch.load_batch`)                            |
| `x`, `y`                  | the patch's corner from the tile's, pixels                                                      |
| `channels`                | a tuple of length C: its type carries C into the compiled code                                  |
| `state`, `at`             | planes of 16×16 numbers of all patches of a tile, and where this patch's planes begin            |
| `alive`                   | rows of the patch with a pixel that is not finished, as bits                                    |
| `rows`                    | room for two numbers a row (see `patch.rows_reached`)                                           |
| `lists`                   | the tiles' lists (see `arguments.Lists`)                                                        |
"""

from __future__ import annotations

import numba as nb
import numpy as np

from rtgs.base.compiled import inlined, kernel
from rtgs.renderer.cpu.channels import add_scaled, no_lanes, weighted_sum
from rtgs.renderer.cpu.layout import (
    BATCH,
    COLORS,
    DX,
    DXX,
    DXY,
    DY,
    DYY,
    ETA,
    G_COLORS,
    ONE,
    PATCH,
    SPLAT,
    X,
    Y,
)
from rtgs.renderer.cpu.patch import (
    AREA,
    F,
    aligned,
    candidates,
    fetch,
    fill,
    load_batch,
    opacity,
    patches_of,
    place,
    place_alpha,
    rows_reached,
    still_alive,
    time_to_look,
)
from rtgs.renderer.cpu.projection import slot_width
from rtgs.renderer.cpu.simd import (
    LANES,
    lane_numbers,
    lanes_of,
    load,
    lowest_bit,
    negative_magnitude,
    store,
    take_next,
    total,
    where,
)
from rtgs.renderer.settings import ALPHA_MAX, TRANSMITTANCE_MIN

# --- forwards --------------------------------------------------------------------------------------


@kernel()
def _blend_patch(batch, boxes, count, x, y, channels, state, at, alive, rows):
    """Planes from `at` on: transmittance, C colours. Returns the rows that are still alive."""
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            s = SPLAT * (group + lowest_bit(bits))
            bits &= bits - 1
            reached, eta = rows_reached(batch, s, batch[s + X] - x, batch[s + Y] - y, alive, rows), batch[s + ETA]
            while reached != 0:
                r = lowest_bit(reached)
                reached &= reached - 1
                i = at + r * PATCH
                al, t = opacity(rows, r, eta), load(state, i)
                w = al * t
                after = t - w
                is_open = after > F(TRANSMITTANCE_MIN)
                w = where(is_open, w, F(0))
                store(state, i, where(is_open, after, negative_magnitude(t)))
                for c in range(len(channels)):
                    i += AREA
                    store(state, i, load(state, i) + w * batch[s + COLORS + c])
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    return alive


@kernel()
def _blend_tile(start, end, entries, splats, left, top, side, channels, image, alpha):
    """Returns how many list entries the tile needed: whole batches."""
    planes = (1 + len(channels)) * AREA
    down, across = patches_of(side, top, left, alpha.shape)
    state, alive = aligned(down * across * planes), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    for p in range(down * across):
        fill(state, p * planes, F(1))
        for c in range(len(channels)):
            fill(state, p * planes + (1 + c) * AREA, F(0))
        alive[p] = (1 << min(PATCH, alpha.shape[0] - top - p // across * PATCH)) - 1
    first, living = start, down * across
    while first < end and living > 0:
        count, living = min(BATCH, end - first), 0
        load_batch(entries, first, count, splats, F(left), F(top), batch, boxes)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = F(p % across * PATCH), F(p // across * PATCH)
                alive[p] = _blend_patch(batch, boxes, count, x, y, channels, state, p * planes, alive[p], rows)
                living += 1 if alive[p] != 0 else 0
        first += count
    for p in range(down * across):
        patch_top, patch_left = top + p // across * PATCH, left + p % across * PATCH
        place_alpha(state, p * planes, patch_top, patch_left, alpha)
        for c in range(len(channels)):
            place(state, p * planes + (1 + c) * AREA, F(1), patch_top, patch_left, image, c)
    return first - start


@kernel(parallel=True)
def blend(lists, channels, image, alpha, used):
    """Fill `image` `[H, W, C]`, `alpha` `[H, W]` and `used` `[T]`, how many of its list entries a tile needed.

    `channels` is a tuple of length C: its type carries C into the compiled code.
    """
    tile_order, threads, tile_starts, entries, splats, side = lists
    across = (image.shape[1] + side - 1) // side
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            start, end = tile_starts[tile], tile_starts[tile + 1]
            used[tile] = _blend_tile(start, end, entries, splats, left, top, side, channels, image, alpha)


# --- backwards -------------------------------------------------------------------------------------


@kernel()
def _blend_patch_backward(batch, boxes, count, x, y, channels, state, at, alive, rows, gradients):
    """Planes from `at` on: transmittance, what remains of ∂L·colour, C + 1 image gradients (alpha last).

    Adds to `gradients`, a row of `LANES` numbers a splat of the batch.
    """
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            k = group + lowest_bit(bits)
            s = SPLAT * k
            bits &= bits - 1
            from_y = batch[s + Y] - y
            reached, eta = rows_reached(batch, s, batch[s + X] - x, from_y, alive, rows), batch[s + ETA]
            if reached == 0:
                continue
            colors = no_lanes(channels)
            m0, m1, m2 = lanes_of(F(0)), lanes_of(F(0)), lanes_of(F(0))
            while reached != 0:
                r = lowest_bit(reached)
                reached &= reached - 1
                i = at + r * PATCH
                al, t = opacity(rows, r, eta), load(state, i)
                w = al * t
                after = t - w
                is_open = after > F(TRANSMITTANCE_MIN)
                w = where(is_open, w, F(0))
                store(state, i, where(is_open, after, negative_magnitude(t)))
                g_alpha = load(state, i + (2 + len(channels)) * AREA)
                here = weighted_sum(channels, g_alpha, state, i + 2 * AREA, AREA, batch, s + COLORS)
                remains = load(state, i + AREA) - w * here
                store(state, i + AREA, remains)
                colors = add_scaled(colors, w, state, i + 2 * AREA, AREA)
                # E = α·∂L/∂α = ∂L/∂ln α; zero where α is held at its maximum.
                e = al * (t * here - remains / (F(1) - al))
                e = where(is_open & (al < F(ALPHA_MAX)), e, F(0))
                dy = F(r) + F(0.5) - from_y
                m0 = m0 + e
                m1 = m1 + e * dy
                m2 = m2 + e * (dy * dy)
            # dx is the same in every row: the moments in x are taken once, of the column sums.
            dx = lane_numbers() + F(0.5) - (batch[s + X] - x)
            g, m0x = k * LANES, m0 * dx
            gradients[g + ONE] += total(m0)
            gradients[g + DX] += total(m0x)
            gradients[g + DY] += total(m1)
            gradients[g + DXX] += total(m0x * dx)
            gradients[g + DXY] += total(m1 * dx)
            gradients[g + DYY] += total(m2)
            for c in range(len(channels)):
                gradients[g + G_COLORS + c] += total(colors[c])
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    return alive


@inlined
def _write_slots(gradients, count, width, slot, slot_grads):
    for k in range(count):
        for q in range(width):
            slot_grads[(slot + k) * width + q] = gradients[k * LANES + q]


@kernel()
def _blend_tile_backward(
    start, end, entries, splats, left, top, side, channels, image, alpha, g_image, g_alpha, slot, slot_grads
):
    channel_count = len(channels)
    planes, width = (3 + channel_count) * AREA, slot_width(G_COLORS + channel_count)
    down, across = patches_of(side, top, left, alpha.shape)
    state, alive = aligned(down * across * planes), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    gradients = aligned(BATCH * LANES)
    for p in range(down * across):
        at, patch_top, patch_left = p * planes, top + p // across * PATCH, left + p % across * PATCH
        fill(state, at, F(1))
        fetch(g_alpha, 0, patch_top, patch_left, state, at + (2 + channel_count) * AREA)
        fetch(alpha, 0, patch_top, patch_left, state, at + AREA)
        for r in range(PATCH):
            i = at + r * PATCH
            store(state, i + AREA, load(state, i + AREA) * load(state, i + (2 + channel_count) * AREA))
        for c in range(channel_count):
            fetch(image, c, patch_top, patch_left, state, at + (2 + c) * AREA)
            for r in range(PATCH):
                store(rows, 0, load(state, at + (2 + c) * AREA + r * PATCH))
                for i in range(min(PATCH, alpha.shape[1] - patch_left)):
                    if patch_top + r < alpha.shape[0]:
                        state[at + (2 + c) * AREA + r * PATCH + i] = g_image[patch_top + r, patch_left + i, c]
                i = at + r * PATCH
                store(state, i + AREA, load(state, i + AREA) + load(rows, 0) * load(state, i + (2 + c) * AREA))
        alive[p] = (1 << min(PATCH, alpha.shape[0] - patch_top)) - 1
    for first in range(start, end, BATCH):
        count = min(BATCH, end - first)
        load_batch(entries, first, count, splats, F(left), F(top), batch, boxes)
        gradients[:] = F(0)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = F(p % across * PATCH), F(p // across * PATCH)
                alive[p] = _blend_patch_backward(
                    batch, boxes, count, x, y, channels, state, p * planes, alive[p], rows, gradients
                )
        _write_slots(gradients, count, width, slot + first - start, slot_grads)


@kernel(parallel=True)
def blend_backward(lists, channels, image, alpha, g_image, g_alpha, slots):
    """Fill the grads of `slots`, rows of `slot_width(6 + C)`.

    Args:
        image, g_image: `[H, W, C]`. alpha, g_alpha: `[H, W, 1]`.
    """
    tile_order, threads, tile_starts, entries, splats, side = lists
    used, slot_starts, slot_grads = slots
    across = (image.shape[1] + side - 1) // side
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            start, slot = tile_starts[tile], slot_starts[tile]
            its_list = (start, start + used[tile], entries, splats, left, top, side, channels)
            _blend_tile_backward(*its_list, image, alpha, g_image, g_alpha, slot, slot_grads)


@kernel()
def _blend_patch_adjoint(batch, boxes, count, x, y, channels, state, at, alive, rows, gradients):
    """Planes from `at` on: transmittance, C image gradients. Adds to `gradients`, a row of `LANES` numbers a splat of the batch."""
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            k = group + lowest_bit(bits)
            s = SPLAT * k
            bits &= bits - 1
            reached, eta = rows_reached(batch, s, batch[s + X] - x, batch[s + Y] - y, alive, rows), batch[s + ETA]
            if reached == 0:
                continue
            colors = no_lanes(channels)
            while reached != 0:
                r = lowest_bit(reached)
                reached &= reached - 1
                i = at + r * PATCH
                t = load(state, i)
                w = opacity(rows, r, eta) * t
                after = t - w
                is_open = after > F(TRANSMITTANCE_MIN)
                store(state, i, where(is_open, after, negative_magnitude(t)))
                colors = add_scaled(colors, where(is_open, w, F(0)), state, i + AREA, AREA)
            for c in range(len(channels)):
                gradients[k * LANES + c] += total(colors[c])
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    return alive


@kernel()
def _blend_tile_adjoint(start, end, entries, splats, left, top, side, channels, g_image, slot, slot_grads):
    planes, width = (1 + len(channels)) * AREA, slot_width(len(channels))
    down, across = patches_of(side, top, left, g_image.shape)
    state, alive = aligned(down * across * planes), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    gradients = aligned(BATCH * LANES)
    for p in range(down * across):
        patch_top, patch_left = top + p // across * PATCH, left + p % across * PATCH
        fill(state, p * planes, F(1))
        for c in range(len(channels)):
            fetch(g_image, c, patch_top, patch_left, state, p * planes + (1 + c) * AREA)
        alive[p] = (1 << min(PATCH, g_image.shape[0] - patch_top)) - 1
    for first in range(start, end, BATCH):
        count = min(BATCH, end - first)
        load_batch(entries, first, count, splats, F(left), F(top), batch, boxes)
        gradients[:] = F(0)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = F(p % across * PATCH), F(p // across * PATCH)
                alive[p] = _blend_patch_adjoint(batch, boxes, count, x, y, channels, state, p * planes, alive[p], rows, gradients)
        _write_slots(gradients, count, width, slot + first - start, slot_grads)


@kernel(parallel=True)
def blend_adjoint(lists, channels, g_image, slots):
    """Fill the grads of `slots`, rows of `slot_width(C)`, with the colours' gradients alone: the transpose of `blend` as a linear map
    of the colours."""
    tile_order, threads, tile_starts, entries, splats, side = lists
    used, slot_starts, slot_grads = slots
    across = (g_image.shape[1] + side - 1) // side
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            start, slot = tile_starts[tile], slot_starts[tile]
            _blend_tile_adjoint(start, start + used[tile], entries, splats, left, top, side, channels, g_image, slot, slot_grads)


# --- sideways --------------------------------------------------------------------------------------


@kernel()
def _blend_patch_tangents(
    batch, boxes, count, x, y, channels, directions, entries, first, tangents, state, at, alive, rows, polynomial
):
    """Planes from `at` on: transmittance, C colours; then for each direction their tangents."""
    channel_count, ways = len(channels), len(directions)
    width = G_COLORS + channel_count
    for group in range(0, count, LANES):
        bits = candidates(boxes, group, count, x, y)
        while bits != 0:
            k = group + lowest_bit(bits)
            s = SPLAT * k
            bits &= bits - 1
            from_y = batch[s + Y] - y
            reached, eta = rows_reached(batch, s, batch[s + X] - x, from_y, alive, rows), batch[s + ETA]
            if reached == 0:
                continue
            tangent = entries[first + k] * ways * width
            dy = lane_numbers() + F(0.5) - from_y
            for j in range(ways):
                g = tangent + j * width
                store(polynomial, 2 * j * LANES, tangents[g + ONE] + dy * (tangents[g + DY] + dy * tangents[g + DYY]))
                store(polynomial, (2 * j + 1) * LANES, tangents[g + DX] + dy * tangents[g + DXY])
            dx = lane_numbers() + F(0.5) - (batch[s + X] - x)
            while reached != 0:
                r = lowest_bit(reached)
                reached &= reached - 1
                i = at + r * PATCH
                al, t = opacity(rows, r, eta), load(state, i)
                w = al * t
                after = t - w
                is_open = after > F(TRANSMITTANCE_MIN)
                w = where(is_open, w, F(0))
                store(state, i, where(is_open, after, negative_magnitude(t)))
                for c in range(channel_count):
                    i += AREA
                    store(state, i, load(state, i) + w * batch[s + COLORS + c])
                moves = where(al < F(ALPHA_MAX), w, F(0))  # zero where α is held at its maximum
                al = where(is_open, al, F(0))
                for j in range(ways):
                    i += AREA
                    g = tangent + j * width
                    slope = polynomial[(2 * j + 1) * LANES + r] + dx * tangents[g + DXX]
                    d_ln_alpha = polynomial[2 * j * LANES + r] + dx * slope
                    d_t = load(state, i)
                    d_w = moves * d_ln_alpha + al * d_t  # w = α·T
                    store(state, i, d_t - d_w)
                    for c in range(channel_count):
                        i += AREA
                        store(state, i, load(state, i) + d_w * batch[s + COLORS + c] + w * tangents[g + G_COLORS + c])
        if time_to_look(group):
            alive = still_alive(state, at, alive)
            if alive == 0:
                break
    return alive


@kernel()
def _blend_tile_tangents(
    start, end, entries, splats, tangents, left, top, side, channels, directions, image, alpha, d_image, d_alpha
):
    channel_count, ways = len(channels), len(directions)
    each = (1 + channel_count) * AREA
    planes = each * (1 + ways)
    down, across = patches_of(side, top, left, alpha.shape)
    state, alive = aligned(down * across * planes), np.empty(down * across, np.int64)
    batch, boxes, rows = aligned(BATCH * SPLAT), aligned(4 * BATCH), aligned(2 * LANES)
    polynomial = aligned(2 * ways * LANES)
    state[:] = F(0)
    for p in range(down * across):
        fill(state, p * planes, F(1))
        alive[p] = (1 << min(PATCH, alpha.shape[0] - top - p // across * PATCH)) - 1
    first, living = start, down * across
    while first < end and living > 0:
        count, living = min(BATCH, end - first), 0
        load_batch(entries, first, count, splats, F(left), F(top), batch, boxes)
        for p in range(down * across):
            if alive[p] != 0:
                x, y = F(p % across * PATCH), F(p // across * PATCH)
                which = (batch, boxes, count, x, y, channels, directions, entries, first, tangents)
                alive[p] = _blend_patch_tangents(*which, state, p * planes, alive[p], rows, polynomial)
                living += 1 if alive[p] != 0 else 0
        first += count
    for p in range(down * across):
        at, patch_top, patch_left = p * planes, top + p // across * PATCH, left + p % across * PATCH
        place_alpha(state, at, patch_top, patch_left, alpha)
        for c in range(channel_count):
            place(state, at + (1 + c) * AREA, F(1), patch_top, patch_left, image, c)
        for j in range(ways):
            at += each
            place(state, at, F(-1), patch_top, patch_left, d_alpha, j)
            for c in range(channel_count):
                place(state, at + (1 + c) * AREA, F(1), patch_top, patch_left, d_image, j * channel_count + c)


@kernel(parallel=True)
def blend_tangents(lists, tangents, channels, directions, image, alpha, d_image, d_alpha):
    """`blend`, and its tangents `d_image` `[H, W, K·C]`, `d_alpha` `[H, W, K]`.

    Args:
        tangents: `[N · K · (6 + C)]`, of each splat in each direction (see `layout`).
        channels, directions: tuples of length C and K.
    """
    tile_order, threads, tile_starts, entries, splats, side = lists
    across = (image.shape[1] + side - 1) // side
    taken = np.zeros(1, np.int64)
    for _thread in nb.prange(threads):
        for _ in range(len(tile_order)):
            n = take_next(taken)
            if n >= len(tile_order):
                break
            tile = tile_order[n]
            left, top = tile % across * side, tile // across * side
            start, end = tile_starts[tile], tile_starts[tile + 1]
            its_list = (start, end, entries, splats, tangents, left, top, side, channels, directions)
            _blend_tile_tangents(*its_list, image, alpha, d_image, d_alpha)
