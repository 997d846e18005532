"""Solid and flat textures, evaluated at points: no image is stored, so there is always finer detail.

Points are in metres. Scalar textures return `[N]` in [0, 1]; colours are sRGB in [0, 1], `[N, 3]`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
_LATTICE = 32


@cache
def _lattice(seed: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random(_LATTICE**3, dtype=np.float32)


def cell_noise(cell: NDArray[np.int64], seed: int = 0) -> Floats:
    """One random number for every integer cell `[N, D]`."""
    h = np.full(len(cell), (seed * 0x9E3779B1 + 0x7F4A7C15) & 0xFFFFFFFF, dtype=np.uint64)
    for k in range(cell.shape[1]):
        h = (h ^ (cell[:, k].astype(np.int64) & 0xFFFFFFFF).astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return (h >> np.uint64(40)).astype(np.float64) / 2**24


def noise(p: Floats, period_m: float, seed: int = 0) -> Floats:
    """Smooth value noise whose lattice has edges of `period_m`."""
    q = p / period_m
    base = np.floor(q)
    f = q - base
    f = f * f * (3 - 2 * f)
    i0 = base.astype(np.int64) % _LATTICE
    i1 = (i0 + 1) % _LATTICE
    table, n = _lattice(seed), _LATTICE
    x0, x1 = i0[:, 0] * (n * n), i1[:, 0] * (n * n)
    y0, y1 = i0[:, 1] * n, i1[:, 1] * n
    z0, z1 = i0[:, 2], i1[:, 2]
    fx, fy, fz = f[:, 0], f[:, 1], f[:, 2]

    def along_z(xy: NDArray[np.int64]) -> Floats:
        a = table[xy + z0]
        return a + fz * (table[xy + z1] - a)

    a = along_z(x0 + y0)
    a = a + fy * (along_z(x0 + y1) - a)
    b = along_z(x1 + y0)
    b = b + fy * (along_z(x1 + y1) - b)
    return a + fx * (b - a)


def fbm(p: Floats, period_m: float, octaves: int = 4, seed: int = 0) -> Floats:
    """Fractal noise: octaves of `noise`, each of half the period and 0.55 times the weight; stretched to fill [0, 1]."""
    total = np.zeros(len(p))
    weight, norm = 1.0, 0.0
    for k in range(octaves):
        total += weight * noise(p + 0.37 * k * period_m, period_m * 0.5**k, seed + k)
        norm += weight
        weight *= 0.55
    return np.clip((total / norm - 0.5) * 1.7 + 0.5, 0, 1)


def checker(uv: Floats, size_m: float) -> Floats:
    """0 or 1 on squares (`[N, 2]`) or cubes (`[N, 3]`)."""
    return np.floor(uv / size_m).sum(axis=1) % 2


def stripes(x: Floats, period_m: float, duty: float = 0.5) -> Floats:
    """1 on the first `duty` of every period of the coordinate `[N]`."""
    return ((x / period_m) % 1.0 < duty).astype(np.float64)


def bricks(uv: Floats, length_m: float, height_m: float, mortar_m: float, seed: int = 0) -> tuple[Floats, Floats]:
    """Running bond. Returns (1 on brick and 0 on mortar, a random number for each brick)."""
    row = np.floor(uv[:, 1] / height_m)
    x = uv[:, 0] + 0.5 * length_m * (row % 2)
    column = np.floor(x / length_m)
    on = ((x - column * length_m) > mortar_m) & ((uv[:, 1] - row * height_m) > mortar_m)
    return on.astype(np.float64), cell_noise(np.stack([column, row], axis=1).astype(np.int64), seed)


def dots(uv: Floats, cell_m: float, seed: int = 0, fill: float = 0.7, smallest: float = 0.12, largest: float = 0.38) -> Floats:
    """1 inside round dots, one in a `fill` share of the cells, of random place and size (in cells). `[N, 2]` or `[N, 3]`."""
    q = uv / cell_m
    cell = np.floor(q).astype(np.int64)
    f = q - cell
    radius = smallest + (largest - smallest) * cell_noise(cell, seed)
    d2 = np.zeros(len(q))
    for k in range(q.shape[1]):
        centre = radius + (1 - 2 * radius) * cell_noise(cell, seed + 1 + k)
        d2 += (f[:, k] - centre) ** 2
    return ((d2 < radius**2) & (cell_noise(cell, seed + 7) < fill)).astype(np.float64)


def print_marks(uv: Floats, glyph_m: float, seed: int = 0) -> Floats:
    """1 on ink: lines of made-up letters (random 4 × 5 bitmaps), `glyph_m` high, with word gaps. `[N, 2]`."""
    q = uv / glyph_m * np.array([1.5, 1.0])
    line, column = np.floor(q[:, 1] / 1.6), np.floor(q[:, 0])
    fx, fy = (q[:, 0] - column) / 0.8, (q[:, 1] / 1.6 - line) * 1.6
    glyph = np.stack([column, line], axis=1).astype(np.int64)
    bit = np.stack([column * 4 + np.floor(fx * 4), line * 5 + np.floor(fy * 5)], axis=1).astype(np.int64)
    inside = (fx < 1) & (fy < 1) & (cell_noise(glyph, seed) > 0.18)
    return (inside & (cell_noise(bit, seed + 1) < 0.55)).astype(np.float64)


def wood(p: Floats, ring_m: float = 0.03, seed: int = 0) -> Floats:
    """Growth rings about the local x axis, stretched along it, with fine grain."""
    stretched = p * np.array([0.12, 1.0, 1.0])
    radius = np.hypot(p[:, 1] + 0.6 * ring_m, p[:, 2] - 13.1 * ring_m) + 2.2 * ring_m * fbm(stretched, 5 * ring_m, 3, seed)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * radius / ring_m)
    grain = noise(p * np.array([0.06, 1.0, 1.0]), ring_m * 0.16, seed + 5)
    return np.clip(0.40 * rings + 0.60 * grain, 0, 1)


def mix(a: ArrayLike, b: ArrayLike, t: NDArray[Any]) -> Floats:
    """Colour `a` where t = 0, `b` where t = 1; each `[3]` or `[N, 3]`."""
    t = t[:, None]
    return np.asarray(a, dtype=np.float64) * (1 - t) + np.asarray(b, dtype=np.float64) * t


def ramp(t: Floats, colours: ArrayLike) -> Floats:
    """Colour from equally spaced stops `[K, 3]`."""
    stops = np.asarray(colours, dtype=np.float64)
    at = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(t, at, stops[:, k]) for k in range(3)], axis=1)


def face_uv(p: Floats, normals: Floats) -> Floats:
    """`[N, 2]`: the two coordinates across the axis that each normal points along most; z (or y) second."""
    axis = np.abs(normals).argmax(axis=1)
    u = np.where(axis == 0, p[:, 1], p[:, 0])
    v = np.where(axis == 2, p[:, 1], p[:, 2])
    return np.stack([u, v], axis=1)


def around_z(p: Floats, radius_m: float) -> Floats:
    """`[N, 2]`: arc length around z at `radius_m`, and z."""
    return np.stack([np.arctan2(p[:, 1], p[:, 0]) * radius_m, p[:, 2]], axis=1)


def bump(p: Floats, centre: ArrayLike, sigma_m: ArrayLike) -> Floats:
    """A Gaussian of height 1 about `centre`; one standard deviation, or one for each axis."""
    d = (p - np.asarray(centre, dtype=np.float64)) / np.asarray(sigma_m, dtype=np.float64)
    return np.exp(-0.5 * (d * d).sum(axis=1))
