"""Pictures that lie channel by channel, each in one piece; on one thread, without Python's lock."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

Planes = NDArray[np.float32]


@nb.njit(nogil=True, fastmath=True, cache=True)
def add_each(planes: Planes, factors: Planes, others: Planes) -> None:
    """planes `[C, P]` += factors `[C]` · others `[C or 1, P]`."""
    channels, pixels = planes.shape
    for c in range(channels):
        other = others[c % len(others)]
        for i in range(pixels):
            planes[c, i] += factors[c] * other[i]


@nb.njit(nogil=True, fastmath=True, cache=True)
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
