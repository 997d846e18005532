"""Loss curves over the scale, rendered where a solver comes by, and a solver replayed on them.

In one dimension the loss curve *is* the problem: one picture with its tangent at a scale gives every loss, of every perturbation of the
thermal images that leaves the cameras alone, its value and slope there. Between two such nodes a curve is the cubic with these values
and slopes (Hermite), in s. A full-batch run of Adam on the curves is the run itself but for the error of the cubics, and where the run
settles the nodes are halved until the answer stands still.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.baselines import ImageLoss
from rtgs.config import ScaleConfig
from rtgs.scale import History, Objective, adam

_SETTLED = 5e-5  # in θ: the answer no longer depends on the nodes
_SETTLED_SHARE = 0.01  # of the way of the watched steps, for runs that are still under way when they end
_MOST_HALVINGS = 4
_WATCHED_STEPS = 60  # of the run's end: where nodes are halved


class Curves:
    """Per-frame losses and slopes of several losses, at nodes that are rendered on demand.

    Args:
        pictures: renders the frames.
        losses: key → one loss a frame, in the order of `pictures.frames`.
        spacing: of the nodes, in `sfm_per_metre`.
    """

    def __init__(self, pictures: Objective, losses: Mapping[str, Sequence[ImageLoss]], spacing: float) -> None:
        self._pictures, self._losses, self._spacing = pictures, losses, spacing
        self._nodes: dict[float, dict[str, NDArray[np.float64]]] = {}
        self._halved: set[tuple[int, int]] = set()
        self._render_s, self._loss_s = 0.0, dict.fromkeys(losses, 0.0)

    @property
    def renders(self) -> int:
        return len(self._nodes) * len(self._pictures.frames)

    def seconds_each(self, key: str) -> float:
        """Processor seconds of one picture with its tangent, and of one loss of it."""
        return (self._render_s + self._loss_s[key]) / max(self.renders, 1)

    def at(self, key: str, theta: float, frames: Sequence[int] | None = None) -> tuple[float, float]:
        """The mean loss over the frames (all when None) and its slope by θ."""
        s = math.exp(theta)
        level, k = self._cell(s)
        left, right = (self._node(edge * self._spacing / 2**level, key, frames) for edge in (k, k + 1))
        width = self._spacing / 2**level
        t = s / width - k
        # Values and slopes by s at both ends of the cell; slopes by θ are s times these.
        a, b = left[0], right[0]
        p, q = left[1] / (k * width) * width, right[1] / ((k + 1) * width) * width
        value = a * (1 + 2 * t) * (1 - t) ** 2 + b * t**2 * (3 - 2 * t) + p * t * (1 - t) ** 2 + q * t**2 * (t - 1)
        slope = 6 * t * (t - 1) * (a - b) + p * (1 - t) * (1 - 3 * t) + q * t * (3 * t - 2)
        return float(value), float(slope * s / width)

    def halve(self, thetas: Sequence[float]) -> None:
        """Halve the cells in which these lie."""
        self._halved |= {self._cell(math.exp(theta)) for theta in thetas}

    def _cell(self, s: float) -> tuple[int, int]:
        """(level, index) of the smallest cell that holds s; level l has cells of spacing / 2^l. The first one begins at a spacing."""
        level, k = 0, max(1, math.floor(s / self._spacing))
        while (level, k) in self._halved:
            level += 1
            k = max(2**level, math.floor(s * 2**level / self._spacing))
        return level, k

    def _node(self, s: float, key: str, frames: Sequence[int] | None) -> NDArray[np.float64]:
        """`[2]`: loss and slope by θ, mean over frames."""
        if s not in self._nodes:
            self._nodes[s] = self._render(math.log(s))
        found = self._nodes[s][key]
        return (found if frames is None else found[list(frames)]).mean(axis=0)

    def _render(self, theta: float) -> dict[str, NDArray[np.float64]]:
        """Per-frame losses and slopes `[F, 2]` by key."""
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
    """The mean over frames as one frame, for the solver."""

    curves: Curves
    key: str
    chosen: Sequence[int] | None
    frames: Sequence[str] = ("mean",)

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        return self.curves.at(self.key, theta, self.chosen)


def replay(
    curves: Curves, key: str, theta: float, config: ScaleConfig, frames: Sequence[int] | None = None
) -> tuple[float, History]:
    """Adam (`rtgs.scale.adam`, full batches) on a curve from θ: what it would have come to, had it rendered at every step."""
    before = math.inf
    for _ in range(_MOST_HALVINGS + 1):
        found, history = adam(_Mean(curves, key, frames), theta, config)
        watched = [*(math.log(s) for s in history.sfm_per_metre[-_WATCHED_STEPS:]), found]
        if abs(found - before) < max(_SETTLED, _SETTLED_SHARE * abs(found - watched[0])):
            break
        before = found
        curves.halve(watched)
    return found, history
