"""Composite splats front to back within 16×16 tiles, and the reverse-mode twin. One loop iteration is one tile.

A tile's state lives in small arrays that stay in L1, the inner loop is one pixel row of fixed length that LLVM turns into vectors,
and the arithmetic is float32. The backward pass also runs front to back: what remains of the pixel's colour is a running difference,
so no per-pixel lists are kept.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from rtgs.render.cpu.channels import add_color, add_color_gradient, colors_of, dot_gradient
from rtgs.render.cpu.projection import (
    CONIC_A,
    CONIC_B,
    CONIC_C,
    G_A,
    G_B,
    G_C,
    G_COLORS,
    G_OPACITY,
    G_X,
    G_Y,
    HALF_HEIGHT,
    OPACITY,
    REACH,
    TILE,
    X,
    Y,
)
from rtgs.render.settings import ALPHA_MAX, TRANSMITTANCE_MIN

F = np.float32
_ALPHA_MAX, _T_MIN = F(ALPHA_MAX), F(TRANSMITTANCE_MIN)
_ZERO, _HALF, _ONE = F(0), F(0.5), F(1)
_LOG2E = F(-1.4426950408889634)
# 2^f on [−1, 0], Chebyshev interpolation of degree 5: relative error 1e-7.
_P0, _P1, _P2, _P3, _P4, _P5 = (
    F(0.9999999438867423),
    F(0.6931431346410901),
    F(0.24017895627750366),
    F(0.05529811967606631),
    F(0.009209180356949767),
    F(0.0009468770290273673),
)


@nb.njit(fastmath=True, inline="always")
def _exp_minus(s):
    """exp(−s) for 0 ≤ s ≤ 20: the power of two goes straight into the exponent's bits."""
    t = s * _LOG2E
    n = np.int32(t)
    f = t - F(n)
    p = ((((_P5 * f + _P4) * f + _P3) * f + _P2) * f + _P1) * f + _P0
    return p * np.int32((n + np.int32(127)) << np.int32(23)).view(np.float32)


@nb.njit(inline="always")
def _rows(s, top):
    """Rows of the tile, counted from `top`, that the splat's bounding box covers."""
    first = max(0, math.ceil(s[Y] - s[HALF_HEIGHT] - top - _HALF))
    last = min(TILE, math.floor(s[Y] + s[HALF_HEIGHT] - top - _HALF) + 1)
    return first, last


