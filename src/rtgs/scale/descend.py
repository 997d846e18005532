"""Gauss–Newton with a line search, for one unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.scale.objective import Objective
from rtgs.scale.records import Counter, History

_MOST_STEPS = 12


@dataclass(frozen=True, eq=False)
class Place:
    """A scale and what the frames say there.

    Attributes:
        losses, slopes: `[F]`, of each frame. curvature: d²L/dθ² of their mean, as the last two points show it.
    """

    theta: float
    losses: NDArray[np.float64]
    slopes: NDArray[np.float64]
    curvature: float

    @property
    def loss(self) -> float:
        return float(self.losses.mean())

    @property
    def slope(self) -> float:
        return float(self.slopes.mean())


def descend(
    objective: Objective,
    indices: Sequence[int],
    theta: float,
    *,
    pixel: float,
    tolerance: float,
    counter: Counter,
    history: History,
) -> Place:
    """Go down the mean loss of some frames from θ.

    The first step is Gauss–Newton's, but no shorter than half a pixel: its curvature is that of the residuals alone, far too large where
    the two modalities disagree (a hundredfold on a noisy sensor), so that the step would be nothing and pass for arrival. From the
    second step on the slopes' own change takes its place. A step is taken only where it lowers the loss (Eq. 7 of the pictures
    compared); else it is cut to where the two slopes, or half the way, put the minimum.

    Args:
        pixel: change of θ that moves the picture by a pixel, the longest step. tolerance: a step shorter than this is the last.
    """

    def evaluate(at: float) -> Place:
        found = []
        for i in indices:
            found.append(objective.evaluate(i, at))
            counter(f"s = {np.exp(at):.5g}")
        losses, slopes, curvatures = (np.array([getattr(e, k) for e in found]) for k in ("loss", "slope", "curvature"))
        history.add(at, float(losses.mean()), float(slopes.mean()))
        return Place(at, losses, slopes, float(curvatures.mean()))

    here = evaluate(theta)
    if here.slope == 0.0 or not here.curvature > 0.0:
        return here
    curvature = min(here.curvature, abs(here.slope) / (0.5 * pixel))
    for _ in range(_MOST_STEPS):
        step = float(np.clip(-here.slope / curvature, -pixel, pixel))
        there = evaluate(here.theta + step)
        while there.loss >= here.loss and abs(step) > tolerance:
            crossing = step * here.slope / (here.slope - there.slope) if there.slope * here.slope < 0 else 0.5 * step
            step = float(np.clip(crossing / step, 0.1, 0.7)) * step
            there = evaluate(here.theta + step)
        change = (there.slope - here.slope) / step
        if there.loss >= here.loss:
            break
        here = there
        # Concave ground has its minimum further on: go as far as allowed.
        curvature = change if change > 0 else abs(here.slope) / pixel
        if abs(step) <= tolerance or here.slope == 0.0:
            break
    return replace(here, curvature=curvature)
