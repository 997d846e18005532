"""Eq. 7 with its derivatives along tangent pictures, in one fused pass on the CPU.

`rtgs.losses.ngf.NgfPyramid` is the specification. These Numba kernels (float32, sums over rows in float64) are tested against it. A
scale is found by thousands of evaluations of the loss along *one* direction, so the gradient by the picture is never formed: the Sobel
filters run over the render and over its tangents, and a pixel gives its share of the slope and of the Gauss–Newton matrix at once.

**Letters.** g = ∇A, h = ∇Ȧ, q = 1/(‖g‖² + ε²), n = g·√q, m = n_B. With p = g·h: ṅ = √q·(h − g·p·q). The residual pair of
`NgfPyramid.residuals` is c = n × m and e = √(1 − ‖n‖²‖m‖²), and with u = 1 − ‖n‖² = ε²·q and v = 1 − ‖m‖², without cancellation,

    e² = u + v − u·v,    ė = −‖m‖²·p·q·u / e.

Per edge, a level's N = Σ (n · m)² is divided by the root mean square of ‖n‖; the derivative of Σ ‖n‖² is 2·Σ n · ṅ = 2·Σ p·q·u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.compiled import kernel
from rtgs.losses.edge_loss import EdgeLoss, Products
from rtgs.losses.ngf import LEAST_STRENGTH, NgfPyramid

F = np.float32
_BAND = 16  # rows a thread takes at a time
_LEAST_E2 = F(1e-20)


@dataclass(frozen=True, eq=False)
class FusedNgf:
    """Eq. 7 against one fixed image, for float32 pictures on the CPU. Build it with `FusedNgf.of`."""

    targets: tuple[NDArray[np.float32], ...]  # [4, h, w] a level: m, v, and 1 where valid
    pixels: tuple[int, ...]  # valid ones; at least 1
    settings: EdgeLoss

    @staticmethod
    def of(pyramid: NgfPyramid) -> FusedNgf:
        """Take a target over; a pyramid built in float64 keeps v exact where ε is small."""
        targets = []
        for level in pyramid.levels:
            m = level.gradient
            planes = [m[0], m[1], 1.0 - m.square().sum(0), level.valid]
            targets.append(np.stack([t.numpy() for t in planes]).astype(np.float32))
        return FusedNgf(tuple(targets), tuple(max(level.pixels, 1) for level in pyramid.levels), pyramid.settings)

    def loss(self, picture: Tensor) -> float:
        """Eq. 7 of a picture `[H, W]` float32."""
        agreement, image = 0.0, picture.numpy()
        for level, target in enumerate(self.targets):
            image = image if level == 0 else _halved(image[None])[0]
            found, square = _agreement(image, target, *self._numbers(level)).sum(axis=0) / self.pixels[level]
            agreement += self._share(level) * found / self._strength(square)
        return float(1.0 - agreement)

    def products(self, picture: Tensor, tangents: Tensor, *, curvature: bool = True) -> Products:
        """Eq. 7 of a picture `[H, W]` and its derivatives along tangents `[K, H, W]`, all float32."""
        stack = np.concatenate([picture.numpy()[None], tangents.numpy()])
        k = len(tangents)
        agreement, slope, matrix = 0.0, np.zeros(k), np.zeros(k * k)
        for level, target in enumerate(self.targets):
            stack = stack if level == 0 else _halved(stack)
            sums = _products(stack, target, *self._numbers(level), curvature).sum(axis=0) / self.pixels[level]
            found, square, rates, changes, squares = sums[0], sums[1], sums[2 : 2 + k], sums[2 + k : 2 + 2 * k], sums[2 + 2 * k :]
            strength = self._strength(square)
            share = self._share(level) / strength
            varies = self.settings.per_edge and strength > LEAST_STRENGTH
            agreement += share * found
            slope += share * (rates - 0.5 * found / square * changes if varies else rates)
            matrix += share * squares
        return Products(float(1.0 - agreement), -2.0 * slope, 2.0 * matrix.reshape(k, k))

    def _numbers(self, level: int) -> tuple[np.float32, np.float32, np.float32]:
        """ε² of the render and the derivative filter, as the kernels take them."""
        beside, middle = self.settings.across
        return F(self.settings.render_epsilons[level] ** 2), F(beside), F(middle)

    def _share(self, level: int) -> float:
        """w_l / Σ w."""
        return self.settings.level_weights[level] / sum(self.settings.level_weights)

    def _strength(self, square: float) -> float:
        """What a level's agreement is divided by, from its mean ‖n_A‖²."""
        return max(float(np.sqrt(square)), LEAST_STRENGTH) if self.settings.per_edge else 1.0


# --- kernels ---


@kernel("ordered", parallel=True, checks_division=True)
def _halved(stack):  # type: ignore[no-untyped-def]
    """Means over 2 × 2 blocks of `[K, H, W]`."""
    count, height, width = stack.shape[0], stack.shape[1] // 2, stack.shape[2] // 2
    out = np.empty((count, height, width), np.float32)
    for row in prange(count * height):
        k, y = row // height, row % height
        upper, lower, to = stack[k, 2 * y], stack[k, 2 * y + 1], out[k, y]
        for x in range(width):
            to[x] = F(0.25) * ((upper[2 * x] + upper[2 * x + 1]) + (lower[2 * x] + lower[2 * x + 1]))
    return out


