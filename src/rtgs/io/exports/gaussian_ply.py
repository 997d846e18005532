"""Models as 3DGS PLYs: with all harmonics, with temperatures as columns, and in the colours of a palette."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from rtgs.io.exports.frames import FileFrame
from rtgs.io.ply import THERMAL_PROPERTIES, write_ply
from rtgs.maths.geometry import Sim3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.gaussians import Gaussians


def write_rgb_ply(path: Path, model: RgbModel, frame: FileFrame) -> None:
    """Write an RGB model; the colour behind it is a comment."""
    gaussians, given_from_world = _placed(model.gaussians, frame)
    write_ply(path, gaussians, given_from_world=given_from_world, background=model.background.tolist())


def write_thermal_ply(path: Path, model: ThermalModel, frame: FileFrame | Sim3) -> None:
    """Write a thermal model; counts are no temperature and are not written as one.

    Args:
        frame: of the file; or `Scene.given_from_world`.
    """
    gaussians, given_from_world = (model.gaussians, frame) if isinstance(frame, Sim3) else _placed(model.gaussians, frame)
    found, celsius = model.temperatures, model.unit == "°C"
    known = (found.temperature, found.std, found.views) if found is not None and celsius else ()
    write_ply(
        path,
        gaussians,
        given_from_world=given_from_world,
        celsius_range=(model.color_range.lo, model.color_range.hi) if celsius else None,
        properties=dict(zip(THERMAL_PROPERTIES, known, strict=False)),
    )


def write_coloured_ply(path: Path, gaussians: Gaussians, frame: FileFrame) -> None:
    """Write Gaussians with the colours that viewers are to show."""
    placed, given_from_world = _placed(gaussians, frame)
    write_ply(path, placed, given_from_world=given_from_world)


def _placed(gaussians: Gaussians, frame: FileFrame) -> tuple[Gaussians, Sim3]:
    """The model, and what leads from it to the file: a frame that does not turn is left to the writer, which may need doubles."""
    if frame.axes is None and (frame.from_world.rotation == np.eye(3)).all():
        return gaussians, frame.from_world
    placed, at = gaussians.turned(frame.from_world.rotation), frame.from_world
    means = torch.as_tensor(at.apply(gaussians.means.double().numpy()), dtype=torch.float32)
    log_scales = placed.log_scales + float(np.log(at.factor))
    return Gaussians(means, placed.quats, log_scales, placed.opacity_logits, placed.sh), Sim3.identity()
