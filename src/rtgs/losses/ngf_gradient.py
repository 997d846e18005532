"""The gradient of Eq. 7 by the picture, for slopes along many directions: one pass back through the loss, and a dot product a direction.

Letters are those of `rtgs.losses.ngf_fused`. Along a tangent with h = ∇Ȧ, (n · m)(ṅ · m) = h · q·(g·m)·(m − (g·m)·q·g), and
n · ṅ = h · q·u·g. `pull` gives these two fields, `spread` takes a field back through the derivative filter and through the halving.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from rtgs.base.compiled import kernel

F = np.float32
_BAND = 16  # rows a thread takes at a time


@kernel("fast", checks_division=True)
def _pull_row(above, middle, below, side, centre, target, y, epsilon2, agreement, edges):  # type: ignore[no-untyped-def]
    """Fill a row of the two fields; return Σ (n · m)² and Σ ‖n‖²."""
    total, squares = F(0.0), F(0.0)
    mx, my, valid = target[0, y], target[1, y], target[3, y]
    ax, ay, ex, ey = agreement[0, y], agreement[1, y], edges[0, y], edges[1, y]
    for x in range(len(mx)):
        gx = side * ((above[x + 2] - above[x]) + (below[x + 2] - below[x])) + centre * (middle[x + 2] - middle[x])
        gy = side * ((below[x] - above[x]) + (below[x + 2] - above[x + 2])) + centre * (below[x + 1] - above[x + 1])
        square = gx * gx + gy * gy
        q = F(1.0) / (square + epsilon2)
        dot = gx * mx[x] + gy * my[x]
        total += dot * dot * q
        squares += valid[x] * square * q
        ax[x], ay[x] = q * dot * (mx[x] - dot * q * gx), q * dot * (my[x] - dot * q * gy)
        w = valid[x] * q * q * epsilon2
        ex[x], ey[x] = w * gx, w * gy
    return total, squares


@kernel("fast", parallel=True, checks_division=True)
def pull(image, target, epsilon2, side, centre, agreement, edges):  # type: ignore[no-untyped-def]
    """`[rows, 2]`: Σ (n · m)² and Σ ‖n‖² over each row. Fills the fields `[2, h, w]` of an image `[h + 2, w + 2]`.

    Args:
        target: `[4, h, w]`, as in `FusedNgf.targets`.
        agreement, edges: what (n · m)(ṅ · m) and n · ṅ are the product of with ∇Ȧ.
    """
    rows = target.shape[1]
    sums = np.zeros((rows, 2))
    for band in prange((rows + _BAND - 1) // _BAND):
        for y in range(band * _BAND, min(rows, (band + 1) * _BAND)):
            row = image[y], image[y + 1], image[y + 2], side, centre, target, y, epsilon2, agreement, edges
            sums[y] = _pull_row(*row)
    return sums


@kernel("fast")
def _spread_row(field, y, beside, middle, upright, to):  # type: ignore[no-untyped-def]
    """Add what a row of the field gives to a row of the picture: `beside` and `middle` across ∂/∂x and ∂/∂y."""
    fx, fy = field[0, y], field[1, y]
    for x in range(len(fx)):
        to[x] += upright * beside * fy[x] - middle * fx[x]
    for x in range(len(fx)):
        to[x + 2] += upright * beside * fy[x] + middle * fx[x]


@kernel("fast")
def _add_middle(field, y, weight, to):  # type: ignore[no-untyped-def]
    fy = field[1, y]
    for x in range(len(fy)):
        to[x + 1] += weight * fy[x]


@kernel("fast")
def _add_halved(coarse, y, to):  # type: ignore[no-untyped-def]
    """The transpose of a mean over 2 × 2 pixels."""
    row = coarse[y // 2]
    for x in range(len(row)):
        to[2 * x] += F(0.25) * row[x]
        to[2 * x + 1] += F(0.25) * row[x]


@kernel("fast", parallel=True)
def spread(field, coarse, side, centre, out):  # type: ignore[no-untyped-def]
    """The transpose of the derivative filter `[h, w]` ← `[h + 2, w + 2]` of a field `[2, h, w]`, plus that of the halving to `coarse`."""
    height = field.shape[1]
    for row in prange(out.shape[0]):
        to = out[row]
        to[:] = F(0.0)
        if row < height:  # it is above
            _spread_row(field, row, side, side, F(-1.0), to)
            _add_middle(field, row, -centre, to)
        if 1 <= row <= height:
            _spread_row(field, row - 1, F(0.0), centre, F(0.0), to)
        if row >= 2:  # it is below
            _spread_row(field, row - 2, side, side, F(1.0), to)
            _add_middle(field, row - 2, centre, to)
        if row < 2 * coarse.shape[0]:
            _add_halved(coarse, row, to)
    return out


@kernel("fast")
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = F(0.0)
    for x in range(len(a)):
        total += a[x] * b[x]
    return total


@kernel("fast", parallel=True)
def dots(gradient, tangents):  # type: ignore[no-untyped-def]
    """`[rows, K]`: over each row, Σ gradient · tangent."""
    rows, ways = gradient.shape[0], tangents.shape[0]
    sums = np.zeros((rows, ways))
    for y in prange(rows):
        for k in range(ways):
            sums[y, k] = _dot(gradient[y], tangents[k, y])
    return sums
