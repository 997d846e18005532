"""The loss of each frame as a curve over θ near the minimum, from a few renders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.scale.objective import FrameLoss, Objective
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import Scan
from rtgs.scale.resampling import block_length, curve_minimum, resampled_minima

_GRID = 257
_MOST_DOUBLINGS = 6
_FARTHEST = 3.0  # in θ: no window of curves reaches further, whatever a pixel of flow would ask for
_MOST_SETTLINGS = 4


@dataclass(frozen=True, eq=False)
class LocalCurves:
    """Losses and slopes of some frames at a few θ. Between two of them a frame's curve is the cubic with these values and slopes (Hermite).

    Attributes:
        objective: where they come from.
        frames: its indices, rising. thetas: rising.
        evaluations: (frame, θ) → what was found there: one render each.
    """

    objective: Objective
    frames: tuple[int, ...] = ()
    thetas: tuple[float, ...] = ()
    evaluations: Mapping[tuple[int, float], FrameLoss] = field(default_factory=dict)

    def extended(self, progress: RenderProgress, *, frames: Iterable[int] = (), thetas: Sequence[float] = ()) -> LocalCurves:
        """The curves of all these frames and those from before, at all these θ and those from before. Renders what is missing."""
        every, places = tuple(sorted({*self.frames, *frames})), tuple(sorted({*self.thetas, *thetas}))
        missing = [(i, theta) for i in every for theta in places if (i, theta) not in self.evaluations]
        progress.plan(len(missing))
        found = dict(self.evaluations)
        for i, theta in missing:
            found[i, theta] = self.objective.evaluate(i, theta)
            progress(f"interval, s = {math.exp(theta):.5g}")
        return replace(self, frames=every, thetas=places, evaluations=found)

    @property
    def renders(self) -> int:
        """How many pictures were rendered for them."""
        return len(self.evaluations)

    def values(self) -> NDArray[np.float64]:
        """`[F, S]` losses."""
        return np.array([[self.evaluations[i, t].loss for t in self.thetas] for i in self.frames])

    def slopes(self) -> NDArray[np.float64]:
        """`[F, S]` derivatives by θ."""
        return np.array([[self.evaluations[i, t].slope for t in self.thetas] for i in self.frames])

    def dense(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """θ `[G]`, and every frame's curve `[F, G]`."""
        grid = np.union1d(np.linspace(self.thetas[0], self.thetas[-1], _GRID), self.thetas)
        return grid, hermite(np.array(self.thetas), self.values(), self.slopes(), grid)

    def minimum(self) -> float:
        """θ of the lowest point of the mean curve."""
        grid, curves = self.dense()
        return curve_minimum(grid, curves.mean(axis=0))

    def curvature(self, theta: float) -> float:
        """d²L/dθ² of the mean curve, from the slopes at the nodes on either side of θ."""
        k = int(np.clip(np.searchsorted(self.thetas, theta), 1, len(self.thetas) - 1))
        before, after = self.slopes().mean(axis=0)[k - 1 : k + 1]
        return float(after - before) / (self.thetas[k] - self.thetas[k - 1])

    def scan(self) -> Scan:
        """The losses as a record."""
        return Scan.of(np.array(self.thetas), self.values(), [self.objective.frames[i].name for i in self.frames])


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


def first_half_width(slopes: NDArray[np.float64], curvature: float, pixel: float) -> float:
    """Half-width in θ of the first curves: five standard errors of the minimum by the sandwich rule, 0.1 to 3 px of flow.

    Args:
        slopes: `[F]`, per frame at the minimum. curvature: of the mean loss there. pixel: θ that moves the picture by one pixel.
    """
    error = float(slopes.std(ddof=1)) / math.sqrt(len(slopes)) / curvature if len(slopes) > 1 and curvature > 0 else pixel
    return float(np.clip(5 * error, 0.1 * pixel, 3 * pixel))


@dataclass(frozen=True)
class Window:
    """Where curves are first drawn: `theta` ± `half_width`, with nodes no further apart than half a `pixel` of flow (all in θ)."""

    theta: float
    half_width: float
    pixel: float

    def nodes(self) -> list[float]:
        """θ of the nodes: over half a pixel of flow a curve is much like a cubic."""
        count = max(2, math.ceil(4 * self.half_width / self.pixel) + 1)
        return np.linspace(self.theta - self.half_width, self.theta + self.half_width, count).tolist()


def widened(
    curves: LocalCurves, frames: Sequence[int], start: Window, seed: int, progress: RenderProgress
) -> tuple[LocalCurves, bool]:
    """Extend the curves, from the first window on and doubling it, until the resampled minima lie inside.

    Returns:
        The curves, and whether the minima do lie inside; else the loss is flat as far as was looked.
    """
    start = replace(start, half_width=min(start.half_width, _FARTHEST / 4))
    block, thetas = block_length(len(frames)), start.nodes()
    for doubling in range(_MOST_DOUBLINGS):
        curves = curves.extended(progress, frames=frames, thetas=thetas)
        grid, dense = curves.dense()
        minima = resampled_minima(grid, dense, seed, block)
        inside = np.mean((minima > grid[0]) & (minima < grid[-1]))
        best = curve_minimum(grid, dense.mean(axis=0))
        if inside > 0.99 and grid[0] < best < grid[-1]:
            return curves, True
        reach = start.half_width * 2 ** (doubling + 1)
        if reach > _FARTHEST:
            break
        thetas = [start.theta - reach, start.theta + reach]
    return curves, False


def settled(curves: LocalCurves, half_width: float, progress: RenderProgress) -> LocalCurves:
    """The curves with the loss itself evaluated at their minimum: between far-apart nodes a cubic may dip where the loss does not.

    Args:
        half_width: of the first window, in θ; a node nearer to the minimum than a tenth of it will do.
    """
    for _ in range(_MOST_SETTLINGS):
        best = curves.minimum()
        if min(abs(best - theta) for theta in curves.thetas) < 0.1 * half_width:
            break
        curves = curves.extended(progress, thetas=[best])
    return curves
