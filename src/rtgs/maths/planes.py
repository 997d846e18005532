"""Arithmetic of pictures that are stored channel by channel. Each call runs on one thread and releases the GIL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import kernel

Planes = NDArray[np.float32]


@kernel("fastest", concurrent=True, checks_division=True)
def add_each(planes: Planes, factors: Planes, others: Planes) -> None:
    """planes `[C, P]` += factors `[C]` · others `[C or 1, P]`."""
    channels, pixels = planes.shape
    for c in range(channels):
        other = others[c % len(others)]
        for i in range(pixels):
            planes[c, i] += factors[c] * other[i]


@kernel("fastest", concurrent=True)
def products(a: Planes, b: Planes) -> Planes:
    """`[B, C]`: Σ over the pixels of a `[B, P]` times b `[C, P]`."""
    out = np.empty((len(a), len(b)), np.float32)
    for m in range(len(a)):
        for n in range(len(b)):
            total = np.float32(0)
            for i in range(a.shape[1]):
                total += a[m, i] * b[n, i]
            out[m, n] = total
    return out
