"""The thermal model: Gaussians with thermal colours, and what is known of each Gaussian's temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.models.sensor import SensorModel
from rtgs.records.camera import Camera
from rtgs.records.decision import Decision
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import LinearRange, ThermalRange, Unit
from rtgs.renderer import RenderSettings, render


@dataclass(frozen=True, eq=False)
class GaussianTemperatures:
    """A temperature for each Gaussian, from the training views.

    Attributes:
        temperature, std: `[N]` float32, in the model's unit: mean over the views that see the Gaussian, and its standard error.
        views: `[N]` float32, how many training views see it.
    """

    temperature: NDArray[np.float32]
    std: NDArray[np.float32]
    views: NDArray[np.float32]


@dataclass(frozen=True, eq=False, kw_only=True)
class ThermalModel:
    """Gaussians with thermal colours: the RGB model's, or finer ones made of these.

    Attributes:
        gaussians: C = 1, colours in the units of `color_range`.
        background: `[1]`, likewise.
        unit: "°C", or "counts" for a capture without radiometry. All values below are in this unit.
        range: the capture's fixed range: what scores and pictures refer to.
        color_range: what colours 0 and 1 stand for. The linear fit puts colour 0 below every colour of the model, so that the clamp of
            `render` and of every viewer never acts. With Planck constants, colours are linear in radiance and not in °C.
        settings: how the model has to be rendered.
        sfm_per_metre: the scale whose thermal poses it was fitted at.
        history: lists of equal length: "step", "loss".
        sensor: drift and pattern of the sensor, in the units of `color_range.linear`.
        temperatures: of each Gaussian; None where they were not asked for.
        decisions: what the fit decided by itself, and why.
    """

    gaussians: Gaussians
    background: Tensor
    unit: Unit
    range: LinearRange
    color_range: ThermalRange
    settings: RenderSettings
    sfm_per_metre: float
    history: Mapping[str, Sequence[float]] = field(default_factory=dict)
    sensor: SensorModel = field(default_factory=SensorModel)
    temperatures: GaussianTemperatures | None = None
    decisions: tuple[Decision, ...] = ()

    def drift_of(self, frame: str) -> tuple[float, float]:
        """Gain and offset of a frame: its own, or those predicted from its neighbours (`SensorModel.drift_of`)."""
        return self.sensor.drift_of(frame, self._level)

    def render(self, camera: Camera, camera_from_world: SE3, *, photographed_in: str | None = None) -> NDArray[np.float32]:
        """`[h, w]` temperatures, in `unit`.

        Args:
            photographed_in: a frame's name: add the sensor's drift in that frame and its pattern, as the camera would show the scene.
                None: the scene itself.

        Raises:
            RtgsError: the pattern is of another size than the camera that is to show it.
        """
        with torch.no_grad():
            view = render(self.gaussians, camera, camera_from_world, settings=self.settings).over(self.background)
        colors = view[..., 0].numpy()
        if photographed_in is None or not self.sensor.changes(photographed_in, self._level):
            return self.color_range.expand(colors)
        span = self.color_range.linear
        photograph = self.sensor.shown(span.expand(colors), photographed_in, self._level)
        return self.color_range.expand(np.asarray(span.normalise(photograph), np.float32))

    @property
    def _level(self) -> float:
        """The middle of the colours' range, where drifts are compared."""
        span = self.color_range.linear
        return 0.5 * (span.lo + span.hi)
