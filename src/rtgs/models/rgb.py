"""The RGB model: Gaussians with what it takes to render them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.decision import Decision
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, render


@dataclass(frozen=True, eq=False)
class RgbModel:
    """A trained or imported RGB model.

    Attributes:
        gaussians: C = 3.
        background: `[3]`, in [0, 1].
        settings: how it has to be rendered (near plane, anti-aliasing).
        history: "step" and "gaussians", lists of equal length, and "held_out_psnr" in dB, likewise, or empty without held-out frames.
        decisions: what was decided without the user when the model was imported, and why.
    """

    gaussians: Gaussians
    background: Tensor
    settings: RenderSettings
    history: Mapping[str, Sequence[float]] = field(default_factory=dict)
    decisions: tuple[Decision, ...] = ()

    def render(self, camera: Camera, camera_from_world: SE3) -> NDArray[np.float32]:
        """`[H, W, 3]` in [0, 1], over the background."""
        with torch.no_grad():
            view = render(self.gaussians, camera, camera_from_world, settings=self.settings).over(self.background)
        return view.numpy().clip(0.0, 1.0)
