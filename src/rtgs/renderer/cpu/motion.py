"""What the motion of a camera does to splats: forward mode, for a few directions at once.

Differentiates `projection.project` along `(ω, v, fl_x′, fl_y′, cx′, cy′)`: a camera-frame twist (camera points move by ω × p + v) and
changes of the intrinsics. Letters as in `projection`; a prime is the derivative. With Σ′ that of the covariance and ċ that of the
centre, ∂ln α at d = pixel − centre is dᵀ·Q·ċ + ½·dᵀ·Q·Σ′·Q·d, and when anti-aliased the derivative of ln fade.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from rtgs.base.compiled import inlined, kernel
from rtgs.renderer.cpu.layout import CHUNKS, DX, DXX, DXY, DY, DYY, G_COLORS, ONE
from rtgs.renderer.cpu.projection import (
    INPUTS,
    camera_point,
    camera_square_root,
    covariance,
    gather,
    held,
    image_square_root,
    plane,
    wide,
)
from rtgs.renderer.cpu.simd import LANES, lanes_of, magnitude, maximum, narrow, store, where
from rtgs.renderer.settings import COVARIANCE_BLUR_PX2

F = np.float32
_BLUR = COVARIANCE_BLUR_PX2


@inlined
def _held_slope(slope, held_slope, moving, centre_rate, focal_rate, focal):
    """Derivative of a held x/z: its own within the view, the bound's (it depends on the intrinsics) outside."""
    return where(magnitude(held_slope - slope) <= 0.0, moving, -(centre_rate + held_slope * focal_rate) / focal)


@kernel()
def _move_group(group, rotation, translation, intrinsics, size, antialiased, directions, scratch, out):
    """Fill `out` `[K · 7 · 16]`: for each direction the polynomial of ∂ln α (see `layout`) and z′."""
    wide_x, wide_y, wide_z = camera_point(group, rotation, translation)
    x, y, z = narrow(wide_x), narrow(wide_y), narrow(wide_z)
    m, v, u = scratch[: 9 * LANES], scratch[9 * LANES : 18 * LANES], scratch[18 * LANES : 24 * LANES]
    moved = scratch[24 * LANES : 30 * LANES]
    camera_square_root(group, rotation, m, v)
    slope_x, slope_y = x / z, y / z
    sx, sy = held(slope_x, intrinsics[2], intrinsics[0], size[0]), held(slope_y, intrinsics[3], intrinsics[1], size[1])
    jx, jy = intrinsics[0] / z, intrinsics[1] / z
    image_square_root(v, jx, jy, sx, sy, u)
    a, b, c, det_sharp = covariance(u)
    inverse = 1.0 / (det_sharp + _BLUR * (a + c) + _BLUR * _BLUR)
    q00, q01, q11 = (c + _BLUR) * inverse, -b * inverse, (a + _BLUR) * inverse
    for k in range(len(directions)):
        way = directions[k]
        x1 = way[1] * z - way[2] * y + way[3]
        y1 = way[2] * x - way[0] * z + way[4]
        z1 = way[0] * y - way[1] * x + way[5]
        slope_x1, slope_y1 = (x1 - slope_x * z1) / z, (y1 - slope_y * z1) / z
        centre_x = intrinsics[0] * slope_x1 + way[6] * slope_x + way[8]
        centre_y = intrinsics[1] * slope_y1 + way[7] * slope_y + way[9]
        sx1 = _held_slope(slope_x, sx, slope_x1, way[8], way[6], intrinsics[0])
        sy1 = _held_slope(slope_y, sy, slope_y1, way[9], way[7], intrinsics[1])
        jx1, jy1 = (way[6] - jx * z1) / z, (way[7] - jy * z1) / z
        for j in range(3):
            v0, v1, v2 = plane(v, j), plane(v, 3 + j), plane(v, 6 + j)
            v0_1, v1_1, v2_1 = way[1] * v2 - way[2] * v1, way[2] * v0 - way[0] * v2, way[0] * v1 - way[1] * v0
            store(moved, j * LANES, jx1 * (v0 - sx * v2) + jx * (v0_1 - sx1 * v2 - sx * v2_1))
            store(moved, (3 + j) * LANES, jy1 * (v1 - sy * v2) + jy * (v1_1 - sy1 * v2 - sy * v2_1))
        x0, x1_, x2, y0, y1_, y2 = wide(u, 0), wide(u, 1), wide(u, 2), wide(u, 3), wide(u, 4), wide(u, 5)
        a1 = 2.0 * (x0 * wide(moved, 0) + x1_ * wide(moved, 1) + x2 * wide(moved, 2))
        c1 = 2.0 * (y0 * wide(moved, 3) + y1_ * wide(moved, 4) + y2 * wide(moved, 5))
        b1 = x0 * wide(moved, 3) + x1_ * wide(moved, 4) + x2 * wide(moved, 5)
        b1 = b1 + y0 * wide(moved, 0) + y1_ * wide(moved, 1) + y2 * wide(moved, 2)
        p00, p01, p10, p11 = q00 * a1 + q01 * b1, q00 * b1 + q01 * c1, q01 * a1 + q11 * b1, q01 * b1 + q11 * c1
        at = k * (G_COLORS + 1) * LANES
        fade = lanes_of(F(0))
        if antialiased:
            rate = (c * a1 - 2.0 * (b * b1) + a * c1) / maximum(det_sharp, 1e-300) - (q00 * a1 + 2.0 * (q01 * b1) + q11 * c1)
            fade = narrow(where(det_sharp * inverse > 1e-12, 0.5 * rate, 0.0))
        store(out, at + ONE * LANES, fade)
        store(out, at + DX * LANES, narrow(q00) * centre_x + narrow(q01) * centre_y)
        store(out, at + DY * LANES, narrow(q01) * centre_x + narrow(q11) * centre_y)
        store(out, at + DXX * LANES, narrow(0.5 * (p00 * q00 + p01 * q01)))
        store(out, at + DXY * LANES, narrow(p00 * q01 + p01 * q11))
        store(out, at + DYY * LANES, narrow(0.5 * (p10 * q01 + p11 * q11)))
        store(out, at + G_COLORS * LANES, z1)


