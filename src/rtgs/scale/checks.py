"""What is asked of the images beside the scale itself: how soft they are, whether they show it at all, and which frames disagree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rtgs.scale.bracket import Bracket
from rtgs.scale.objective import Objective
from rtgs.scale.progress import RenderProgress
from rtgs.scale.resampling import UNLIKELY, significance
from rtgs.scale.scan import losses_over
from rtgs.scale.thermal_targets import EPSILON_FRAMES, Pictures, some_of

_BLURS = (0.0, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.3, 16.0)  # pixels
_AROUND = (-4.0, -2.0, 0.0, 2.0, 4.0)  # coarse pixels of flow from the answer
_FAR = 2.0  # coarse pixels of flow: a frame whose own minimum is so far off disagrees
_CLEAR = 0.25  # of the median frame's depth, by which its own minimum has to be lower


class Softness(NamedTuple):
    """By how much thermal images are softer than renders: standard deviation of a Gaussian, in pixels. renders: pictures rendered."""

    blur_px: float
    renders: int


class Better(NamedTuple):
    """Whether the answer is clearly better than no baseline. renders: pictures rendered."""

    clearly: bool
    renders: int


class Disagreement(NamedTuple):
    """Names of the frames that disagree. renders: pictures rendered."""

    frames: tuple[str, ...]
    renders: int


def softness(objective: Objective, indices: Sequence[int], theta: float, progress: RenderProgress) -> Softness:
    """The blur under which a few renders agree best with the thermal images; 0 where no blur is clearly better than none.

    A calibration that is wrong looks soft as well.
    """
    chosen = some_of(indices, EPSILON_FRAMES)
    progress.plan(len(chosen))
    losses = []
    for i in chosen:
        losses.append(objective.loss_over_blur(i, theta, _BLURS))
        progress("blur")
    curves = np.array(losses)
    best = int(curves.mean(axis=0).argmin())
    clear = best and significance(curves[:, 0] - curves[:, best]) >= UNLIKELY
    return Softness(_BLURS[best] if clear else 0.0, len(chosen))


def better_than_none(
    objective: Objective, indices: Sequence[int], theta: float, bracket: Bracket, progress: RenderProgress
) -> Better:
    """Do the images fit a scale clearly better than no baseline at all, which is half a pixel of flow?"""
    progress.plan(2 * len(indices))
    gains = []
    for i in indices:
        losses = []
        for at in (math.log(bracket.lower), theta):
            losses.append(objective.loss(i, at))
            progress("no baseline")
        gains.append(losses[0] - losses[1])
    return Better(significance(np.array(gains)) >= UNLIKELY, 2 * len(indices))


def disagreeing(
    pictures: Pictures, halved: int, indices: Sequence[int], theta: float, bracket: Bracket, progress: RenderProgress
) -> Disagreement:
    """Frames that place their minimum elsewhere: two coarse pixels of flow or more away, and clearly.

    "Clearly" is measured by how deep the frames' curves are about the answer: a frame's own minimum lies below its loss at the answer by
    a quarter of the median frame's depth.

    Args:
        halved: how often the pictures are halved; their pixels are the coarse ones.
    """
    flow = bracket.flow_px(theta) / 2**halved
    steps = np.array([step for step in _AROUND if flow + step > 0])
    progress.plan(len(steps) * len(indices))
    curves = losses_over(theta + np.log1p(steps / flow), pictures.objective(halved), indices, progress, "frames")
    here = curves[:, np.flatnonzero(steps == 0)[0]]
    depth = float(np.median(np.median(curves, axis=1) - here))
    far = (np.abs(steps[curves.argmin(axis=1)]) >= _FAR) & (here - curves.min(axis=1) > _CLEAR * depth)
    names = [pictures.frames[i].name for i, apart in zip(indices, far, strict=True) if apart]
    return Disagreement(tuple(names) if depth > 0 else (), curves.size)
