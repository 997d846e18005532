"""Gauss–Newton with a line search, for one unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rtgs.scale.objective import FrameLoss
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import Step

_MOST_STEPS = 12


class Evaluable(Protocol):
    """Per-frame losses with slope and curvature by θ, such as `Objective`."""

    def evaluate(self, index: int, theta: float) -> FrameLoss: ...


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


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended, and all places it evaluated. renders: how many pictures that took."""

    place: Place
    steps: tuple[Step, ...]
    renders: int


def descend(
    objective: Evaluable,
    indices: Sequence[int],
    theta: float,
    *,
    pixel: float,
    tolerance: float,
    progress: RenderProgress | None = None,
) -> Descent:
    """Go down the mean loss of some frames from θ.

    The first step is Gauss–Newton's, but no shorter than half a pixel. Its curvature is that of the residuals alone, which is far too
    large where the two modalities disagree (a hundredfold on a noisy sensor): the step would be tiny, and the descent would end far
    from the minimum. From the second step on the change of the slopes takes its place. A step is taken only where it lowers the loss
    (Eq. 7 of the pictures compared). Otherwise it is cut to where the two slopes put the minimum, or to half its length.

    Args:
        pixel: change of θ that moves the picture by a pixel, the longest step. tolerance: a step shorter than this is the last.
        progress: counts the pictures.
    """
    steps: list[Step] = []

    def evaluate(at: float) -> Place:
        found = []
        for i in indices:
            found.append(objective.evaluate(i, at))
            if progress is not None:
                progress(f"s = {math.exp(at):.5g}")
        losses, slopes, curvatures = (np.array([getattr(e, k) for e in found]) for k in ("loss", "slope", "curvature"))
        place = Place(at, losses, slopes, float(curvatures.mean()))
        steps.append(Step(at, place.loss, place.slope))
        return place

    here = evaluate(theta)
    if here.slope == 0.0 or not here.curvature > 0.0:
        return Descent(here, tuple(steps), len(steps) * len(indices))
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
        # Where the loss is concave the minimum lies further away: take the longest step.
        curvature = change if change > 0 else abs(here.slope) / pixel
        if abs(step) <= tolerance or here.slope == 0.0:
            break
    return Descent(replace(here, curvature=curvature), tuple(steps), len(steps) * len(indices))