@kernel("ordered")
def _gradient_row(above, middle, below, side, centre, gx, gy):  # type: ignore[no-untyped-def]
    for x in range(len(gx)):
        gx[x] = side * ((above[x + 2] - above[x]) + (below[x + 2] - below[x])) + centre * (middle[x + 2] - middle[x])
        gy[x] = side * ((below[x] - above[x]) + (below[x + 2] - above[x + 2])) + centre * (below[x + 1] - above[x + 1])


@kernel("fast", checks_division=True)
def _agreement_row(gx, gy, mx, my, valid, epsilon2):  # type: ignore[no-untyped-def]
    """Σ (n · m)² and Σ ‖n‖² of a row."""
    total, squares = F(0.0), F(0.0)
    for x in range(len(gx)):
        dot = gx[x] * mx[x] + gy[x] * my[x]
        square = gx[x] * gx[x] + gy[x] * gy[x]
        q = F(1.0) / (square + epsilon2)
        total += dot * dot * q
        squares += valid[x] * square * q
    return total, squares


@kernel("fast", parallel=True, checks_division=True)
def _agreement(image, target, epsilon2, side, centre):  # type: ignore[no-untyped-def]
    """`[rows, 2]`: Σ (n · m)² and Σ ‖n‖² over each row."""
    rows, columns = target.shape[1], target.shape[2]
    sums = np.zeros((rows, 2))
    for band in prange((rows + _BAND - 1) // _BAND):
        gx, gy = np.empty(columns, np.float32), np.empty(columns, np.float32)
        for y in range(band * _BAND, min(rows, (band + 1) * _BAND)):
            _gradient_row(image[y], image[y + 1], image[y + 2], side, centre, gx, gy)
            sums[y] = _agreement_row(gx, gy, target[0, y], target[1, y], target[3, y], epsilon2)
    return sums


@kernel("fast", checks_division=True)
def _tangent_row(gx, gy, hx, hy, mx, my, v, valid, epsilon2, cross, rest):  # type: ignore[no-untyped-def]
    """Fill ċ and ė of a row; return Σ (n · m)(ṅ · m) and Σ n · ṅ."""
    total, change = F(0.0), F(0.0)
    for x in range(len(gx)):
        p = gx[x] * hx[x] + gy[x] * hy[x]
        q = F(1.0) / (gx[x] * gx[x] + gy[x] * gy[x] + epsilon2)
        wx, wy = hx[x] - gx[x] * p * q, hy[x] - gy[x] * p * q  # ṅ / √q
        total += q * (gx[x] * mx[x] + gy[x] * my[x]) * (wx * mx[x] + wy * my[x])
        cross[x] = np.sqrt(q) * (wx * my[x] - wy * mx[x])
        u = epsilon2 * q
        change += valid[x] * p * q * u
        rest[x] = (v[x] - F(1.0)) * p * q * u / np.sqrt(max(u + v[x] - u * v[x], _LEAST_E2))
    return total, change


@kernel("fast")
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = F(0.0)
    for x in range(len(a)):
        total += a[x] * b[x]
    return total


@kernel("fast", parallel=True, checks_division=True)
def _products(stack, target, epsilon2, side, centre, with_matrix):  # type: ignore[no-untyped-def]
    """`[rows, 2 + 2·K + K²]`: over each row, Σ (n · m)², Σ ‖n‖², Σ (n · m)(ṅ · m), Σ n · ṅ and Σ JᵀJ. `stack`: render, tangents."""
    rows, columns = target.shape[1], target.shape[2]
    ways = stack.shape[0] - 1
    first = 2 + 2 * ways  # of the matrix
    sums = np.zeros((rows, first + ways * ways))
    for band in prange((rows + _BAND - 1) // _BAND):
        row = np.empty((4, columns), np.float32)
        residual = np.empty((2 * ways, columns), np.float32)
        gx, gy, hx, hy = row[0], row[1], row[2], row[3]
        for y in range(band * _BAND, min(rows, (band + 1) * _BAND)):
            mx, my, v, valid = target[0, y], target[1, y], target[2, y], target[3, y]
            _gradient_row(stack[0, y], stack[0, y + 1], stack[0, y + 2], side, centre, gx, gy)
            sums[y, 0], sums[y, 1] = _agreement_row(gx, gy, mx, my, valid, epsilon2)
            for k in range(ways):
                _gradient_row(stack[k + 1, y], stack[k + 1, y + 1], stack[k + 1, y + 2], side, centre, hx, hy)
                cross, rest = residual[2 * k], residual[2 * k + 1]
                sums[y, 2 + k], sums[y, 2 + ways + k] = _tangent_row(gx, gy, hx, hy, mx, my, v, valid, epsilon2, cross, rest)
                for j in range(k + 1 if with_matrix else 0):
                    product = _dot(residual[2 * j], residual[2 * k]) + _dot(residual[2 * j + 1], residual[2 * k + 1])
                    sums[y, first + j * ways + k] = product
                    sums[y, first + k * ways + j] = product
    return sums
