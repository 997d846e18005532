"""Colours seen from a camera as a linear map of spherical harmonics, its transpose, and the blocks of its square.

`render`'s own harmonics add ½ and clamp; the linear fit does neither. C is the number of columns (right-hand sides). Each function runs
on one thread and releases Python's lock, so that several frames can be worked on at once.
"""

from __future__ import annotations

import math
from collections.abc import Sized

import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import inlined, kernel
from rtgs.maths.sh import C0, C1, C2, C3

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]


@inlined
def _fill_basis(means: Floats, n: int, centre: Floats, b: Floats) -> None:
    """`rtgs.maths.sh.basis` in the direction from the camera to Gaussian n, into `b` `[K]`."""
    b[0] = C0
    if len(b) == 1:
        return
    x, y, z = means[n, 0] - centre[0], means[n, 1] - centre[1], means[n, 2] - centre[2]
    scale = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
    x, y, z = x * scale, y * scale, z * scale
    b[1], b[2], b[3] = -C1 * y, C1 * z, -C1 * x
    if len(b) > 4:
        xx, yy, zz = x * x, y * y, z * z
        b[4], b[5], b[6] = C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy)
        b[7], b[8] = C2[3] * x * z, C2[4] * (xx - yy)
        if len(b) > 9:
            b[9], b[10] = C3[0] * y * (3 * xx - yy), C3[1] * x * y * z
            b[11], b[12] = C3[2] * y * (4 * zz - xx - yy), C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
            b[13], b[14], b[15] = C3[4] * x * (4 * zz - xx - yy), C3[5] * z * (xx - yy), C3[6] * x * (xx - 3 * yy)


@kernel("fastest", concurrent=True, checks_division=True)
def _colors_of(
    means: Floats, centre: Floats, visible: Ints, sh: Floats, coefficients: Sized, channels: Sized, out: Floats
) -> None:
    b = np.empty(len(coefficients), np.float32)
    for n in visible:
        _fill_basis(means, n, centre, b)
        for c in range(len(channels)):
            color = np.float32(0)
            for j in range(len(coefficients)):
                color += b[j] * sh[n, j, c]
            out[n, c] = color


@kernel("fastest", concurrent=True, checks_division=True)
def _add_transpose(
    means: Floats, centre: Floats, visible: Ints, colors: Floats, coefficients: Sized, channels: Sized, out: Floats
) -> None:
    b = np.empty(len(coefficients), np.float32)
    for n in visible:
        _fill_basis(means, n, centre, b)
        for j in range(len(coefficients)):
            for c in range(len(channels)):
                out[n, j, c] += b[j] * colors[n, c]


def colors_of(means: Floats, centre: Floats, visible: Ints, sh: Floats, out: Floats) -> None:
    """out `[N, C]` = basis · sh of the Gaussians in visible `[V]`; other rows stay. means `[N, 3]`, centre `[3]`, sh `[N, K, C]`."""
    _colors_of(means, centre, visible, sh, *_sizes(sh), out)


def add_transpose(means: Floats, centre: Floats, visible: Ints, colors: Floats, out: Floats) -> None:
    """out `[N, K, C]` += basis ⊗ colors `[N, C]` of the Gaussians in visible `[V]`."""
    _add_transpose(means, centre, visible, colors, *_sizes(out), out)


def _sizes(sh: Floats) -> tuple[Sized, Sized]:
    """K and C as lengths of tuples, so that they are part of the compiled type: the inner loops are a few numbers long."""
    return (0,) * sh.shape[1], (0,) * sh.shape[2]


@kernel("fastest", concurrent=True, checks_division=True)
def add_blocks(means: Floats, centre: Floats, weights: Floats, out: Floats) -> None:
    """out `[N, K, K]` += weights `[N]` · basis ⊗ basis."""
    count, k, _ = out.shape
    b = np.empty(k, np.float32)
    for n in range(count):
        if weights[n] == 0.0:
            continue
        _fill_basis(means, n, centre, b)
        for j in range(k):
            for i in range(k):
                out[n, j, i] += weights[n] * b[j] * b[i]
