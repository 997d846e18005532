"""Drift of the photographs: an offset for each frame, and a gain about the scene's median.

    photograph_f = s + offset_f + gain_f · (image_f − s)

Offsets come from the camera's zero, which moves between two of its calibrations; gains from automatic gain control. The solvers eliminate
offsets exactly: neighbouring frames share nearly everything, and slow drift along a path would take very many turns of alternation.
Gains multiply the unknowns, so they are estimated between solves, from the images of the solve before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rtgs.config import DriftKind
from rtgs.records.radiometry import ThermalRange


@dataclass(frozen=True, eq=False)
class Drift:
    """Drift of F frames, in units of the range.

    Attributes:
        level: the scene's median, s.
        gain, offset: `[F]`.
    """

    level: float
    gain: Tensor
    offset: Tensor

    def of(self, frame: int, image: Tensor) -> Tensor:
        """What the frame shows of an image of the scene."""
        return self.level + self.offset[frame] + self.gain[frame] * (image - self.level)

    def by_frame(self, names: Sequence[str], span: ThermalRange) -> dict[str, tuple[float, float]]:
        """As `SensorModel.drift`: photograph = gain · image + offset, in the units of `span.linear`."""
        level, width = span.linear.lo + self.level * span.linear.width, span.linear.width
        gains, offsets = self.gain.tolist(), self.offset.tolist()
        return {n: (g, level * (1.0 - g) + width * o) for n, g, o in zip(names, gains, offsets, strict=True)}


def estimate_drift(
    kind: DriftKind,
    level: float,
    images: Sequence[Tensor],
    photographs: Sequence[Tensor],
    weights: Sequence[Tensor],
    *,
    gain_limits: tuple[float, float],
) -> Drift:
    """Drift at given images of the scene, by weighted least squares for each frame. The gauge is not fixed (`in_gauge`).

    Args:
        level: the scene's median.
        images, photographs, weights: `[h, w]` for each of F frames.
    """
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
    return Drift(level, gain.clamp(*gain_limits), offset)


def in_gauge(drift: Drift) -> tuple[Drift, float, float]:
    """The same drift with median log-gain 0 and median offset 0.

    Photographs do not change if the images become `s + offset + gain · (image − s)`.

    Returns:
        The drift in that gauge, and `gain` and `offset` of the images.
    """
    gain = float(drift.gain.log().median().exp())
    scaled = drift.gain / gain
    offset = float((drift.offset / scaled).median())
    # With I' = s + O + G (I − s), the photograph s + o + g (I − s) is s + (o − g/G · O) + g/G · (I' − s).
    return Drift(drift.level, scaled, drift.offset - scaled * offset), gain, offset
