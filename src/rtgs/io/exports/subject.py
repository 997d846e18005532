"""What is exported: a run's models and scene, and its Gaussians as arrays in the frame of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.config import ExportConfig, ThermalColours
from rtgs.images.pictures import palette
from rtgs.io.exports.frames import AXES_OF, Axes, FileFrame, file_frame
from rtgs.maths.geometry import Sim3
from rtgs.maths.sh import C0
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.georeference import Georeference
from rtgs.records.radiometry import LinearRange
from rtgs.records.scene import Scene


@dataclass(frozen=True, eq=False)
class Subject:
    """A run that is exported.

    Attributes:
        metres_per_sfm: what lengths are multiplied by; None: nothing tells metres.
        sfm_per_metre: what places the thermal cameras (`ScaleEstimate` says why both).
        settings: what the user asked for.
        place: where the scene is on the Earth; None: not known.
    """

    scene: Scene
    rgb: RgbModel
    thermal: ThermalModel
    metres_per_sfm: float | None
    sfm_per_metre: float
    settings: ExportConfig
    place: Georeference | None = None

    @property
    def unit_per_sfm(self) -> float:
        """What lengths are multiplied by, to be metres, or SfM units where nothing tells metres."""
        return 1.0 if self.metres_per_sfm is None else self.metres_per_sfm

    def frame(self, usual: Axes, *, fixed: bool = False) -> FileFrame:
        """The frame of a file of a format whose usual axes these are; `fixed` where the program that reads it has no say."""
        axes = AXES_OF[self.settings.program] if self.settings.program is not None and not fixed else usual
        return file_frame(self.scene, self.metres_per_sfm, self.settings.frame, axes, self.place)

    def baseline_unit(self, frame: FileFrame) -> float:
        """What the baseline's length in `rig.json` is multiplied by in a file, so that the thermal cameras stand where the images say."""
        return self.sfm_per_metre * frame.from_world.factor / self.scene.given_from_world.factor


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians with colours for viewers, in the frame of a file.

    Attributes:
        means: `[N, 3]` float64. quats: `[N, 4]` float64 `wxyz` of length 1. log_scales: `[N, 3]`. opacity_logits: `[N]`. sh: `[N, K, 3]`;
            these three are float32.
        columns: `[N]` float32 by name, what viewers do not draw: the temperatures of a thermal model.
        legend: temperatures of the first and the last colour, for a thermal model; None for RGB.
        unit: of the temperatures.
        antialiased: as in `RenderSettings`.
    """

    means: NDArray[np.float64]
    quats: NDArray[np.float64]
    log_scales: NDArray[np.float32]
    opacity_logits: NDArray[np.float32]
    sh: NDArray[np.float32]
    columns: Mapping[str, NDArray[np.float32]]
    legend: LinearRange | None
    unit: str
    antialiased: bool

    def __len__(self) -> int:
        return len(self.means)

    @property
    def opacities(self) -> NDArray[np.float64]:
        """`[N]` in [0, 1]."""
        return 1.0 / (1.0 + np.exp(-self.opacity_logits.astype(np.float64)))

    @property
    def colours(self) -> NDArray[np.float64]:
        """`[N, 3]` in [0, 1], without what depends on the direction."""
        return np.clip(0.5 + C0 * self.sh[:, 0].astype(np.float64), 0.0, 1.0)

    @property
    def sh_degree(self) -> int:
        return round(self.sh.shape[1] ** 0.5) - 1


def rgb_splats(model: RgbModel, file_from_world: Sim3) -> Splats:
    """The RGB model, in a file."""
    return _splats(model.gaussians, file_from_world, model.settings.antialiased, {}, None, "")


def thermal_splats(model: ThermalModel, file_from_world: Sim3, colours: ThermalColours) -> Splats:
    """The thermal model, in a file: each Gaussian has the colour of its temperature, from every side."""
    gaussians, legend = coloured(model, colours)
    return _splats(gaussians, file_from_world, model.settings.antialiased, temperature_columns(model), legend, model.unit)


def coloured(model: ThermalModel, colours: ThermalColours) -> tuple[Gaussians, LinearRange]:
    """The thermal Gaussians in three channels, and the temperatures of the first and the last colour."""
    temperature = next(iter(temperature_columns(model).values()))
    if colours == "palette":
        legend = model.range
        shown = palette(temperature[None], legend.lo, legend.hi)[0] / 255.0
    else:  # no temperature may be cut off, so that all can be read back
        lo, hi = float(temperature.min()), float(temperature.max())
        legend = LinearRange(lo, hi if hi > lo else lo + 1.0)
        shown = legend.normalise(temperature)[:, None].repeat(3, axis=1)
    sh = torch.as_tensor((shown - 0.5) / C0, dtype=torch.float32)[:, None]
    g = model.gaussians
    return Gaussians(g.means, g.quats, g.log_scales, g.opacity_logits, sh), legend


def temperature_columns(model: ThermalModel) -> dict[str, NDArray[np.float32]]:
    """`[N]` each: `temperature`, and where they are known `temperature_std` and `views`. Of a model in counts, `counts`, `counts_std`."""
    name, found = "temperature" if model.unit == "°C" else "counts", model.temperatures
    if found is not None:
        return {name: found.temperature, f"{name}_std": found.std, "views": found.views}
    dc = model.gaussians.sh[:, 0, 0].detach().numpy()
    return {name: model.color_range.expand(np.maximum(0.0, 0.5 + C0 * dc.astype(np.float64)))}


def _splats(
    gaussians: Gaussians,
    file_from_world: Sim3,
    antialiased: bool,
    columns: Mapping[str, NDArray[np.float32]],
    legend: LinearRange | None,
    unit: str,
) -> Splats:
    for name, tensor in gaussians.tensors().items():
        if not bool(torch.isfinite(tensor).all()):
            raise RtgsError(f"export: the model's {name} holds NaN or infinity.")
    turned = gaussians.turned(file_from_world.rotation)
    quats = turned.quats.double().numpy()
    return Splats(
        means=file_from_world.apply(gaussians.means.double().numpy()),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        log_scales=turned.log_scales.numpy() + np.float32(np.log(file_from_world.factor)),
        opacity_logits=turned.opacity_logits.numpy(),
        sh=turned.sh.numpy(),
        columns=columns,
        legend=legend,
        unit=unit,
        antialiased=antialiased,
    )
