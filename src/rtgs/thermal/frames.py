"""The photographs of a thermal fit: normalised, masked, each with its pose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.records.capture import Frame
from rtgs.records.radiometry import LinearRange, PlanckRadiometry, PlanckRange, ThermalRange, Unit
from rtgs.records.scene import Scene

RANGE_PERCENTILE = 0.1  # the range of a capture: 0.1–99.9 percentile of its training thermal images


def training_range(scene: Scene) -> LinearRange:
    """The capture's fixed range: 0.1–99.9 percentile of the valid pixels of the training thermal images."""
    mask = scene.capture.thermal_mask
    lo, hi = outer_percentiles((f.thermal[mask] for f in scene.train_frames), len(scene.train_frames) * int(mask.sum()))
    return LinearRange(lo, hi if hi > lo else lo + 1.0)


def outer_percentiles(
    parts: Iterable[NDArray[np.float32]], count: int, percentile: float = RANGE_PERCENTILE
) -> tuple[float, float]:
    """`np.percentile(…, [percentile, 100 − percentile])` of `count` values that come in parts. Only the outermost ones are kept."""
    place = (count - 1) * np.true_divide([percentile, 100.0 - percentile], 100)
    kept = min(int(place[0]) + 2, count)
    low, high = np.empty(0, np.float32), np.empty(0, np.float32)
    for part in parts:
        low, high = np.concatenate([low, part]), np.concatenate([high, part])
        if len(low) > kept:
            low, high = np.partition(low, kept - 1)[:kept], np.partition(high, len(high) - kept)[len(high) - kept :]
    low, high = np.sort(low), np.sort(high)
    first = count - len(high)  # place of the first of `high`
    return _between(low, place[0]), _between(high, place[1] - first)


def _between(ordered: NDArray[np.float32], place: float) -> float:
    """Linear interpolation, rounded as NumPy does it."""
    before = int(np.floor(place))
    share = place - before
    a, b = ordered[before], ordered[min(before + 1, len(ordered) - 1)]
    return float(a + (b - a) * share) if share < 0.5 else float(b - (b - a) * (1 - share))


def color_range(scene: Scene) -> ThermalRange:
    """What the fitted colours are in: `training_range`, taken in radiance where the capture has Planck constants."""
    span, radiometry = training_range(scene), scene.capture.radiometry
    return PlanckRange.of(radiometry.calibration, span) if isinstance(radiometry, PlanckRadiometry) else span


@dataclass(frozen=True, eq=False)
class ThermalFrames:
    """Photographs that are fitted, and their poses.

    Attributes:
        names: of the F frames.
        images: F of `[h, w]`, in units of the colours; 0 where not valid. Made anew at each access until `rows` is called.
        valid: `[h, w]`, the weight of each pixel, the same in all frames: 0 where it is masked, else how many pixels it stands for.
        poses: camera_from_world of the thermal camera, F of them.
        unit, unit_size: "°C" or "counts", and how many of them a difference of 1 in the middle of the range is.
    """

    names: tuple[str, ...]
    images: Sequence[Tensor]
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
            _Normalised(tuple(frames), mask, span),
            torch.from_numpy(mask.astype(np.float32)),
            tuple(scene.thermal_from_world(f.name, sfm_per_metre) for f in frames),
            scene.capture.radiometry.unit,
            float(np.diff(span.expand(np.array([0.495, 0.505])))[0]) / 1e-2,
        )

    def rows(self, every: int) -> ThermalFrames:
        """Only rows `every // 2 :: every` of the images, as in `Camera.rows`. Each stands for `every` rows. They are kept in memory."""
        some = slice(every // 2, None, every)
        return replace(self, images=tuple(i[some].contiguous() for i in self.images), valid=every * self.valid[some])

    def some(self, most: int) -> ThermalFrames:
        """At most so many of the frames, evenly spaced; all of them where they are no more."""
        chosen = np.unique(np.linspace(0, len(self) - 1, min(most, len(self))).round().astype(int)).tolist()
        if len(chosen) == len(self):
            return self
        names, poses = (tuple(values[f] for f in chosen) for values in (self.names, self.poses))
        return replace(self, names=names, poses=poses, images=tuple(self.images[f] for f in chosen))

    def __len__(self) -> int:
        return len(self.names)


class _Normalised(Sequence[Tensor]):
    """The thermal images of frames in units of `span`, made when they are asked for: the capture decides which are kept in memory."""

    def __init__(self, frames: Sequence[Frame], mask: NDArray[np.bool_], span: ThermalRange) -> None:
        self._frames, self._mask, self._span = frames, mask, span

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, frame: int) -> Tensor:  # type: ignore[override]
        span = self._span
        return torch.from_numpy(span.normalise(np.where(self._mask, self._frames[frame].thermal, span.lo)))

    def __iter__(self) -> Iterator[Tensor]:
        return (self[f] for f in range(len(self)))
