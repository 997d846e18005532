"""Statistics over frames: what resampling them says about the place of a minimum."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

RESAMPLES = 1000
QUANTILE_95 = 1.96  # of the normal distribution: half a 95 % interval in standard deviations
UNLIKELY = 3.0  # standard errors, from which on a difference is clear


def significance(differences: NDArray[np.float64]) -> float:
    """Mean over frames in standard errors; infinite for a single frame, or frames that differ all alike, unless by nothing."""
    mean = float(differences.mean())
    error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) if len(differences) > 1 else 0.0
    if error > 0:
        return mean / error
    return math.copysign(math.inf, mean) if mean else 0.0


def block_length(frames: int) -> int:
    """How many neighbouring frames are resampled together: neighbours in time see the same things and err alike."""
    return max(1, round(frames ** (1 / 3)))


def small_sample_factor(frames: int, block: int) -> float:
    """What a resampled deviation has to be multiplied by, where b blocks are few.

    They vary too little, by √(b / (b − 1)), and the normal distribution's quantile is used where Student's belongs.
    """
    blocks = frames / block
    if blocks <= 1.5:
        return math.inf
    return math.sqrt(blocks / (blocks - 1)) * float(special.stdtrit(blocks - 1, 0.975) / special.ndtri(0.975))


def resampled_minima(thetas: NDArray[np.float64], curves: NDArray[np.float64], seed: int, block: int = 1) -> NDArray[np.float64]:
    """`[R]`: the minimum of the mean curve of each resample of the frames (circular block bootstrap)."""
    n = len(curves)
    rng = np.random.default_rng(seed)
    starts = rng.integers(n, size=(RESAMPLES, -(-n // block)))
    picks = ((starts[:, :, None] + np.arange(block)) % n).reshape(RESAMPLES, -1)[:, :n]
    shares = np.zeros((RESAMPLES, n))
    np.add.at(shares, (np.arange(RESAMPLES)[:, None], picks), 1.0 / n)
    return curve_minima(thetas, shares @ curves)


def curve_minimum(thetas: NDArray[np.float64], curve: NDArray[np.float64]) -> float:
    """θ of the lowest sample, refined by the parabola through it and its neighbours; an end stays an end."""
    return float(curve_minima(thetas, curve[None])[0])


def curve_minima(thetas: NDArray[np.float64], curves: NDArray[np.float64]) -> NDArray[np.float64]:
    """`[R]`: `curve_minimum` of each of the curves `[R, S]`, S at least 2."""
    row, lowest = np.arange(len(curves)), curves.argmin(axis=1)
    k = np.clip(lowest, 1, max(1, len(thetas) - 2))
    after = np.minimum(k + 1, len(thetas) - 1)
    back, forth = thetas[k - 1] - thetas[k], thetas[after] - thetas[k]
    with np.errstate(divide="ignore", invalid="ignore"):
        fall, rise = (curves[row, k - 1] - curves[row, k]) / back, (curves[row, after] - curves[row, k]) / forth
        a = (rise - fall) / (forth - back)
        vertex = np.clip(-(fall - a * back) / (2 * a), back, forth)
    inside = (lowest == k) & (a > 0)
    return np.where(inside, thetas[k] + np.where(inside, vertex, 0.0), thetas[lowest])
