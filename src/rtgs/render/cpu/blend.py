"""Composite splats front to back within 16×16 tiles, forwards, backwards and sideways. One loop iteration is one tile.

A tile's state lives in a few kilobytes that stay in L1, and a row of it is one register (`simd.Lanes`). For each splat one register
holds all sixteen rows and tells which of them it reaches; only those are visited, and none whose pixels are all finished. The
reverse kernels also run front to back: what remains of the pixel's colour is a running difference, so no per-pixel lists are kept.

A finished pixel (Eq. of 3DGS: the next splat would leave less than 1e-4 of the light) keeps its transmittance with a minus sign: it
then fails the same comparison for ever after.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from rtgs.render.cpu.channels import add_scaled, no_lanes, weighted_sum
from rtgs.render.cpu.layout import (
    COLORS,
    DX,
    DXX,
    DXY,
    DY,
    DYY,
    ETA,
    G_COLORS,
    KAPPA,
    LOG2_ALPHA_MIN,
    LOG2_OPACITY,
    ONE,
    SLANT,
    SPLAT,
    TILE,
    X_LOW,
    Y_LOW,
    X,
    Y,
)
from rtgs.render.cpu.projection import slot_width
from rtgs.render.cpu.simd import (
    any_lane,
    exp2_below_one,
    lane_numbers,
    lanes_of,
    load,
    lowest_bit,
    mask_bits,
    maximum,
    minimum,
    negative_magnitude,
    prefetch,
    store,
    total,
    where,
)
from rtgs.render.settings import ALPHA_MAX, TRANSMITTANCE_MIN

F = np.float32
_AREA = TILE * TILE
_LOOK_EVERY = 15  # after every 16th splat finished rows are looked for
_AHEAD = 6  # splats fetched before they are needed; lists are padded by as many


@nb.njit(inline="always")
def _planes(n):
    """`n` planes of a tile, `[n · 256]` float32 on a cache line's boundary."""
    raw = np.empty(n * _AREA + 16, np.float32)
    skip = (-raw.ctypes.data % 64) // 4
    return raw[skip : skip + n * _AREA]


@nb.njit(inline="always")
def _fill(state, plane, value):
    for r in range(TILE):
        store(state, plane * _AREA + r * TILE, lanes_of(value))


@nb.njit(inline="always")
def _fetch(source, q, top, left, state, plane):
    """Channel `q` of `[H, W, C]` into a plane; zero beyond the picture."""
    _fill(state, plane, F(0))
    for r in range(min(TILE, source.shape[0] - top)):
        for i in range(min(TILE, source.shape[1] - left)):
            state[plane * _AREA + r * TILE + i] = source[top + r, left + i, q]


@nb.njit(inline="always")
def _place(state, plane, sign, top, left, out, q):
    """A plane, times `sign`, into channel `q` of `[H, W, C]`."""
    for r in range(min(TILE, out.shape[0] - top)):
        for i in range(min(TILE, out.shape[1] - left)):
            out[top + r, left + i, q] = sign * state[plane * _AREA + r * TILE + i]


@nb.njit(inline="always")
def _rows_reached(splats, s, x, y, alive, rows):
    """Which rows of the tile the splat reaches, as bits; `rows` gets each row's middle and q there.

    `x`, `y`: the centre from the tile's corner.
    """
    dy = lane_numbers() + F(0.5) - y
    middle = x + dy * splats[s + SLANT]
    q = splats[s + LOG2_OPACITY] - dy * dy * splats[s + KAPPA]
    store(rows, 0, middle)
    store(rows, TILE, q)
    beyond = maximum(maximum(F(0.5) - middle, middle - F(TILE - 0.5)), F(0))
    return mask_bits(q - beyond * beyond * splats[s + ETA] >= F(LOG2_ALPHA_MIN)) & alive


@nb.njit(inline="always")
def _opacity(rows, r, eta):
    """α at the sixteen pixels of row `r`; zero where it is under 1/255."""
    d = lane_numbers() + F(0.5) - rows[r]
    q = rows[TILE + r] - d * d * eta
    return where(q >= F(LOG2_ALPHA_MIN), minimum(exp2_below_one(q), F(ALPHA_MAX)), F(0))


@nb.njit(inline="always")
def _still_alive(state, alive):
    """`alive` without the rows whose pixels are all finished; plane 0 is the transmittance."""
    for r in range(TILE):
        if (alive >> r) & 1 and not any_lane(load(state, r * TILE) > F(0)):
            alive &= ~(1 << r)
    return alive


