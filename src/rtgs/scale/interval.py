"""How sure the scale is: per-frame curves near the minimum, resampled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rtgs.scale.objective import Evaluation, Objective
from rtgs.scale.records import Counter

_RESAMPLES = 1000
_GRID = 257
_MOST_DOUBLINGS = 6
_FARTHEST = 3.0  # in θ: no window of curves reaches further, whatever a pixel of flow would ask for
_MOST_SETTLINGS = 4
MODEL_PIXELS = 0.05
"""Edges of a render lie beside those of the photograph, in many frames alike: by how much, as `benchmarks/scale_coverage.py` has it."""

_BLUR_SHARE = 0.1  # of the blur, to which an edge is placed in it where modalities differ (chosen on `--table 2`)


def model_pixels(blur_px: float, sharp: float = MODEL_PIXELS) -> float:
    """Standard deviation of where the model's edges lie, in pixels: for sharp thermal images, and for soft ones."""
    return math.hypot(sharp, _BLUR_SHARE * blur_px)


class LocalCurves:
    """Per-frame losses and slopes at a few θ; between two of them a curve is the cubic with these values and slopes (Hermite)."""

    def __init__(self, objective: Objective, counter: Counter) -> None:
        self._objective, self._counter = objective, counter
        self._found: dict[tuple[int, float], Evaluation] = {}
        self.frames: list[int] = []
        self.thetas: list[float] = []

    def extend(self, frames: Iterable[int] = (), thetas: Sequence[float] = ()) -> None:
        """Have all these frames, and those from before, at all these scales, and those from before."""
        self.frames, self.thetas = sorted({*self.frames, *frames}), sorted({*self.thetas, *thetas})
        missing = [(i, theta) for i in self.frames for theta in self.thetas if (i, theta) not in self._found]
        self._counter.plan(len(missing))
        for i, theta in missing:
            self._found[i, theta] = self._objective.evaluate(i, theta)
            self._counter(f"interval, s = {math.exp(theta):.5g}")

    def values(self) -> NDArray[np.float64]:
        """`[F, S]` losses."""
        return np.array([[self._found[i, t].loss for t in self.thetas] for i in self.frames])

    def slopes(self) -> NDArray[np.float64]:
        """`[F, S]` derivatives by θ."""
        return np.array([[self._found[i, t].slope for t in self.thetas] for i in self.frames])

    def dense(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """θ `[G]`, and every frame's curve `[F, G]`."""
        grid = np.union1d(np.linspace(self.thetas[0], self.thetas[-1], _GRID), self.thetas)
        return grid, hermite(np.array(self.thetas), self.values(), self.slopes(), grid)

    def minimum(self) -> float:
        """θ of the lowest point of the mean curve."""
        grid, curves = self.dense()
        return curve_minimum(grid, curves.mean(axis=0))

    def settled(self, half_width: float) -> float:
        """The same with the loss itself evaluated there: between far-apart nodes a cubic may dip where the loss does not."""
        for _ in range(_MOST_SETTLINGS):
            best = self.minimum()
            if min(abs(best - theta) for theta in self.thetas) < 0.1 * half_width:
                break
            self.extend(thetas=[best])
        return self.minimum()


def hermite(
    thetas: NDArray[np.float64], values: NDArray[np.float64], slopes: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Piecewise cubics with these values and slopes `[F, S]` at `thetas` `[S]` (rising), read at `at` `[G]` within them."""
    k = np.clip(np.searchsorted(thetas, at, side="right") - 1, 0, len(thetas) - 2)
    width = thetas[k + 1] - thetas[k]
    t = (at - thetas[k]) / width
    start, end = (1 + 2 * t) * (1 - t) ** 2, t**2 * (3 - 2 * t)
    rise, fall = t * (1 - t) ** 2 * width, t**2 * (t - 1) * width
    return values[:, k] * start + values[:, k + 1] * end + slopes[:, k] * rise + slopes[:, k + 1] * fall


def window(slopes: NDArray[np.float64], curvature: float, pixel: float) -> float:
    """Half-width in θ of the first curves: five standard errors of the minimum by the sandwich rule, 0.1 to 3 px of flow.

    Args:
        slopes: `[F]`, per frame at the minimum. curvature: of the mean loss there. pixel: θ that moves the picture by one pixel.
    """
    error = float(slopes.std(ddof=1)) / math.sqrt(len(slopes)) / curvature if len(slopes) > 1 and curvature > 0 else pixel
    return float(np.clip(5 * error, 0.1 * pixel, 3 * pixel))


def nodes(theta: float, half_width: float, pixel: float) -> list[float]:
    """Scales over the window, no further apart than half a pixel of flow: so far a curve is much like a cubic."""
    count = max(2, math.ceil(4 * half_width / pixel) + 1)
    return np.linspace(theta - half_width, theta + half_width, count).tolist()


def widened(curves: LocalCurves, frames: Sequence[int], theta: float, half_width: float, pixel: float, seed: int) -> bool:
    """Extend the curves until the resampled minima lie inside.

    Args:
        theta, half_width: the first window, which doubles. pixel: change of θ that moves the picture by a pixel.

    Returns:
        Whether they do; else the loss is flat as far as was looked.
    """
    block, half_width = block_length(len(frames)), min(half_width, _FARTHEST / 4)
    thetas = nodes(theta, half_width, pixel)
    for doubling in range(_MOST_DOUBLINGS):
        curves.extend(frames, thetas)
        grid, dense = curves.dense()
        minima = resampled_minima(grid, dense, seed, block)
        inside = np.mean((minima > grid[0]) & (minima < grid[-1]))
        best = curve_minimum(grid, dense.mean(axis=0))
        if inside > 0.99 and grid[0] < best < grid[-1]:
            return True
        reach = half_width * 2 ** (doubling + 1)
        if reach > _FARTHEST:
            break
        thetas = [theta - reach, theta + reach]
    return False


def block_length(frames: int) -> int:
    """Neighbours in time see the same things and err alike: frames are resampled in runs of this many."""
    return max(1, round(frames ** (1 / 3)))


def small_sample_factor(frames: int, block: int) -> float:
    """By how much resampling understates: few blocks vary too little, √(b / (b − 1)), and a normal quantile stands for Student's."""
    blocks = frames / block
    if blocks <= 1.5:
        return math.inf
    return math.sqrt(blocks / (blocks - 1)) * float(stats.t.ppf(0.975, blocks - 1) / stats.norm.ppf(0.975))


def resampled_minima(
    thetas: NDArray[np.float64], curves: NDArray[np.float64], seed: int, block: int = 1, resamples: int = _RESAMPLES
) -> NDArray[np.float64]:
    """`[R]`: the minimum of the mean curve of each resample of the frames (circular block bootstrap)."""
    n = len(curves)
    rng = np.random.default_rng(seed)
    starts = rng.integers(n, size=(resamples, -(-n // block)))
    picks = ((starts[:, :, None] + np.arange(block)) % n).reshape(resamples, -1)[:, :n]
    shares = np.zeros((resamples, n))
    np.add.at(shares, (np.arange(resamples)[:, None], picks), 1.0 / n)
    return curve_minima(thetas, shares @ curves)


def bootstrap(
    thetas: NDArray[np.float64], curves: NDArray[np.float64], seed: int, block: int = 1
) -> tuple[float, tuple[float, float]]:
    """Resample frames, take each mean curve's minimum, and say how it scatters.

    Args:
        thetas: `[S]`, rising; curves: `[F, S]`. block: frames that are drawn together.

    Returns:
        Standard deviation of ln s, and the 95 % percentile interval of s.
    """
    minima = resampled_minima(thetas, curves, seed, block)
    lo, hi = np.percentile(minima, [2.5, 97.5])
    return float(minima.std()), (float(np.exp(lo)), float(np.exp(hi)))


def interval(
    thetas: NDArray[np.float64], curves: NDArray[np.float64], theta: float, common_std_log: float, seed: int
) -> tuple[float, tuple[float, float]]:
    """Standard deviation of ln s and its 95 % interval: the resampled minima, widened for small samples and for what all frames share.

    Args:
        theta: the answer, which the interval contains in any case. The resamples' scatter about their median is put around the mean
            curve's minimum, the same place for a solver that found it.
        common_std_log: of ln s, what all frames have alike: no resampling of them shows it.
    """
    block = block_length(len(curves))
    minima = resampled_minima(thetas, curves, seed, block)
    factor = small_sample_factor(len(curves), block)
    spread = (minima - np.median(minima)) * factor
    noise = np.random.default_rng(seed + 1).normal(size=len(spread)) * common_std_log
    lo, hi = np.percentile(spread + noise, [2.5, 97.5])
    std = math.hypot(float(minima.std()) * factor, common_std_log)
    centre = curve_minimum(thetas, curves.mean(axis=0))
    return std, (math.exp(min(centre + lo, theta)), math.exp(max(centre + hi, theta)))


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