@kernel(parallel=True)
def move(model, view, antialiased, tiles, directions, color_slopes, centre_rates, with_depth, tangents):
    """Fill `tangents` `[N · K · (6 + C)]` for visible Gaussians (`tiles` > 0).

    Args:
        directions: `[K, 10]`.
        color_slopes: `[N, C, 3]`, ∂colour/∂camera centre; without the depth channel.
        centre_rates: `[K, 3]`, how the camera's centre moves in the world.
        with_depth: the last of the C colours is z.
    """
    means, quats, log_scales, opacity_logits = model
    rotation, translation, intrinsics, size = view
    n, ways, colors = len(means), len(directions), color_slopes.shape[1]
    width = G_COLORS + colors + (1 if with_depth else 0)
    nothing = np.empty((0, 2), np.float32)
    for chunk in nb.prange(CHUNKS):
        group, scratch = np.zeros(INPUTS * LANES, np.float32), np.empty(30 * LANES, np.float32)
        out, chosen, count = np.empty(ways * (G_COLORS + 1) * LANES, np.float32), np.empty(LANES, np.int64), 0
        stop = (chunk + 1) * n // CHUNKS
        for i in range(chunk * n // CHUNKS, stop):
            if tiles[i] > 0:
                gather(count, i, means, quats, log_scales, opacity_logits, nothing, group)
                chosen[count] = i
                count += 1
            if count == LANES or (i == stop - 1 and count > 0):
                for lane in range(count, LANES):
                    gather(lane, chosen[count - 1], means, quats, log_scales, opacity_logits, nothing, group)
                _move_group(group, rotation, translation, intrinsics, size, antialiased, directions, scratch, out)
                for lane in range(count):
                    for k in range(ways):
                        to, source = (chosen[lane] * ways + k) * width, k * (G_COLORS + 1) * LANES + lane
                        for q in range(G_COLORS):
                            tangents[to + q] = out[source + q * LANES]
                        for c in range(colors):
                            slope = color_slopes[chosen[lane], c]
                            rate = slope[0] * centre_rates[k, 0] + slope[1] * centre_rates[k, 1] + slope[2] * centre_rates[k, 2]
                            tangents[to + G_COLORS + c] = rate
                        if with_depth:
                            tangents[to + G_COLORS + colors] = out[source + G_COLORS * LANES]
                count = 0
