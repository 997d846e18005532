"""The scan: the loss over the whole bracket at a coarse size, and its minima."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rtgs.scale.bracket import LOWEST_PX, Bracket
from rtgs.scale.objective import Objective
from rtgs.scale.progress import RenderProgress
from rtgs.scale.resampling import UNLIKELY, significance

_RATIO = 0.25  # by which neighbouring scales differ, where the flow is small
_MOST_OTHERS = 3


def scan_thetas(bracket: Bracket, coarse_pixel: int) -> NDArray[np.float64]:
    """θ over the bracket: neighbours are one coarse pixel of flow apart, or a ratio of 1.25 where the flow is small."""
    flows, most = [LOWEST_PX], LOWEST_PX * bracket.upper / bracket.lower
    while flows[-1] < most:
        flows.append(min(most, flows[-1] + min(float(coarse_pixel), _RATIO * flows[-1])))
    return np.log(np.array(flows) / LOWEST_PX * bracket.lower)


def losses_over(
    thetas: NDArray[np.float64], objective: Objective, indices: Sequence[int], progress: RenderProgress, text: str
) -> NDArray[np.float64]:
    """Losses `[F, S]` of some frames: one render each."""
    losses = np.empty((len(indices), len(thetas)))
    for j, theta in enumerate(thetas):
        for i, index in enumerate(indices):
            losses[i, j] = objective.loss(index, float(theta))
            progress(f"{text}, s = {math.exp(theta):.4g}")
    return losses


def local_minima(curves: NDArray[np.float64]) -> list[int]:
    """Samples that are lower than their neighbours in the mean of the curves `[F, S]`, ends included: the best, then others.

    Another one is returned where it is not significantly worse than the best, or at least half as deep below the curve's median. The
    second rule is there since a sample hits a narrow minimum more or less well, in all frames alike.
    """
    mean = curves.mean(axis=0)
    framed = np.concatenate([[np.inf], mean, [np.inf]])
    found = sorted(np.flatnonzero((mean < framed[:-2]) & (mean <= framed[2:])).tolist(), key=lambda j: float(mean[j]))
    best, median = found[0], float(np.median(mean))
    others = [
        j
        for j in found[1:]
        if significance(curves[:, j] - curves[:, best]) < UNLIKELY or median - mean[j] > 0.5 * (median - mean[best])
    ]
    return [best, *others[:_MOST_OTHERS]]
