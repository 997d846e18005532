"""A trained 3DGS model from elsewhere, instead of one of our own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.config import Backend, RgbConfig
from rtgs.io.ply import read_background, read_ply
from rtgs.maths.geometry import Sim3
from rtgs.models import RgbModel
from rtgs.records.decision import Decision
from rtgs.records.scene import Scene
from rtgs.rgb.initial import fixed_background
from rtgs.rgb.photographs import Likeness, Views
from rtgs.rgb.settings import render_settings


def model_from_ply(
    path: Path, extent: float, backend: Backend = "cpu", *, antialiased: bool = False, given_from_world: Sim3 | None = None
) -> RgbModel:
    """A model in a 3DGS PLY file, over a black background.

    Args:
        extent: of the scene it belongs to (`Scene.extent`), for the near plane.
        backend: renders it.
        antialiased: it was trained with opacities that make up for the pixel-size blur.
        given_from_world: of the scene (`Scene.given_from_world`); the file is in the given frame. None: the world is the given frame.

    Raises:
        RtgsError: the file is unreadable or holds a one-channel thermal model, or the back end cannot run on this machine.
    """
    settings = render_settings(extent, backend, antialiased=antialiased)
    gaussians = read_ply(path, given_from_world)
    if gaussians.channels != 3:
        raise RtgsError(f"{path}: a thermal model of one channel; an RGB model is needed.")
    return RgbModel(gaussians, torch.zeros(3), settings)


def import_model(path: Path, scene: Scene, config: RgbConfig) -> tuple[RgbModel, Likeness]:
    """A model in a 3DGS PLY file with the background that suits it, and how like the photographs it is.

    The background is `RgbConfig.background`. Where that is "learned", it is the colour that the file states, as files of a run do, or else
    the one with the least squared error against a few training photographs.

    Raises:
        RtgsError: as `model_from_ply`; or the model does not show what the photographs show.
    """
    model = model_from_ply(
        path, scene.extent, config.backend, antialiased=config.antialiased, given_from_world=scene.given_from_world
    )
    views = Views.of(scene, model)
    background, reason = _background(path, views, config)
    likeness = views.likeness(background)
    if not likeness.explained > 0.0:
        raise RtgsError(
            f"{path}: does not show what the photographs show. It explains {100 * likeness.explained:.0f} % of the detail of "
            f"{views.count} training photographs ({likeness.psnr:.1f} dB), where a picture without any detail explains 0 %. Give a model "
            "in the frame and the unit of the capture's poses (transforms.json or sparse/0): not turned, moved, mirrored or scaled. "
            "`rtgs export --frame sfm` writes such a file."
        )
    choice = "#" + "".join(f"{round(255 * float(v)):02x}" for v in background)
    before, after = (100 * views.likeness(color).rms for color in (torch.zeros(3), background))
    decision = Decision("background", choice, f"{reason}; the error before is that of black", before, after, "% of white")
    return replace(model, background=background, decisions=(decision,)), likeness


def _background(path: Path, views: Views, config: RgbConfig) -> tuple[Tensor, str]:
    """`[3]`, and where the colour comes from."""
    fixed, stated = fixed_background(config), read_background(path)
    if fixed is not None:
        return fixed, "set by rgb.background"
    if stated is not None:
        return torch.tensor(stated), "stated in the file"
    return views.best_background(), f"least squares over {views.count} training photographs"
