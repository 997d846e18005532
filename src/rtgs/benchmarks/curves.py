"""Slopes of losses over the scale, rendered where a solver comes by, and a solver replayed on them.

In one dimension the loss curve *is* the problem: one picture with its tangent at a scale gives every loss, of every perturbation of the
thermal images that leaves the cameras alone, its slope there. A full-batch run of Adam on slopes interpolated between such nodes is the
run itself but for the error of that.

**Not by cubics.** A Hermite curve through values and slopes would have other slopes than those that Adam sees, however fine the nodes: a
render jumps where a Gaussian falls below the cut-off or two change places, values contain these jumps and slopes do not.

**Smoothed.** With the paper's ε = 1e-6 the gradients of flat areas are unit vectors that turn at the least change of the render. The
slope of the mean loss then carries noise that is new every 0.02 % of s, which a run averages over its steps but an interpolation would
keep: so where a run settles there are eight nodes for one, and a line is fitted through those in reach.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtgs.baselines import ImageLoss
from rtgs.config import ScaleConfig
from rtgs.scale import History, Objective, adam

DENSER = 8  # nodes for one where a run settles
SMOOTH_STRIDE = 4  # one node for so many where the loss is smooth
_LAST_STEPS = 40  # a run that moves further than a node's distance in these has not settled
_MOST_ROUNDS = 5


class Curves:
    """Per-frame losses and slopes by θ of several losses, at nodes that are rendered on demand.

    Args:
        pictures: renders the frames.
        losses: key → one loss a frame, in the order of `pictures.frames`.
        spacing: of the nodes, in `sfm_per_metre`.
    """

    def __init__(self, pictures: Objective, losses: Mapping[str, Sequence[ImageLoss]], spacing: float) -> None:
        self.spacing = spacing
        self._pictures, self._losses = pictures, losses
        self._nodes: dict[int, dict[str, NDArray[np.float64]]] = {}
        self._render_s, self._loss_s = 0.0, dict.fromkeys(losses, 0.0)

    @property
    def renders(self) -> int:
        return len(self._nodes) * len(self._pictures.frames)

    def seconds_each(self, key: str) -> float:
        """Processor seconds of one picture with its tangent, and of one loss of it."""
        return (self._render_s + self._loss_s[key]) / max(self.renders, 1)

    def node(self, index: int, key: str) -> NDArray[np.float64]:
        """`[F, 2]`: losses and slopes of the frames at s = index · spacing / `DENSER`, index at least 1."""
        if index not in self._nodes:
            self._nodes[index] = self._render(math.log(index * self.spacing / DENSER))
        return self._nodes[index][key]

    def there(self, low: float, high: float) -> list[int]:
        """Indices of the nodes there are with low < s < high."""
        unit = self.spacing / DENSER
        return [
            k for k in range(math.floor(low / unit), math.ceil(high / unit) + 1) if k in self._nodes and low < k * unit < high
        ]

    def _render(self, theta: float) -> dict[str, NDArray[np.float64]]:
        found = {key: np.empty((len(self._pictures.frames), 2)) for key in self._losses}
        for i in range(len(self._pictures.frames)):
            started = time.process_time()
            gray, tangent = self._pictures.picture(i, theta)
            self._render_s += time.process_time() - started
            for key, losses in self._losses.items():
                started = time.process_time()
                found[key][i] = losses[i](gray, tangent)
                self._loss_s[key] += time.process_time() - started
        return found


@dataclass(frozen=True)
class _Mean:
    """The mean over some frames as one frame, for the solver."""

    curves: Curves
    key: str
    chosen: Sequence[int] | None
    stride: int = 1
    frames: Sequence[str] = ("mean",)
    _means: dict[int, NDArray[np.float64]] = field(default_factory=dict)

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        """By a line or parabola fitted to the nodes within a spacing, weights falling linearly to zero: two nodes are interpolated."""
        s, spacing = math.exp(theta), self.curves.spacing
        s = max(s, spacing)  # below the first node: as there
        near = self.curves.there(s - spacing, s + spacing)
        unit = spacing / DENSER
        if self.stride == 1 or not near or not near[0] * unit <= s <= near[-1] * unit:
            spacing *= self.stride
            k = math.floor(s / spacing)
            for edge in (k, k + 1):
                self.curves.node(max(1, edge * self.stride) * DENSER, self.key)
            near = self.curves.there(s - spacing, s + spacing)
        apart = np.array([j * unit - s for j in near])
        values = np.array([self._mean(j) for j in near])
        weights = np.sqrt(1.0 - np.abs(apart) / spacing)
        # A parabola where there are nodes for one; at its own place it is its constant term.
        powers = np.vander(apart / spacing, 3 if len(near) > 4 else 2, increasing=True)
        (loss, slope), *_ = np.linalg.lstsq(powers * weights[:, None], values * weights[:, None], rcond=None)[0]
        return float(loss), float(slope)

    def densify(self, theta: float) -> bool:
        """Have all nodes within a spacing of θ; whether any was missing."""
        before = self.curves.renders
        middle = round(math.exp(theta) / self.curves.spacing * DENSER)
        for j in range(max(1, middle - DENSER), middle + DENSER + 1):
            self.curves.node(j, self.key)
        return self.curves.renders > before

    def _mean(self, node: int) -> NDArray[np.float64]:
        if node not in self._means:
            found = self.curves.node(node, self.key)
            self._means[node] = (found if self.chosen is None else found[list(self.chosen)]).mean(axis=0)
        return self._means[node]


def replay(
    curves: Curves,
    key: str,
    theta: float,
    config: ScaleConfig,
    frames: Sequence[int] | None = None,
    *,
    smooth: bool = False,
) -> tuple[float, History]:
    """Adam (`rtgs.scale.adam`, full batches) from θ: what it would have come to, had it rendered at every step.

    Args:
        frames: indices; all when None.
        smooth: fewer nodes do.
    """
    for _ in range(_MOST_ROUNDS):
        mean = _Mean(curves, key, frames, SMOOTH_STRIDE if smooth else 1)
        found, history = adam(mean, theta, config)
        on_the_way = abs(math.exp(found) - history.sfm_per_metre[-_LAST_STEPS:][0]) > curves.spacing
        if on_the_way or not mean.densify(found):
            break
    return found, history
