"""Standard deviations of numbers that all pictures share, from least squares with a pose for each picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Block:
    """One picture's, or pair's, part of a least-squares problem at its solution, in standard deviations of the noise.

    Attributes:
        shared: `[m, k]`, derivatives of the residuals by what all pictures share.
        own: `[m, p]`, by what is this picture's alone.
        residuals: `[m]`.
    """

    shared: Array
    own: Array
    residuals: Array


def covariance(blocks: list[Block]) -> Array:
    """`[k, k]` of the shared numbers.

    There are two estimates: from the noise of single corners, and from how the result changes when one picture is left out (a
    jackknife with one Gauss–Newton step). The second also contains what is wrong in the same way all over one picture. Each number
    gets the larger of its two standard deviations.
    """
    normal, slopes = [], []
    for b in blocks:
        across = b.shared
        if b.own.shape[1]:
            q, _ = np.linalg.qr(b.own)
            across = across - q @ (q.T @ across)
        normal.append(across.T @ across)
        slopes.append(across.T @ b.residuals)
    total = np.sum(normal, axis=0)
    from_noise = np.linalg.pinv(total, hermitian=True)
    without = np.stack([np.linalg.lstsq(total - s, g, rcond=None)[0] for s, g in zip(normal, slopes, strict=True)])
    without -= without.mean(axis=0)
    left_out = (len(blocks) - 1) / len(blocks) * (without**2).sum(axis=0)
    factor = np.sqrt(np.maximum(1.0, left_out / np.diag(from_noise)))
    return from_noise * np.outer(factor, factor)
