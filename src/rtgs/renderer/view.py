"""`render`, the one entrance: a Gaussian model seen from a camera, with gradients for the model and for the pose."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.maths.geometry import SE3
from rtgs.maths.sh import coefficients
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import cpu, cuda, reference
from rtgs.renderer.settings import Render, RenderSettings


def render(
    gaussians: Gaussians,
    camera: Camera,
    camera_from_world: SE3,
    *,
    settings: RenderSettings | None = None,
    pixel_offsets: Tensor | None = None,
) -> Render:
    """Render a model.

    Gradients reach every tensor of `gaussians`, both parts of `camera_from_world` (the view direction of the spherical harmonics
    included) and `pixel_offsets`. Pictures are where the model is: "cuda" takes a model on the CPU to the GPU, and its pictures back.

    Args:
        gaussians: the model; "cpu" and "cuda" compute in float32.
        camera: a camera without distortion.
        camera_from_world: NumPy or torch, on any device.
        settings: how; `RenderSettings()` when None.
        pixel_offsets: `[N, 2]`, added to the projected centres. Zeros that require a gradient give the screen-space gradient that
            densification reads.

    Raises:
        RtgsError: the camera has a lens; the back end cannot run on this machine, or the model is on a GPU and it is not "cuda"; the
            settings ask for SH bands or weigh channels that the model does not have; "cpu" is given more than eight channels, depth
            included.
    """
    settings = settings or RenderSettings()
    check(gaussians, camera, settings)
    backend = {"cpu": cpu, "cuda": cuda, "reference": reference}[settings.backend]
    home = gaussians.means.device
    device = cuda.device() if settings.backend == "cuda" else home
    if device != home:
        gaussians = gaussians.to(device)
        pixel_offsets = None if pixel_offsets is None else pixel_offsets.to(device)
    pose = camera_from_world.to_torch(gaussians.means.dtype, device)
    camera_centre = -(pose.rotation.T @ pose.translation)
    colors = backend.colors_from_sh(gaussians.means, active_sh(gaussians, settings), camera_centre)
    if settings.channel_weights is not None:
        colors = colors @ torch.tensor(settings.channel_weights, dtype=colors.dtype, device=device)[:, None]
    if settings.with_depth:  # depth is one more channel
        depths = gaussians.means @ pose.rotation[2] + pose.translation[2]
        colors = torch.cat([colors, depths[:, None]], dim=1)
    image, alpha, visible = backend.rasterize(gaussians.geometry, colors, camera, pose, settings, pixel_offsets)
    if device != home:
        image, alpha, visible = image.to(home), alpha.to(home), visible.to(home)
    if settings.with_depth:
        return Render(image[..., :-1], alpha, image[..., -1], visible)
    return Render(image, alpha, None, visible)


def on_the_cpu(settings: RenderSettings) -> RenderSettings:
    """The settings for what the "cuda" back end cannot do: "cpu" takes its place."""
    return replace(settings, backend="cpu") if settings.backend == "cuda" else settings


def check_backend(backend: Backend) -> None:
    """Refuse a back end that cannot run on this machine: before long work, rather than in its midst.

    Raises:
        RtgsError: "cuda", and torch finds no GPU.
    """
    if backend == "cuda":
        cuda.device()


def check(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> None:
    """Refuse what no back end can draw.

    Raises:
        RtgsError: as `render` says.
    """
    if camera.model not in ("PINHOLE", "SIMPLE_PINHOLE"):
        raise RtgsError(f"render: the camera model is {camera.model}; undistort first (camera.Undistortion).")
    device = gaussians.means.device
    if settings.backend != "cuda" and device.type != "cpu":
        raise RtgsError(
            f'render: the model is on "{device}" and backend "{settings.backend}" wants it on the CPU: move it with '
            'Gaussians.to("cpu"), or use backend "cuda".'
        )
    if settings.sh_degree is not None and settings.sh_degree > gaussians.sh_degree:
        raise RtgsError(f"render: sh_degree {settings.sh_degree} asked, the model has {gaussians.sh_degree}.")
    weights = settings.channel_weights
    if weights is not None and len(weights) != gaussians.channels:
        raise RtgsError(f"render: channel_weights has {len(weights)} numbers, the model {gaussians.channels} channel(s).")


def active_sh(gaussians: Gaussians, settings: RenderSettings) -> Tensor:
    """`[N, K, C]`: the harmonics up to the band asked for."""
    return gaussians.sh if settings.sh_degree is None else gaussians.sh[:, : coefficients(settings.sh_degree)]
