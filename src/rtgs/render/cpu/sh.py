"""Colours from spherical harmonics, and back. One loop iteration is one Gaussian."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from rtgs.render.cpu.projection import CHUNKS
from rtgs.sh import C0, C1, C2, C3


@nb.njit(inline="always")
def _fill_basis(x, y, z, k, out):
    """The first `k` basis functions at a unit direction (see `rtgs.sh.basis`)."""
    out[0] = C0
    if k > 1:
        out[1], out[2], out[3] = -C1 * y, C1 * z, -C1 * x
    if k > 4:
        xx, yy, zz = x * x, y * y, z * z
        out[4], out[5], out[6] = C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy)
        out[7], out[8] = C2[3] * x * z, C2[4] * (xx - yy)
    if k > 9:
        xx, yy, zz = x * x, y * y, z * z
        out[9], out[10] = C3[0] * y * (3 * xx - yy), C3[1] * x * y * z
        out[11], out[12] = C3[2] * y * (4 * zz - xx - yy), C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
        out[13], out[14] = C3[4] * x * (4 * zz - xx - yy), C3[5] * z * (xx - yy)
        out[15] = C3[6] * x * (xx - 3 * yy)


@nb.njit(inline="always")
def _fill_basis_gradient(x, y, z, k, out):
    """∂basis/∂(x, y, z) `[k, 3]`, the direction's components taken as free."""
    out[:k] = 0.0
    if k > 1:
        out[1, 1], out[2, 2], out[3, 0] = -C1, C1, -C1
    if k > 4:
        out[4, 0], out[4, 1] = C2[0] * y, C2[0] * x
        out[5, 1], out[5, 2] = C2[1] * z, C2[1] * y
        out[6, 0], out[6, 1], out[6, 2] = -2 * C2[2] * x, -2 * C2[2] * y, 4 * C2[2] * z
        out[7, 0], out[7, 2] = C2[3] * z, C2[3] * x
        out[8, 0], out[8, 1] = 2 * C2[4] * x, -2 * C2[4] * y
    if k > 9:
        xx, yy, zz = x * x, y * y, z * z
        out[9, 0], out[9, 1] = C3[0] * 6 * x * y, C3[0] * 3 * (xx - yy)
        out[10, 0], out[10, 1], out[10, 2] = C3[1] * y * z, C3[1] * x * z, C3[1] * x * y
        out[11, 0], out[11, 1], out[11, 2] = -2 * C3[2] * x * y, C3[2] * (4 * zz - xx - 3 * yy), 8 * C3[2] * y * z
        out[12, 0], out[12, 1], out[12, 2] = -6 * C3[3] * x * z, -6 * C3[3] * y * z, C3[3] * (6 * zz - 3 * xx - 3 * yy)
        out[13, 0], out[13, 1], out[13, 2] = C3[4] * (4 * zz - 3 * xx - yy), -2 * C3[4] * x * y, 8 * C3[4] * x * z
        out[14, 0], out[14, 1], out[14, 2] = 2 * C3[5] * x * z, -2 * C3[5] * y * z, C3[5] * (xx - yy)
        out[15, 0], out[15, 1] = C3[6] * 3 * (xx - yy), -6 * C3[6] * x * y


@nb.njit(parallel=True, cache=True, error_model="numpy")
def evaluate(means, sh, centre, colors):
    """Fill `colors` `[N, C]` with max(0, ½ + basis · sh)."""
    k, channels = sh.shape[1], sh.shape[2]
    for chunk in nb.prange(CHUNKS):
        b, acc = np.empty(16), np.empty(channels)
        for i in range(chunk * len(means) // CHUNKS, (chunk + 1) * len(means) // CHUNKS):
            x, y, z = means[i, 0] - centre[0], means[i, 1] - centre[1], means[i, 2] - centre[2]
            inv = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
            _fill_basis(x * inv, y * inv, z * inv, k, b)
            acc[:] = 0.5
            for j in range(k):
                for q in range(channels):
                    acc[q] += b[j] * sh[i, j, q]
            for q in range(channels):
                colors[i, q] = max(acc[q], 0.0)


@nb.njit(parallel=True, cache=True, error_model="numpy")
def evaluate_backward(means, sh, centre, colors, g_colors, directional, g_sh, g_means, g_centre):
    """Fill `g_sh` `[N, K, C]` and, where `directional`, `g_means` `[N, 3]` and `g_centre` `[CHUNKS, 3]` (zero on entry).

    An empty `g_sh` `[0, K, C]` is not filled: a pose needs no gradient of the model, which is the largest array here.
    """
    k, channels, wanted = sh.shape[1], sh.shape[2], len(g_sh) > 0
    for chunk in nb.prange(CHUNKS):
        b, db = np.empty(16), np.empty((16, 3))
        for i in range(chunk * len(means) // CHUNKS, (chunk + 1) * len(means) // CHUNKS):
            used = False
            for q in range(channels):
                used = used or (g_colors[i, q] != 0.0 and colors[i, q] > 0.0)
            if not used:
                if wanted:
                    g_sh[i] = 0.0
                continue
            x, y, z = means[i, 0] - centre[0], means[i, 1] - centre[1], means[i, 2] - centre[2]
            inv = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
            x, y, z = x * inv, y * inv, z * inv
            if wanted:
                _fill_basis(x, y, z, k, b)
            for j in range(k if wanted else 0):
                for q in range(channels):
                    g_sh[i, j, q] = b[j] * g_colors[i, q] if colors[i, q] > 0.0 else 0.0
            if directional and k > 1:
                _fill_basis_gradient(x, y, z, k, db)
                dx = dy = dz = 0.0
                for q in range(channels):
                    if colors[i, q] > 0.0:
                        for j in range(1, k):
                            g = g_colors[i, q] * sh[i, j, q]
                            dx += g * db[j, 0]
                            dy += g * db[j, 1]
                            dz += g * db[j, 2]
                radial = dx * x + dy * y + dz * z
                dx, dy, dz = (dx - radial * x) * inv, (dy - radial * y) * inv, (dz - radial * z) * inv
                g_means[i, 0], g_means[i, 1], g_means[i, 2] = dx, dy, dz
                g_centre[chunk, 0] -= dx
                g_centre[chunk, 1] -= dy
                g_centre[chunk, 2] -= dz
