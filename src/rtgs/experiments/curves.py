"""Slopes of losses over the scale, rendered where a solver asks for them, and Adam replayed on them.

The loss has one unknown. One picture with its tangent at a scale gives the slope of every loss there, against every variant of the
thermal images that leaves the cameras alone. Adam sees nothing but slopes, so a run of it can be replayed on slopes from the renders of
other runs. There are two kinds of loss.

**Smooth losses** are interpolated linearly between nodes of a lattice. Where a run settles, nodes are added until it stays.

**Noisy losses** are rendered at each step of a run. With the paper's ε = 1e-6 the gradients of flat areas are unit vectors that turn at
the least change of the render. The slope of the mean loss then carries noise that is new every 0.02 % of s, often larger than the slope
itself. A run averages this noise over its steps; an interpolation would freeze it and so invent minima.

Cubics through values and slopes (Hermite) suit neither kind. A render jumps where a Gaussian falls below the cut-off or two change
places. Values contain these jumps and slopes do not, so a cubic has other slopes than those that Adam sees, however fine the nodes.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_right, insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtgs.config import ScaleConfig
from rtgs.experiments.rivals import ImageLoss, Rival
from rtgs.scale import Objective
from rtgs.scale.adam import AdamPath, descend_by_adam

_SETTLED = 2e-5  # in θ
_MOST_ROUNDS = 6


class Curves:
    """Per-frame losses and slopes by θ of several losses, at nodes that are rendered on demand.

    Args:
        pictures: renders the frames.
        losses: key → (rival, one loss a frame in the order of `pictures.frames`).
        pixel: what moves the pictures by about a pixel, in `sfm_per_metre`.
    """

    def __init__(self, pictures: Objective, losses: Mapping[str, tuple[Rival, Sequence[ImageLoss]]], pixel: float) -> None:
        self.pixel, self.renders = pixel, 0
        self._pictures, self._losses = pictures, losses
        self._found: dict[str, dict[float, NDArray[np.float64]]] = {key: {} for key in losses}
        self._places: dict[str, list[float]] = {key: [] for key in losses}
        self._render_s = 0.0
        self._loss_s = dict.fromkeys(losses, (0, 0.0))

    def rival(self, key: str) -> Rival:
        return self._losses[key][0]

    def seconds_each(self, key: str) -> float:
        """Processor seconds of one picture with its tangent, and of one loss of it."""
        count, seconds = self._loss_s[key]
        return self._render_s / max(self.renders, 1) + seconds / max(count, 1)

    def node(self, s: float, key: str) -> NDArray[np.float64]:
        """`[F, 2]`: losses and slopes of the frames at s. A noisy loss has only noisy ones evaluated beside it."""
        if s not in self._found[key]:
            self._render(s, [k for k, (rival, _) in self._losses.items() if not (rival.smooth and not self.rival(key).smooth)])
        return self._found[key][s]

    def around(self, key: str, s: float) -> tuple[float | None, float | None]:
        """The next nodes of a loss: the last at or below s, the first above."""
        places = self._places[key]
        k = bisect_right(places, s)
        return places[k - 1] if k else None, places[k] if k < len(places) else None

    def _render(self, s: float, keys: Sequence[str]) -> None:
        keys = [key for key in keys if s not in self._found[key]]
        found = {key: np.empty((len(self._pictures.frames), 2)) for key in keys}
        for i in range(len(self._pictures.frames)):
            started = time.process_time()
            gray, tangent = self._pictures.picture(i, math.log(s))
            self._render_s += time.process_time() - started
            self.renders += 1
            for key in keys:
                started = time.process_time()
                found[key][i] = self._losses[key][1][i](gray, tangent)
                count, seconds = self._loss_s[key]
                self._loss_s[key] = count + 1, seconds + time.process_time() - started
        for key in keys:
            self._found[key][s] = found[key]
            insort(self._places[key], s)


@dataclass(frozen=True)
class _Mean:
    """The mean over some frames as one frame, for the solver."""

    curves: Curves
    key: str
    chosen: Sequence[int] | None
    frames: Sequence[str] = ("mean",)
    _means: dict[float, NDArray[np.float64]] = field(default_factory=dict)

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        smooth_px, s = self.curves.rival(self.key).smooth_px, math.exp(theta)
        found = self.mean(s) if smooth_px is None else self._smooth(s, smooth_px * self.curves.pixel)
        return float(found[0]), float(found[1])

    def mean(self, s: float) -> NDArray[np.float64]:
        """`[2]`: loss and slope at a node."""
        if s not in self._means:
            found = self.curves.node(s, self.key)
            self._means[s] = (found if self.chosen is None else found[list(self.chosen)]).mean(axis=0)
        return self._means[s]

    def _smooth(self, s: float, spacing: float) -> NDArray[np.float64]:
        s = max(s, spacing)  # below the lattice: as at its first node
        left, right = self.curves.around(self.key, s)
        if left is None or right is None or right - left > 1.001 * spacing:
            k = max(1, math.floor(s / spacing))
            self.mean(k * spacing), self.mean((k + 1) * spacing)
            left, right = self.curves.around(self.key, s)
        assert left is not None and right is not None
        share = (s - left) / (right - left)
        return (1.0 - share) * self.mean(left) + share * self.mean(right)


def replay(curves: Curves, key: str, theta: float, config: ScaleConfig, frames: Sequence[int] | None = None) -> AdamPath:
    """Adam (`rtgs.scale.adam.descend_by_adam`, full batches) from θ: where it would have gone, had it rendered at every step.

    Args:
        frames: indices; all when None.
    """
    mean, before = _Mean(curves, key, frames), math.inf
    for _ in range(_MOST_ROUNDS):
        path = descend_by_adam(mean, theta, config)
        if not curves.rival(key).smooth or abs(path.theta - before) < _SETTLED:
            break
        before = path.theta
        mean.mean(math.exp(path.theta))
    return path
