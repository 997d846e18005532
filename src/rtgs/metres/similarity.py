"""The similarity between positions in two frames, robust against wrong ones: camera centres, and what GPS says of them.

1. Of random triples of positions, the similarity with the smallest median residual is a start that no minority of wrong positions moves.
2. Least squares on the inliers, weighted by their standard deviations; inliers and noise are found again from the residuals.
3. The noise is the stated one, or what the residuals show where that is larger. Horizontal and vertical noise count apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from rtgs.maths.geometry import Sim3, nearest_rotation, rotation_from_axis_angle
from rtgs.records.metres import NORMAL_95

Array = NDArray[np.float64]

LEAST = 4  # positions; three fit any similarity nearly
_TRIPLES = 400
_FAR = 3.73  # standard deviations: 0.3 % of correct residuals in three dimensions are longer
_MEDIAN_OF_NORM = 1.538  # of three standard normal numbers
_ROUNDS = 12
_FREE_HORIZONTAL, _FREE_VERTICAL = 4, 3  # numbers of a similarity that each kind of residual decides in the main


@dataclass(frozen=True, eq=False)
class SimilarityFit:
    """A similarity with its uncertainty.

    Attributes:
        to_from: the similarity.
        std_log: standard deviation of ln factor.
        std_place: `[3]`, of the place of the inliers' middle.
        inliers: `[N]` bool.
        noise: horizontal and vertical noise, in units of the target frame.
        spread: root mean square distance of the inliers from their middle, in the target frame.
        width: likewise, across the direction in which they are spread most.
    """

    to_from: Sim3
    std_log: float
    std_place: Array
    inliers: NDArray[np.bool_]
    noise: tuple[float, float]
    spread: float
    width: float


def fit_similarity(points: Array, targets: Array, std: Array, *, stated: bool, seed: int = 0) -> SimilarityFit | None:
    """Fit `targets ≈ factor · rotation @ points + translation`.

    Args:
        points, targets: `[N, 3]`. Coordinate 2 of the targets is the vertical one.
        std: `[N, 3]`, standard deviations of the targets. Where they are not `stated`, only their ratios count.

    Returns:
        None where fewer than `LEAST` positions, or fewer than half of them, agree on a similarity.
    """
    if len(points) < LEAST:
        return None
    to_from = _start(points, targets, std, seed)
    if to_from is None:
        return None
    floor = 1.0 if stated else 1e-12
    scale, inliers, few = np.full(3, floor), np.ones(len(points), dtype=bool), _few(len(points))
    for round_ in range(_ROUNDS):
        residual = (targets - to_from.apply(points)) / std
        if round_ > 0:
            scale = np.maximum(_noise(residual[inliers]), floor)
        # What the inliers show is too little where correct positions have been left out; the median of all is not.
        typical = max(1.0, float(np.median(np.linalg.norm(residual / scale, axis=1))) / _MEDIAN_OF_NORM)
        now = np.linalg.norm(residual / scale, axis=1) < _FAR * typical * few
        if now.sum() < max(LEAST, len(points) / 2):
            return None
        if round_ > 2 and (now == inliers).all():
            break
        inliers = now
        to_from = _refined(to_from, points[inliers], targets[inliers], std[inliers] * scale)
    return _with_uncertainty(to_from, points, targets, std * scale, inliers)


def _start(points: Array, targets: Array, std: Array, seed: int) -> Sim3 | None:
    random, best, found = np.random.default_rng(seed), math.inf, None
    for _ in range(_TRIPLES):
        chosen = random.choice(len(points), 3, replace=False)
        trial = similarity_of(points[chosen], targets[chosen])
        if trial is None:
            continue
        error = float(np.median(np.linalg.norm((targets - trial.apply(points)) / std, axis=1)))
        if error < best:
            best, found = error, trial
    return found


def similarity_of(points: Array, targets: Array) -> Sim3 | None:
    """The least-squares similarity of all positions alike (Umeyama); None where they coincide."""
    a, b = points - points.mean(axis=0), targets - targets.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0]) @ vt
    size, covariance = float((a * a).sum()), float((b * (a @ rotation.T)).sum())
    if not size > 0 or not covariance > 1e-12 * size:
        return None
    factor = covariance / size
    return Sim3(factor, rotation, targets.mean(axis=0) - factor * rotation @ points.mean(axis=0))


def _noise(residual: Array) -> Array:
    """`[3]`: noise in units of the given standard deviations, horizontal twice and vertical."""
    n = len(residual)
    horizontal = math.sqrt((residual[:, :2] ** 2).sum() / max(2 * n - _FREE_HORIZONTAL, 1))
    vertical = math.sqrt((residual[:, 2] ** 2).sum() / max(n - _FREE_VERTICAL, 1))
    return np.array([horizontal, horizontal, vertical])


def _derivatives(to_from: Sim3, points: Array, middle: Array) -> Array:
    """`[N, 3, 7]`: of the mapped points by ln factor, a turn about `middle` and a shift."""
    arms = to_from.apply(points) - to_from.apply(middle)
    slopes = np.zeros((len(points), 3, 7))
    slopes[:, :, 0] = arms
    slopes[:, 0, 2], slopes[:, 0, 3] = arms[:, 2], -arms[:, 1]
    slopes[:, 1, 1], slopes[:, 1, 3] = -arms[:, 2], arms[:, 0]
    slopes[:, 2, 1], slopes[:, 2, 2] = arms[:, 1], -arms[:, 0]
    slopes[:, :, 4:] = np.eye(3)
    return slopes


def _refined(to_from: Sim3, points: Array, targets: Array, std: Array) -> Sim3:
    """One Gauss–Newton step."""
    middle = points.mean(axis=0)
    weighted = (_derivatives(to_from, points, middle) / std[:, :, None]).reshape(-1, 7)
    step = np.linalg.lstsq(weighted, ((targets - to_from.apply(points)) / std).ravel(), rcond=1e-9)[0]
    centre = to_from.apply(middle) + step[4:]
    turn = step[1:4] * min(1.0, 0.5 / max(float(np.linalg.norm(step[1:4])), 1e-300))
    factor = to_from.factor * math.exp(float(np.clip(step[0], -0.5, 0.5)))
    rotation = nearest_rotation(rotation_from_axis_angle(turn) @ to_from.rotation)
    return Sim3(factor, rotation, centre - factor * rotation @ middle)


def _with_uncertainty(to_from: Sim3, points: Array, targets: Array, std: Array, inliers: NDArray[np.bool_]) -> SimilarityFit:
    chosen, n = points[inliers], int(inliers.sum())
    weighted = (_derivatives(to_from, chosen, chosen.mean(axis=0)) / std[inliers][:, :, None]).reshape(-1, 7)
    covariance = np.linalg.pinv(weighted.T @ weighted, hermitian=True, rcond=1e-14)
    residual = (targets - to_from.apply(points))[inliers]
    # Few positions leave the noise itself unknown; a receiver's error lasts from one photograph to the next.
    deviations = _few(n) * math.sqrt(_lasting(residual[:, :2])) * np.sqrt(np.diag(covariance))
    mapped = to_from.apply(chosen)
    widths = np.linalg.svd(mapped - mapped.mean(axis=0), compute_uv=False) / math.sqrt(n)
    noise = math.sqrt((residual[:, :2] ** 2).mean()), math.sqrt((residual[:, 2] ** 2).mean())
    spread, width = float(np.hypot.reduce(widths)), float(np.hypot.reduce(widths[1:]))
    return SimilarityFit(to_from, float(deviations[0]), deviations[4:], inliers, noise, spread, width)


def _few(n: int) -> float:
    """By how much the noise of so few positions, known from themselves alone, widens a 95 % interval."""
    return float(stdtrit(max(2 * n - _FREE_HORIZONTAL, 1), 0.975)) / NORMAL_95


def _lasting(residual: Array) -> float:
    """By how much errors that last over several positions, in their order, raise variances: (1 + ρ)/(1 − ρ), 1 where none is seen."""
    around = residual - residual.mean(axis=0)
    total = float((around**2).sum())
    if len(around) < 8 or not total > 0:
        return 1.0
    rho = float((around[1:] * around[:-1]).sum()) / total
    rho = min(rho, 0.9)
    return (1 + rho) / (1 - rho) if rho > 2 / math.sqrt(len(around)) else 1.0