@nb.njit(cache=True, error_model="numpy")
def _blend_tile(start, end, entries, splats, left, top, channels, image, alpha):
    """Returns how many list entries the tile needed. Planes: transmittance, C colours."""
    state, rows = _planes(1 + len(channels)), _planes(1)
    _fill(state, 0, F(1))
    for c in range(len(channels)):
        _fill(state, 1 + c, F(0))
    alive = (1 << min(TILE, image.shape[0] - top)) - 1
    for k in range(start, end):
        if ((k - start) & _LOOK_EVERY) == _LOOK_EVERY:
            alive = _still_alive(state, alive)
            if alive == 0:
                end = k
                break
        prefetch(splats, SPLAT * entries[k + _AHEAD])
        s = SPLAT * entries[k]
        x, y = (splats[s + X] - F(left)) + splats[s + X_LOW], (splats[s + Y] - F(top)) + splats[s + Y_LOW]
        reached, eta = _rows_reached(splats, s, x, y, alive, rows), splats[s + ETA]
        while reached != 0:
            r = lowest_bit(reached)
            reached &= reached - 1
            al, t = _opacity(rows, r, eta), load(state, r * TILE)
            w = al * t
            after = t - w
            is_open = after > F(TRANSMITTANCE_MIN)
            w = where(is_open, w, F(0))
            store(state, r * TILE, where(is_open, after, negative_magnitude(t)))
            for c in range(len(channels)):
                i = (1 + c) * _AREA + r * TILE
                store(state, i, load(state, i) + w * splats[s + COLORS + c])
    for r in range(min(TILE, image.shape[0] - top)):
        for i in range(min(TILE, image.shape[1] - left)):
            alpha[top + r, left + i] = F(1) - abs(state[r * TILE + i])
    for c in range(len(channels)):
        _place(state, 1 + c, F(1), top, left, image, c)
    return end - start


