"""Colours from spherical harmonics, and their gradients.

Directions and basis functions are computed for sixteen Gaussians at once. A Gaussian's coefficients lie together in memory and are read
once, one after another.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from rtgs.base.compiled import inlined, kernel
from rtgs.maths.sh import C0, C1, C2, C3
from rtgs.renderer.cpu.layout import CHUNKS
from rtgs.renderer.cpu.simd import LANES, lanes_of, load, maximum, narrow, square_root, store, total, widen

F = np.float32


@inlined
def _directions(first, count, means, centre, group):
    """Unit vectors from the camera to sixteen Gaussians, and 1 / distance; a lane beyond `count` repeats the last."""
    for lane in range(LANES):
        i = first + min(lane, count - 1)
        for k in range(3):
            group[k * LANES + lane] = means[i, k]
    x, y, z = (
        narrow(widen(load(group, 0)) - centre[0]),
        narrow(widen(load(group, LANES)) - centre[1]),
        narrow(widen(load(group, 2 * LANES)) - centre[2]),
    )
    inverse = 1.0 / maximum(square_root(x * x + y * y + z * z), 1e-12)
    return x * inverse, y * inverse, z * inverse, inverse


@inlined
def _fill_basis(x, y, z, k, out):
    """The first `k` basis functions (see `rtgs.sh.basis`), a plane of lanes each."""
    store(out, 0, lanes_of(F(C0)))
    if k > 1:
        store(out, 1 * LANES, y * -C1)
        store(out, 2 * LANES, z * C1)
        store(out, 3 * LANES, x * -C1)
    if k > 4:
        xx, yy, zz = x * x, y * y, z * z
        store(out, 4 * LANES, C2[0] * (x * y))
        store(out, 5 * LANES, C2[1] * (y * z))
        store(out, 6 * LANES, C2[2] * (2.0 * zz - xx - yy))
        store(out, 7 * LANES, C2[3] * (x * z))
        store(out, 8 * LANES, C2[4] * (xx - yy))
    if k > 9:
        xx, yy, zz = x * x, y * y, z * z
        store(out, 9 * LANES, C3[0] * (y * (3.0 * xx - yy)))
        store(out, 10 * LANES, C3[1] * (x * y * z))
        store(out, 11 * LANES, C3[2] * (y * (4.0 * zz - xx - yy)))
        store(out, 12 * LANES, C3[3] * (z * (2.0 * zz - 3.0 * xx - 3.0 * yy)))
        store(out, 13 * LANES, C3[4] * (x * (4.0 * zz - xx - yy)))
        store(out, 14 * LANES, C3[5] * (z * (xx - yy)))
        store(out, 15 * LANES, C3[6] * (x * (xx - 3.0 * yy)))


@inlined
def _basis_slope(x, y, z, k, g):
    """Σ_j g_j ∂basis_j/∂(x, y, z), the direction's components taken as free; `g` has a plane of lanes a function."""
    dx, dy, dz = lanes_of(F(0)), lanes_of(F(0)), lanes_of(F(0))
    if k > 1:
        dx, dy, dz = load(g, 3 * LANES) * -C1, load(g, 1 * LANES) * -C1, load(g, 2 * LANES) * C1
    if k > 4:
        g4, g5, g6 = load(g, 4 * LANES) * C2[0], load(g, 5 * LANES) * C2[1], load(g, 6 * LANES) * (2.0 * C2[2])
        g7, g8 = load(g, 7 * LANES) * C2[3], load(g, 8 * LANES) * (2.0 * C2[4])
        dx = dx + g4 * y - g6 * x + g7 * z + g8 * x
        dy = dy + g4 * x + g5 * z - g6 * y - g8 * y
        dz = dz + g5 * y + 2.0 * (g6 * z) + g7 * x
    if k > 9:
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        g9, g10, g11 = load(g, 9 * LANES) * (3.0 * C3[0]), load(g, 10 * LANES) * C3[1], load(g, 11 * LANES) * C3[2]
        g12, g13 = load(g, 12 * LANES) * (3.0 * C3[3]), load(g, 13 * LANES) * C3[4]
        g14, g15 = load(g, 14 * LANES) * C3[5], load(g, 15 * LANES) * (3.0 * C3[6])
        dx = dx + 2.0 * (g9 * xy) + g10 * yz - 2.0 * (g11 * xy) - 2.0 * (g12 * xz)
        dx = dx + g13 * (4.0 * zz - 3.0 * xx - yy) + 2.0 * (g14 * xz) + g15 * (xx - yy)
        dy = dy + g9 * (xx - yy) + g10 * xz + g11 * (4.0 * zz - xx - 3.0 * yy) - 2.0 * (g12 * yz)
        dy = dy - 2.0 * (g13 * xy) - 2.0 * (g14 * yz) - 2.0 * (g15 * xy)
        dz = dz + g10 * xy + 8.0 * (g11 * yz) + g12 * (2.0 * zz - xx - yy) + 8.0 * (g13 * xz) + g14 * (xx - yy)
    return dx, dy, dz


