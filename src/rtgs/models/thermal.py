"""The thermal model: the RGB model's geometry with thermal colours, and what is known of each Gaussian's temperature."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import LinearRange, ThermalRange
from rtgs.renderer import RenderSettings, render


@dataclass(frozen=True, eq=False)
class GaussianTemperatures:
    """What the training views say of each Gaussian.

    Attributes:
        temperature, std: `[N]` float32, °C (or counts): what they see on average, and its standard error.
        views: `[N]` float32, how many of them see it.
    """

    temperature: NDArray[np.float32]
    std: NDArray[np.float32]
    views: NDArray[np.float32]


def between(drift: NDArray[np.float64], levels: NDArray[np.float64], at: int) -> NDArray[np.float64]:
    """What a frame without a drift of its own probably has: that of the frames before and after it, as far as neighbours agree at all.

    Args:
        drift: `[F, K]`, deviations from none, in the order of the frames. levels: `[F]`, what they do to the scene's level.
        at: how many of them come before the frame.

    Returns:
        `[K]`: the neighbours' mean times the levels' correlation from frame to frame, which a sensor that drifts slowly brings close
        to 1, and independent offsets to 0.
    """
    away = levels - levels.mean()
    alike = float(away[1:] @ away[:-1]) / max(float(away @ away), 1e-30)
    return np.asarray(max(0.0, alike) * drift[max(at - 1, 0) : at + 1].mean(axis=0))


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """The RGB model's geometry with thermal colours.

    Attributes:
        gaussians: C = 1, colours in the units of `color_range`.
        background: `[1]`, likewise.
        range: the capture's fixed range, °C (or counts, for a relative capture): what scores and pictures refer to.
        settings: how it has to be rendered.
        sfm_per_metre: the scale whose thermal poses it was fitted at.
        history: lists of equal length: "step", "loss".
        color_range: what colours 0 and 1 stand for; None: `range`. The linear fit begins it where no colour is below 0, so that the clamp
            of `render` and of every viewer never acts. Where there are Planck constants colours are linear in radiance and not in °C.
        drift: by training frame its gain and offset: photograph = gain · image + offset, in °C (or counts), or in a black body's signal
            where colours are linear in that; empty where none were fitted.
        pattern: `[h, w]`, what the sensor adds to every photograph, in the units of `drift`; None where none was found.
        temperatures: of each Gaussian, or None where nobody asked.
    """

    gaussians: Gaussians
    background: Tensor
    range: LinearRange
    settings: RenderSettings
    sfm_per_metre: float
    history: Mapping[str, Sequence[float]] = field(default_factory=dict)
    color_range: ThermalRange | None = None
    drift: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pattern: NDArray[np.float32] | None = None
    temperatures: GaussianTemperatures | None = None

    @property
    def colors(self) -> ThermalRange:
        """What colours 0 and 1 stand for."""
        return self.color_range or self.range

    def drift_of(self, frame: str) -> tuple[float, float]:
        """Gain and offset of a frame: its own, or what those before and after it in the order of names let expect (`between`)."""
        if frame in self.drift or not self.drift:
            return self.drift.get(frame, (1.0, 0.0))
        names, span = sorted(self.drift), self.colors.linear
        away = np.array([self.drift[name] for name in names]) - (1.0, 0.0)
        gain, offset = between(away, away @ (0.5 * (span.lo + span.hi), 1.0), bisect(names, frame))
        return 1.0 + float(gain), float(offset)

    def render(self, camera: Camera, camera_from_world: SE3, *, photographed_in: str | None = None) -> NDArray[np.float32]:
        """`[h, w]` temperatures in °C (or counts): the scene's, or as the camera would show them in a frame, with drift and pattern.

        Raises:
            ValueError: the pattern is of another size than the camera that is to show it.
        """
        with torch.no_grad():
            view = render(self.gaussians, camera, camera_from_world, settings=self.settings).over(self.background)
        colors = view[..., 0].numpy()
        return self.colors.expand(colors if photographed_in is None else self.shown(colors, photographed_in))

    def shown(self, colors: NDArray[np.float32], frame: str) -> NDArray[np.float32]:
        """What the camera makes of colours `[h, w]` in a frame, in the same units."""
        gain, offset = self.drift_of(frame)
        if (gain, offset) == (1.0, 0.0) and self.pattern is None:
            return colors
        span = self.colors.linear
        signal = gain * span.expand(colors).astype(np.float64) + offset
        if self.pattern is not None:
            if self.pattern.shape != signal.shape:
                raise ValueError(f"a pattern of {self.pattern.shape} pixels cannot be added to an image of {signal.shape}")
            signal += self.pattern
        return np.asarray(span.normalise(signal), np.float32)