@nb.njit(parallel=True, cache=True, error_model="numpy")
def blend(tile_order, tile_starts, entries, splats, channels, image, alpha, used):
    """Fill `image` `[H, W, C]`, `alpha` `[H, W]` and `used` `[T]`, how many of its list entries a tile needed.

    `channels` is a tuple of length C: its type carries C into the compiled code.
    """
    tiles_x = (image.shape[1] + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        used[tile] = _blend_tile(
            tile_starts[tile],
            tile_starts[tile + 1],
            entries,
            splats,
            (tile % tiles_x) * TILE,
            (tile // tiles_x) * TILE,
            channels,
            image,
            alpha,
        )


@nb.njit(cache=True, error_model="numpy")
def _blend_tile_backward(start, end, entries, splats, left, top, channels, image, alpha, g_image, g_alpha, slot, slot_grads):
    """Planes: transmittance, what remains of ∂L·colour, C + 1 image gradients (alpha last)."""
    count = len(channels)
    state, rows = _planes(3 + count), _planes(1)
    _fill(state, 0, F(1))
    for c in range(count):
        _fetch(g_image, c, top, left, state, 2 + c)
    _fetch(g_alpha, 0, top, left, state, 2 + count)
    _fill(state, 1, F(0))
    for r in range(min(TILE, image.shape[0] - top)):
        for i in range(min(TILE, image.shape[1] - left)):
            at = r * TILE + i
            remains = state[(2 + count) * _AREA + at] * alpha[top + r, left + i]
            for c in range(count):
                remains += state[(2 + c) * _AREA + at] * image[top + r, left + i, c]
            state[_AREA + at] = remains
    alive = (1 << min(TILE, image.shape[0] - top)) - 1
    for k in range(start, end):
        if ((k - start) & _LOOK_EVERY) == _LOOK_EVERY:
            alive = _still_alive(state, alive)
        prefetch(splats, SPLAT * entries[k + _AHEAD])
        s = SPLAT * entries[k]
        x, y = (splats[s + X] - F(left)) + splats[s + X_LOW], (splats[s + Y] - F(top)) + splats[s + Y_LOW]
        reached, eta = _rows_reached(splats, s, x, y, alive, rows), splats[s + ETA]
        colors = no_lanes(channels)
        m0, m1, m2 = lanes_of(F(0)), lanes_of(F(0)), lanes_of(F(0))
        while reached != 0:
            r = lowest_bit(reached)
            reached &= reached - 1
            al, t = _opacity(rows, r, eta), load(state, r * TILE)
            w = al * t
            after = t - w
            is_open = after > F(TRANSMITTANCE_MIN)
            w = where(is_open, w, F(0))
            store(state, r * TILE, where(is_open, after, negative_magnitude(t)))
            planes = 2 * _AREA + r * TILE
            here = weighted_sum(channels, load(state, planes + count * _AREA), state, planes, _AREA, splats, s + COLORS)
            remains = load(state, _AREA + r * TILE) - w * here
            store(state, _AREA + r * TILE, remains)
            colors = add_scaled(colors, w, state, planes, _AREA)
            # E = α·∂L/∂α; a held α does not move.
            e = al * (t * here - remains / (F(1) - al))
            e = where(is_open & (al < F(ALPHA_MAX)), e, F(0))
            dy = F(r) + F(0.5) - y
            m0 = m0 + e
            m1 = m1 + e * dy
            m2 = m2 + e * (dy * dy)
        # dx is the same in every row: the moments in x are taken once, of the column sums.
        dx = lane_numbers() + F(0.5) - x
        row = slot_grads[(slot + k - start) * slot_width(G_COLORS + count) :]
        m0x = m0 * dx
        row[ONE], row[DX], row[DXX] = total(m0), total(m0x), total(m0x * dx)
        row[DY], row[DXY], row[DYY] = total(m1), total(m1 * dx), total(m2)
        for c in range(count):
            row[G_COLORS + c] = total(colors[c])


@nb.njit(parallel=True, cache=True, error_model="numpy")
def blend_backward(
    tile_order, tile_starts, entries, splats, channels, image, alpha, used, g_image, g_alpha, slot_starts, slot_grads
):
    """Fill `slot_grads`, rows of `slot_width(6 + C)`: the gradient of each list entry that was used, from its own tile.

    Args:
        g_image: `[H, W, C]`. g_alpha: `[H, W, 1]`.
        slot_starts: `[T]`, where each tile's entries begin in `slot_grads`.
    """
    tiles_x = (image.shape[1] + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        _blend_tile_backward(
            tile_starts[tile],
            tile_starts[tile] + used[tile],
            entries,
            splats,
            (tile % tiles_x) * TILE,
            (tile // tiles_x) * TILE,
            channels,
            image,
            alpha,
            g_image,
            g_alpha,
            slot_starts[tile],
            slot_grads,
        )


@nb.njit(cache=True, error_model="numpy")
def _blend_tile_adjoint(start, end, entries, splats, left, top, channels, g_image, slot, slot_grads):
    """Planes: transmittance, C image gradients."""
    count = len(channels)
    state, rows = _planes(1 + count), _planes(1)
    _fill(state, 0, F(1))
    for c in range(count):
        _fetch(g_image, c, top, left, state, 1 + c)
    alive = (1 << min(TILE, g_image.shape[0] - top)) - 1
    for k in range(start, end):
        if ((k - start) & _LOOK_EVERY) == _LOOK_EVERY:
            alive = _still_alive(state, alive)
        prefetch(splats, SPLAT * entries[k + _AHEAD])
        s = SPLAT * entries[k]
        x, y = (splats[s + X] - F(left)) + splats[s + X_LOW], (splats[s + Y] - F(top)) + splats[s + Y_LOW]
        reached, eta = _rows_reached(splats, s, x, y, alive, rows), splats[s + ETA]
        colors = no_lanes(channels)
        while reached != 0:
            r = lowest_bit(reached)
            reached &= reached - 1
            t = load(state, r * TILE)
            w = _opacity(rows, r, eta) * t
            after = t - w
            is_open = after > F(TRANSMITTANCE_MIN)
            store(state, r * TILE, where(is_open, after, negative_magnitude(t)))
            colors = add_scaled(colors, where(is_open, w, F(0)), state, _AREA + r * TILE, _AREA)
        row = slot_grads[(slot + k - start) * slot_width(count) :]
        for c in range(count):
            row[c] = total(colors[c])


@nb.njit(parallel=True, cache=True, error_model="numpy")
def blend_adjoint(tile_order, tile_starts, entries, splats, channels, used, g_image, slot_starts, slot_grads):
    """Fill `slot_grads`, rows of `slot_width(C)`, with the colours' gradients alone: the transpose of `blend` as a linear map of the colours."""
    tiles_x = (g_image.shape[1] + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        _blend_tile_adjoint(
            tile_starts[tile],
            tile_starts[tile] + used[tile],
            entries,
            splats,
            (tile % tiles_x) * TILE,
            (tile // tiles_x) * TILE,
            channels,
            g_image,
            slot_starts[tile],
            slot_grads,
        )


@nb.njit(cache=True, error_model="numpy")
def _blend_tile_tangents(start, end, entries, splats, tangents, left, top, channels, directions, image, alpha, d_image, d_alpha):
    """Planes: transmittance, C colours; then for each direction their tangents. Returns how many list entries the tile needed."""
    count, ways = len(channels), len(directions)
    width = 1 + count
    state, rows, polynomial = _planes(width * (1 + ways)), _planes(1), _planes(1)
    for plane in range(width * (1 + ways)):
        _fill(state, plane, F(0))
    _fill(state, 0, F(1))
    alive = (1 << min(TILE, image.shape[0] - top)) - 1
    for k in range(start, end):
        if ((k - start) & _LOOK_EVERY) == _LOOK_EVERY:
            alive = _still_alive(state, alive)
            if alive == 0:
                end = k
                break
        prefetch(splats, SPLAT * entries[k + _AHEAD])
        s = SPLAT * entries[k]
        x, y = (splats[s + X] - F(left)) + splats[s + X_LOW], (splats[s + Y] - F(top)) + splats[s + Y_LOW]
        reached, eta = _rows_reached(splats, s, x, y, alive, rows), splats[s + ETA]
        if reached == 0:
            continue
        first = entries[k] * ways * (G_COLORS + count)
        dy = lane_numbers() + F(0.5) - y
        for j in range(ways):
            at = first + j * (G_COLORS + count)
            store(polynomial, 2 * j * TILE, tangents[at + ONE] + dy * (tangents[at + DY] + dy * tangents[at + DYY]))
            store(polynomial, (2 * j + 1) * TILE, tangents[at + DX] + dy * tangents[at + DXY])
        dx = lane_numbers() + F(0.5) - x
        while reached != 0:
            r = lowest_bit(reached)
            reached &= reached - 1
            al, t = _opacity(rows, r, eta), load(state, r * TILE)
            w = al * t
            after = t - w
            is_open = after > F(TRANSMITTANCE_MIN)
            w = where(is_open, w, F(0))
            store(state, r * TILE, where(is_open, after, negative_magnitude(t)))
            for c in range(count):
                i = (1 + c) * _AREA + r * TILE
                store(state, i, load(state, i) + w * splats[s + COLORS + c])
            moves = where(al < F(ALPHA_MAX), w, F(0))  # a held α does not move
            al = where(is_open, al, F(0))
            for j in range(ways):
                at, planes = first + j * (G_COLORS + count), (1 + j) * width * _AREA + r * TILE
                d_ln_alpha = polynomial[2 * j * TILE + r] + dx * (polynomial[(2 * j + 1) * TILE + r] + dx * tangents[at + DXX])
                d_t = load(state, planes)
                d_w = moves * d_ln_alpha + al * d_t  # w = α·T
                store(state, planes, d_t - d_w)
                for c in range(count):
                    i = planes + (1 + c) * _AREA
                    store(state, i, load(state, i) + d_w * splats[s + COLORS + c] + w * tangents[at + G_COLORS + c])
    for r in range(min(TILE, image.shape[0] - top)):
        for i in range(min(TILE, image.shape[1] - left)):
            alpha[top + r, left + i] = F(1) - abs(state[r * TILE + i])
    for c in range(count):
        _place(state, 1 + c, F(1), top, left, image, c)
    for j in range(ways):
        _place(state, (1 + j) * width, F(-1), top, left, d_alpha, j)
        for c in range(count):
            _place(state, (1 + j) * width + 1 + c, F(1), top, left, d_image, j * count + c)
    return end - start


@nb.njit(parallel=True, cache=True, error_model="numpy")
def blend_tangents(tile_order, tile_starts, entries, splats, tangents, channels, directions, image, alpha, d_image, d_alpha):
    """`blend`, and its tangents `d_image` `[H, W, K·C]`, `d_alpha` `[H, W, K]`.

    Args:
        tangents: `[N · K · (6 + C)]`, of each splat in each direction (see `layout`).
        channels, directions: tuples of length C and K.
    """
    tiles_x = (image.shape[1] + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        _blend_tile_tangents(
            tile_starts[tile],
            tile_starts[tile + 1],
            entries,
            splats,
            tangents,
            (tile % tiles_x) * TILE,
            (tile // tiles_x) * TILE,
            channels,
            directions,
            image,
            alpha,
            d_image,
            d_alpha,
        )
