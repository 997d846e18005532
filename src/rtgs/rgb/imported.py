"""A trained 3DGS model from elsewhere, instead of one of our own."""

from __future__ import annotations

from pathlib import Path

import torch

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.io.ply import read_ply
from rtgs.models import RgbModel
from rtgs.rgb.settings import render_settings


def model_from_ply(path: Path, extent: float, backend: Backend = "cpu") -> RgbModel:
    """A model in a 3DGS PLY file, over a black background.

    Args:
        extent: of the scene it belongs to (`Scene.extent`), for the near plane.
        backend: renders it.

    Raises:
        RtgsError: the file is unreadable or holds a one-channel thermal model, or the back end cannot run on this machine.
    """
    settings = render_settings(extent, backend)
    gaussians = read_ply(path)
    if gaussians.channels != 3:
        raise RtgsError(f"{path}: a thermal model of one channel; an RGB model is needed.")
    return RgbModel(gaussians, torch.zeros(3), settings)