@kernel("fused", parallel=True)
def evaluate(means, sh, centre, colors):
    """Fill `colors` `[N, C]` with max(0, ½ + basis · sh)."""
    n, k, channels = len(means), sh.shape[1], sh.shape[2]
    for chunk in nb.prange(CHUNKS):
        group, basis, sums = np.empty(3 * LANES, np.float32), np.empty(16 * LANES, np.float32), np.empty(channels, np.float32)
        stop = (chunk + 1) * n // CHUNKS
        for first in range(chunk * n // CHUNKS, stop, LANES):
            count = min(LANES, stop - first)
            x, y, z, _ = _directions(first, count, means, centre, group)
            _fill_basis(x, y, z, k, basis)
            for lane in range(count):
                i = first + lane
                if channels == 3:
                    red, green, blue = F(0.5), F(0.5), F(0.5)
                    for j in range(k):
                        b = basis[j * LANES + lane]
                        red += b * sh[i, j, 0]
                        green += b * sh[i, j, 1]
                        blue += b * sh[i, j, 2]
                    colors[i, 0], colors[i, 1], colors[i, 2] = max(red, F(0)), max(green, F(0)), max(blue, F(0))
                    continue
                sums[:] = F(0.5)
                for j in range(k):
                    for q in range(channels):
                        sums[q] += basis[j * LANES + lane] * sh[i, j, q]
                for q in range(channels):
                    colors[i, q] = max(sums[q], F(0))


@kernel("fused", parallel=True)
def evaluate_backward(means, sh, centre, colors, g_colors, directional, g_sh, g_means, g_centre):
    """Fill `g_sh` `[N, K, C]` and, where `directional`, `g_means` `[N, 3]` (zero on entry) and `g_centre` `[CHUNKS, 3]`.

    An empty `g_sh` `[0, K, C]` is not filled: a pose needs no gradient of the model, which is the largest array here.
    """
    n, k, channels, wanted = len(means), sh.shape[1], sh.shape[2], len(g_sh) > 0
    for chunk in nb.prange(CHUNKS):
        group, basis, slopes = np.empty(3 * LANES, np.float32), np.empty(16 * LANES, np.float32), np.empty(16 * LANES, np.float32)
        g = np.empty(channels, np.float32)
        at_x, at_y, at_z = 0.0, 0.0, 0.0
        stop = (chunk + 1) * n // CHUNKS
        for first in range(chunk * n // CHUNKS, stop, LANES):
            count = min(LANES, stop - first)
            x, y, z, inverse = _directions(first, count, means, centre, group)
            if wanted:
                _fill_basis(x, y, z, k, basis)
            slopes[:] = F(0)
            touched = False
            for lane in range(count):
                i = first + lane
                used = False
                for q in range(channels):
                    g[q] = g_colors[i, q] if colors[i, q] > F(0) else F(0)
                    used = used or g[q] != F(0)
                if not used:
                    if wanted:
                        g_sh[i] = F(0)
                    continue
                touched = True
                if wanted:
                    for j in range(k):
                        for q in range(channels):
                            g_sh[i, j, q] = basis[j * LANES + lane] * g[q]
                if directional:
                    for j in range(1, k):
                        along = F(0)
                        for q in range(channels):
                            along += g[q] * sh[i, j, q]
                        slopes[j * LANES + lane] = along
            if directional and touched and k > 1:
                dx, dy, dz = _basis_slope(x, y, z, k, slopes)
                radial = dx * x + dy * y + dz * z
                dx, dy, dz = (dx - radial * x) * inverse, (dy - radial * y) * inverse, (dz - radial * z) * inverse
                at_x, at_y, at_z = at_x - total(widen(dx)), at_y - total(widen(dy)), at_z - total(widen(dz))
                store(group, 0, dx)
                store(group, LANES, dy)
                store(group, 2 * LANES, dz)
                for lane in range(count):
                    for axis in range(3):
                        g_means[first + lane, axis] = group[axis * LANES + lane]
        g_centre[chunk, 0], g_centre[chunk, 1], g_centre[chunk, 2] = at_x, at_y, at_z


@kernel("fused", parallel=True)
def mixed_colors_and_slopes(means, sh, centre, mixing, colors, slopes):
    """Weighted sums of the colours, and how they change with the camera's centre.

    Args:
        mixing: `[O, C]`. colors: `[N, O]`, filled with Σ_c mixing · max(0, ½ + basis · sh_c).
        slopes: `[N, O, 3]`, filled with ∂colors/∂centre.
    """
    n, k, channels, outputs = len(means), sh.shape[1], sh.shape[2], len(mixing)
    for chunk in nb.prange(CHUNKS):
        group, basis = np.empty(3 * LANES, np.float32), np.empty(16 * LANES, np.float32)
        mixed, weights = np.zeros(16 * LANES, np.float32), np.empty((LANES, channels), np.float32)
        stop = (chunk + 1) * n // CHUNKS
        for first in range(chunk * n // CHUNKS, stop, LANES):
            count = min(LANES, stop - first)
            x, y, z, inverse = _directions(first, count, means, centre, group)
            _fill_basis(x, y, z, k, basis)
            for lane in range(count):
                for q in range(channels):
                    value = F(0.5)
                    for j in range(k):
                        value += basis[j * LANES + lane] * sh[first + lane, j, q]
                    weights[lane, q] = max(value, F(0))
            for o in range(outputs):
                for lane in range(count):
                    total_color = F(0)
                    for q in range(channels):
                        total_color += mixing[o, q] * weights[lane, q]
                    colors[first + lane, o] = total_color
                    for j in range(1, k):
                        value = F(0)
                        for q in range(channels):
                            if weights[lane, q] > F(0):
                                value += mixing[o, q] * sh[first + lane, j, q]
                        mixed[j * LANES + lane] = value
                dx, dy, dz = _basis_slope(x, y, z, k, mixed)
                radial = dx * x + dy * y + dz * z
                store(group, 0, (radial * x - dx) * inverse)
                store(group, LANES, (radial * y - dy) * inverse)
                store(group, 2 * LANES, (radial * z - dz) * inverse)
                for lane in range(count):
                    for axis in range(3):
                        slopes[first + lane, o, axis] = group[axis * LANES + lane]