@nb.njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def blend(tile_order, tile_starts, ranks, packed, width, height, channels, image, alpha, spent):
    """Fill `image` `[H, W, C]`, `alpha` `[H, W]` and `spent` `[T]` (one past the last list entry that a tile needed).

    `channels` is a tuple of length C: its type carries C into the compiled code.
    """
    tiles_x = (width + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        first_x = F(left) + _HALF
        transmittance = np.ones((TILE, TILE), np.float32)
        alive = np.ones((TILE, TILE), np.float32)
        color = np.zeros((len(channels), TILE, TILE), np.float32)
        end = tile_starts[tile + 1]
        for k in range(tile_starts[tile], end):
            if ((k - tile_starts[tile]) & 15) == 15 and alive.sum() == _ZERO:
                end = k
                break
            s = packed[ranks[k]]
            x, y, a, b, c, o, reach = s[X], s[Y], s[CONIC_A], s[CONIC_B], s[CONIC_C], s[OPACITY], s[REACH]
            values = colors_of(s, channels)
            first, last = _rows(s, F(top))
            for r in range(first, last):
                dy = y - (F(top + r) + _HALF)
                row_term, cross = _HALF * c * dy * dy, b * dy
                for i in range(TILE):
                    dx = x - (first_x + F(i))
                    power = _HALF * a * dx * dx + row_term + cross * dx
                    inside = (power <= reach) & (power >= _ZERO) & (alive[r, i] > _ZERO)
                    al = min(_ALPHA_MAX, o * _exp_minus(power if inside else _ZERO))
                    al = al if inside else _ZERO
                    t = transmittance[r, i]
                    open_ = t * (_ONE - al) > _T_MIN
                    alive[r, i] = alive[r, i] if open_ else _ZERO
                    w = al * t if open_ else _ZERO
                    transmittance[r, i] = t - w
                    add_color(color, r, i, w, values)
        spent[tile] = end
        for r in range(min(TILE, height - top)):
            for i in range(min(TILE, width - left)):
                alpha[top + r, left + i] = _ONE - transmittance[r, i]
                for q in range(len(channels)):
                    image[top + r, left + i, q] = color[q, r, i]


@nb.njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def blend_backward(
    tile_order, tile_starts, ranks, packed, width, height, channels, image, alpha, spent, g_image, g_alpha, geometry, slot_grads
):
    """Fill `slot_grads` `[S, 6 + C]`, zero on entry: each list entry's gradient from its own tile.

    `geometry` False fills the colour columns only.
    """
    tiles_x = (width + TILE - 1) // TILE
    for n in nb.prange(len(tile_order)):
        tile = tile_order[n]
        left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        first_x = F(left) + _HALF
        transmittance = np.ones((TILE, TILE), np.float32)
        alive = np.ones((TILE, TILE), np.float32)
        remaining = np.zeros((TILE, TILE), np.float32)
        grad = np.zeros((len(channels) + 1, TILE, TILE), np.float32)
        lanes = np.empty((6, TILE), np.float32)
        color_lanes = np.empty((len(channels), TILE), np.float32)
        for r in range(min(TILE, height - top)):
            for i in range(min(TILE, width - left)):
                grad[len(channels), r, i] = g_alpha[top + r, left + i]
                remaining[r, i] = g_alpha[top + r, left + i] * alpha[top + r, left + i]
                for q in range(len(channels)):
                    grad[q, r, i] = g_image[top + r, left + i, q]
                    remaining[r, i] += grad[q, r, i] * image[top + r, left + i, q]
        for k in range(tile_starts[tile], spent[tile]):
            s = packed[ranks[k]]
            x, y, a, b, c, o, reach = s[X], s[Y], s[CONIC_A], s[CONIC_B], s[CONIC_C], s[OPACITY], s[REACH]
            values = colors_of(s, channels)
            first, last = _rows(s, F(top))
            lanes[:] = _ZERO
            color_lanes[:] = _ZERO
            for r in range(first, last):
                dy = y - (F(top + r) + _HALF)
                row_term, cross = _HALF * c * dy * dy, b * dy
                for i in range(TILE):
                    dx = x - (first_x + F(i))
                    power = _HALF * a * dx * dx + row_term + cross * dx
                    inside = (power <= reach) & (power >= _ZERO) & (alive[r, i] > _ZERO)
                    falloff = _exp_minus(power if inside else _ZERO)
                    raw = o * falloff
                    al = min(_ALPHA_MAX, raw)
                    al = al if inside else _ZERO
                    t = transmittance[r, i]
                    through = _ONE - al
                    open_ = t * through > _T_MIN
                    alive[r, i] = alive[r, i] if open_ else _ZERO
                    w = al * t if open_ else _ZERO
                    add_color_gradient(color_lanes, i, w, grad, r, channels)
                    if geometry:
                        here = dot_gradient(grad, r, i, values)
                        left_over = remaining[r, i] - w * here
                        remaining[r, i] = left_over
                        d_alpha = t * here - left_over / through
                        d_alpha = d_alpha if (inside & open_ & (raw <= _ALPHA_MAX)) else _ZERO
                        d_opacity = d_alpha * falloff
                        d_power = -o * d_opacity
                        lanes[0, i] += d_power * dx
                        lanes[1, i] += d_power * dy
                        lanes[2, i] += d_power * dx * dx
                        lanes[3, i] += d_power * dx * dy
                        lanes[4, i] += d_power * dy * dy
                        lanes[5, i] += d_opacity
                    transmittance[r, i] = t - w
            out = slot_grads[k]
            for q in range(len(channels)):
                out[G_COLORS + q] = color_lanes[q].sum()
            if geometry:
                s0, s1 = lanes[0].sum(), lanes[1].sum()
                out[G_X] = a * s0 + b * s1
                out[G_Y] = b * s0 + c * s1
                out[G_A] = _HALF * lanes[2].sum()
                out[G_B] = lanes[3].sum()
                out[G_C] = _HALF * lanes[4].sum()
                out[G_OPACITY] = lanes[5].sum()
