"""What the scale's rivals have in common: a loss of a gray render against one thermal image, and its slope."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rtgs.scale import Objective


class ImageLoss(Protocol):
    """A loss against one fixed thermal image; the less, the better."""

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        """The loss of a gray render `[h, w]`, and its derivative where the render changes by `tangent` `[h, w]`."""


LossOf = Callable[[NDArray[np.float32], NDArray[np.bool_]], ImageLoss]
"""(thermal image `[h, w]` in [0, 1], valid pixels `[h, w]` bool) → its loss."""


@dataclass(frozen=True)
class Rival:
    """A loss of pictures that Adam may descend in θ = ln s, with the paper's rate and number of steps.

    Attributes:
        key: in file names. title: in tables.
        loss: prepares the loss against a thermal image.
        smooth_px: pixels of flow over which its slope along θ changes hardly; None where that is noisy at any distance.
    """

    key: str
    title: str
    loss: LossOf
    smooth_px: float | None = None

    @property
    def smooth(self) -> bool:
        return self.smooth_px is not None

    def objective(
        self, pictures: Objective, thermal: Mapping[str, NDArray[np.float32]], mask: NDArray[np.bool_]
    ) -> RivalObjective:
        """The rival's loss of the pictures that an `Objective` renders; `thermal`: frame name → image in [0, 1]."""
        return RivalObjective(pictures, [self.loss(thermal[f.name], mask) for f in pictures.frames])


class RivalObjective:
    """Per-frame losses and slopes by θ; what `rtgs.scale.adam.descend_by_adam` descends."""

    def __init__(self, pictures: Objective, losses: Sequence[ImageLoss]) -> None:
        self.frames = pictures.frames
        self._pictures, self._losses = pictures, losses

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        return self._losses[index](*self._pictures.picture(index, theta))
