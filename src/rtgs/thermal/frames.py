"""The photographs of a thermal fit: normalised, masked, each with its pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.records.capture import Frame
from rtgs.records.radiometry import LinearRange, PlanckRadiometry, PlanckRange, ThermalRange, Unit
from rtgs.records.scene import Scene

RANGE_PERCENTILE = 0.1  # the range of a capture: 0.1–99.9 percentile of its training thermal images


def training_range(scene: Scene) -> LinearRange:
    """The capture's fixed range: 0.1–99.9 percentile of the valid pixels of the training thermal images."""
    mask = scene.capture.thermal_mask
    values = np.concatenate([f.thermal[mask] for f in scene.train_frames])
    lo, hi = (float(v) for v in np.percentile(values, [RANGE_PERCENTILE, 100.0 - RANGE_PERCENTILE]))
    return LinearRange(lo, hi if hi > lo else lo + 1.0)


def color_range(scene: Scene) -> ThermalRange:
    """What the fitted colours are in: `training_range`, taken in radiance where the capture has Planck constants."""
    span, radiometry = training_range(scene), scene.capture.radiometry
    return PlanckRange.of(radiometry.calibration, span) if isinstance(radiometry, PlanckRadiometry) else span


@dataclass(frozen=True, eq=False)
class ThermalFrames:
    """Photographs that are fitted, and their poses.

    Attributes:
        names: of the F frames.
        images: F of `[h, w]`, in units of the colours; 0 where not valid.
        valid: `[h, w]`, the weight of each pixel, the same in all frames: 0 where it is masked, else how many pixels it stands for.
        poses: camera_from_world of the thermal camera, F of them.
        unit, unit_size: "°C" or "counts", and how many of them a difference of 1 in the middle of the range is.
    """

    names: tuple[str, ...]
    images: tuple[Tensor, ...]
    valid: Tensor
    poses: tuple[SE3, ...]
    unit: Unit = "°C"
    unit_size: float = 1.0

    @staticmethod
    def of(scene: Scene, frames: Sequence[Frame], sfm_per_metre: float, span: ThermalRange) -> ThermalFrames:
        """The thermal images of `frames`, in units of `span`, with thermal poses at a scale."""
        mask = scene.capture.thermal_mask
        return ThermalFrames(
            tuple(f.name for f in frames),
            tuple(torch.from_numpy(span.normalise(np.where(mask, f.thermal, span.lo))) for f in frames),
            torch.from_numpy(mask.astype(np.float32)),
            tuple(scene.thermal_from_world(f.name, sfm_per_metre) for f in frames),
            scene.capture.radiometry.unit,
            float(np.diff(span.expand(np.array([0.495, 0.505])))[0]) / 1e-2,
        )

    def rows(self, every: int) -> ThermalFrames:
        """Only rows `every // 2 :: every` of the images, as in `Camera.rows`. Each stands for `every` rows."""
        some = slice(every // 2, None, every)
        return replace(self, images=tuple(i[some].contiguous() for i in self.images), valid=every * self.valid[some])

    def __len__(self) -> int:
        return len(self.names)
