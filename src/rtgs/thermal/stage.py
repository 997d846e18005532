"""The thermal stage: give the geometry of the RGB model a temperature."""

from __future__ import annotations

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.memory import Memory
from rtgs.base.progress import Progress
from rtgs.config import ThermalConfig
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.scene import Scene
from rtgs.thermal.adam import fit_adam
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import LinearSettings


def fit_thermal(
    scene: Scene,
    rgb_model: RgbModel,
    sfm_per_metre: float,
    config: ThermalConfig | None = None,
    *,
    progress: Progress | None = None,
    memory: Memory | None = None,
) -> ThermalModel:
    """Fit thermal colours to the training thermal images, on the geometry of the RGB model.

    Means, shapes, opacities and poses stay as they are (the paper's geometry-frozen protocol), or Gaussians are split where the thermal
    images show more (`ThermalConfig.geometry`). The RGB colours are replaced by one-channel spherical harmonics, which are fitted together
    with one background value.

    Args:
        sfm_per_metre: the scale, at which the thermal poses are taken.
        config: solver ("linear": least squares; "adam": the paper's) and its settings; None: the defaults.
        memory: what the run may take; None: the default. The linear solver keeps to it.

    Raises:
        RtgsError: no training frame, or a scale that is not a positive number.
    """
    config = config or ThermalConfig()
    if not scene.train_frames:
        raise RtgsError("fit_thermal: the scene has no training frame (every registered frame is held out).")
    if not (np.isfinite(sfm_per_metre) and sfm_per_metre > 0):
        raise RtgsError(f"fit_thermal: sfm_per_metre is {sfm_per_metre}; it must be a positive number.")
    if config.solver == "adam":
        return fit_adam(scene, rgb_model, sfm_per_metre, config, progress)
    return fit_linear(scene, rgb_model, sfm_per_metre, config, progress, LinearSettings.within(memory))
