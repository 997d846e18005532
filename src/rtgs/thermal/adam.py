"""The paper's thermal fit (`ThermalConfig.solver = "adam"`): Adam on ℓ1 with optional SSIM, one image a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from rtgs.base.progress import Progress
from rtgs.config import ThermalConfig
from rtgs.losses.ssim import ssim, whole_windows
from rtgs.maths import sh
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.thermal.frames import color_range, training_range


def fit_adam(
    scene: Scene, rgb_model: RgbModel, sfm_per_metre: float, config: ThermalConfig, progress: Progress | None
) -> ThermalModel:
    """As `fit_thermal`, by Adam. Only the harmonics and the background are optimised; drift and pattern are not modelled."""
    frames = scene.train_frames
    generator = torch.Generator().manual_seed(config.seed)
    frozen = rgb_model.gaussians.detach()
    n, k = len(frozen), sh.coefficients(config.sh_degree)
    start = torch.randn(n, k, 1, generator=generator) * config.initial_noise
    constant, directional = torch.nn.Parameter(start[:, :1].clone()), torch.nn.Parameter(start[:, 1:].clone())
    span, colors = training_range(scene), color_range(scene)
    camera, mask_array = scene.rig.thermal, scene.capture.thermal_mask
    mask = None if mask_array.all() else torch.from_numpy(np.ascontiguousarray(mask_array))
    windows = None if mask is None else whole_windows(mask)  # SSIM's windows must not reach pixels that hold nothing
    targets = [torch.from_numpy(colors.normalise(np.where(mask_array, f.thermal, span.lo)))[..., None] for f in frames]
    borders = torch.cat([torch.cat([t[0], t[-1], t[:, 0], t[:, -1]]) for t in targets])
    background = torch.nn.Parameter(borders.median(dim=0).values)
    optimizer = torch.optim.Adam(
        [
            {"params": [constant], "lr": config.learning_rate},
            {"params": [directional], "lr": config.learning_rate / 20},
            {"params": [background], "lr": config.learning_rate / 5},
        ],
        eps=1e-15,
        fused=True,
    )
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1 / max(config.steps, 1)))
    settings = rgb_model.settings
    poses = [scene.thermal_from_world(f.name, sfm_per_metre) for f in frames]
    history: dict[str, list[float]] = {"step": [], "loss": []}
    order: list[int] = []
    recent: list[float] = []
    for step in range(config.steps):
        if not order:
            order = torch.randperm(len(frames), generator=generator).tolist()
        i = order.pop()
        model = replace(frozen, sh=torch.cat([constant, directional], dim=1))
        image = render(model, camera, poses[i], settings=settings).over(background)
        error = (image - targets[i]).abs()
        loss = error.mean() if mask is None else (error * mask[..., None]).sum() / mask.sum()
        if config.ssim_weight:
            loss = loss + config.ssim_weight * (1.0 - ssim(image, targets[i], mask=windows))
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        schedule.step()
        recent = [*recent, loss.item()][-len(frames) :]
        if (step + 1) % max(config.steps // 20, 1) == 0 or step + 1 == config.steps:
            history["step"].append(step + 1)
            history["loss"].append(float(np.mean(recent)))
        if progress is not None:
            progress(step + 1, config.steps, f"loss {np.mean(recent):.4f}")
    coefficients = torch.cat([constant, directional], dim=1).detach()
    return ThermalModel(
        gaussians=replace(frozen, sh=coefficients),
        background=background.detach().clone(),
        unit=scene.capture.radiometry.unit,
        range=span,
        color_range=colors,
        settings=settings,
        sfm_per_metre=float(sfm_per_metre),
        history=history,
    )
