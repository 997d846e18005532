"""The paper's objective: L(s), Eqs. 1–4 and 7, and its derivative by ln s."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from rtgs.camera import Camera
from rtgs.gaussians import Gaussians
from rtgs.geometry import SE3
from rtgs.image import GRAY_WEIGHTS, to_gray
from rtgs.losses import NgfPyramid
from rtgs.render import RenderSettings, render
from rtgs.scene import Frame, Scene


class Objective:
    """Per-frame losses of a frozen RGB model against the thermal images, as a function of θ = ln sfm_per_metre.

    Args:
        scene: rig, poses and thermal images.
        gaussians, background, settings: the RGB model.
        frames: which frames; training frames only.
        level_weights, epsilon: of Eqs. 5 and 7.
    """

    def __init__(
        self,
        scene: Scene,
        gaussians: Gaussians,
        background: Tensor,
        settings: RenderSettings,
        frames: Sequence[Frame],
        *,
        level_weights: tuple[float, ...],
        epsilon: float,
    ) -> None:
        self.frames = tuple(frames)
        self._gaussians = gaussians
        self._dtype = gaussians.means.dtype
        self._background = to_gray(background).to(self._dtype)
        self._settings = replace(settings, with_depth=False, channel_weights=GRAY_WEIGHTS)
        self._camera: Camera = scene.rig.thermal
        self._rgb_from_thermal = scene.rig.rgb_from_thermal.to_torch(torch.float64)
        self._world_from_rgb = [scene.world_from_rgb[f.name].to_torch(torch.float64) for f in frames]
        mask = torch.from_numpy(np.ascontiguousarray(scene.capture.thermal_mask))
        lo, hi = thermal_range([f.thermal[scene.capture.thermal_mask] for f in frames], 0.0)
        self._targets = [
            NgfPyramid.of(
                torch.from_numpy(np.where(scene.capture.thermal_mask, (f.thermal - lo) / (hi - lo), 0.0)).to(self._dtype),
                mask,
                level_weights=level_weights,
                epsilon=epsilon,
            )
            for f in frames
        ]

    def gray(self, index: int, theta: Tensor) -> Tensor:
        """Î_i^gray(s) `[h, w]` (Eqs. 1–3), differentiable in θ (a float64 scalar)."""
        world_from_thermal = self._world_from_rgb[index] @ self._rgb_from_thermal.with_baseline_scaled(torch.exp(theta))  # Eq. 1
        pose: SE3 = world_from_thermal.inverse()
        view = render(self._gaussians, self._camera, pose, settings=self._settings)
        return view.color[..., 0] + (1.0 - view.alpha) * self._background

    def loss(self, index: int, theta: float) -> float:
        """Eq. 7 for one frame."""
        with torch.no_grad():
            return float(self._targets[index](self.gray(index, torch.tensor(theta, dtype=torch.float64))))

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        """Eq. 7 for one frame and its derivative by θ, through the renderer and the pose."""
        t = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
        loss = self._targets[index](self.gray(index, t))
        if not loss.requires_grad:
            return loss.item(), 0.0
        loss.backward()
        return loss.item(), t.grad.item() if t.grad is not None else 0.0


def thermal_range(images: Sequence[np.ndarray], percentile: float) -> tuple[float, float]:
    """(lo, hi): the `percentile` and 100 − `percentile` of all pixels together; hi > lo always."""
    values = np.concatenate([np.asarray(image).ravel() for image in images])
    lo, hi = (float(v) for v in np.percentile(values, [percentile, 100.0 - percentile]))
    return lo, hi if hi > lo else lo + 1.0
