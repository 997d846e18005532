"""What a frame adds of its own: an offset, and a gain about the scene's median, between two of the camera's calibrations or by its
automatic gain control.

    photograph_f = s + offset_f + gain_f · (image_f − s)

Offsets are eliminated from the least squares rather than alternated with the colours: neighbouring frames share nearly everything, and
what drifts slowly along a path would take alternation very many turns. Gains multiply what is sought, and do alternate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from rtgs.records.radiometry import ThermalRange

Kind = Literal["off", "offset", "gain-offset"]
GAINS = (0.5, 2.0)  # no automatic gain control that is of use goes further; a frame without contrast could go anywhere


@dataclass(frozen=True, eq=False)
class Drift:
    """`gain` and `offset` `[F]`, in units of the range, about `level`, the scene's median."""

    level: float
    gain: Tensor
    offset: Tensor

    def of(self, frame: int, image: Tensor) -> Tensor:
        """What the frame shows of an image of the scene."""
        return self.level + self.offset[frame] + self.gain[frame] * (image - self.level)

    def only(self, frames: Sequence[int]) -> Drift:
        return Drift(self.level, self.gain[frames], self.offset[frames])

    def by_frame(self, names: Sequence[str], span: ThermalRange) -> dict[str, tuple[float, float]]:
        """`ThermalModel.drift`: photograph = gain · image + offset."""
        level, width = span.linear.lo + self.level * span.linear.width, span.linear.width
        gains, offsets = self.gain.tolist(), self.offset.tolist()
        return {n: (g, level * (1.0 - g) + width * o) for n, g, o in zip(names, gains, offsets, strict=True)}


def estimate(
    kind: Kind, level: float, images: Sequence[Tensor], photographs: Sequence[Tensor], weights: Sequence[Tensor]
) -> Drift:
    """Weighted least squares, frame by frame; before the gauge is fixed. All `[h, w]`."""
    gain, offset = torch.ones(len(images)), torch.zeros(len(images))
    for f, (image, photograph, w) in enumerate(zip(images, photographs, weights, strict=True)):
        total = float(w.sum())
        if kind == "off" or total == 0:
            continue
        mean, target = float((w * image).sum()) / total, float((w * photograph).sum()) / total
        if kind == "gain-offset":
            away = w * (image - mean)
            gain[f] = float((away * (photograph - target)).sum()) / max(float((away * (image - mean)).sum()), 1e-12)
        offset[f] = target - level - gain[f] * (mean - level)
    return Drift(level, gain.clamp(*GAINS), offset)


def in_gauge(drift: Drift) -> tuple[Drift, float, float]:
    """The same with median log-gain 0 and median offset 0, and what the images have to become: `s + offset + gain · (image − s)`.

    Returns:
        The drift, and that gain and offset.
    """
    gain = float(drift.gain.log().median().exp())
    scaled = drift.gain / gain
    offset = float((drift.offset / scaled).median())
    # With I' = s + O + G (I − s), the photograph s + o + g (I − s) is s + (o − g/G · O) + g/G · (I' − s).
    return Drift(drift.level, scaled, drift.offset - scaled * offset), gain, offset
