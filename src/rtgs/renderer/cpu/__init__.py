"""The Numba back end: the same two functions as `reference`, compiled, float32.

Everything is deterministic, whatever the number of threads: sums run over fixed blocks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.renderer.cpu import motion, sh
from rtgs.renderer.cpu.blend import blend_tangents
from rtgs.renderer.cpu.layout import CHUNKS, G_COLORS, MAX_CHANNELS
from rtgs.renderer.cpu.splats import Splats


def colors_from_sh(means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
    """`[N, C]`: max(0, ½ + basis(direction from the camera) · sh), `coefficients` `[N, K, C]`."""
    return _ColorsFromSh.apply(means, coefficients, camera_centre)


def rasterize(
    means: Tensor,
    quats: Tensor,
    log_scales: Tensor,
    opacity_logits: Tensor,
    colors: Tensor,
    camera: Camera,
    camera_from_world: SE3,
    *,
    near_plane: float,
    antialiased: bool,
    pixel_offsets: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Image `[H, W, C]`, alpha `[H, W]` and visible `[N]`; see `reference.rasterize`.

    Raises:
        RtgsError: more colour channels than the kernels are written out for, or none.
    """
    check_channels(colors.shape[1])
    return _Rasterize.apply(
        means,
        quats,
        log_scales,
        opacity_logits,
        colors,
        pixel_offsets,
        camera_from_world.rotation,
        camera_from_world.translation,
        camera,
        near_plane,
        antialiased,
    )


def check_channels(channels: int) -> None:
    """Raises RtgsError for more colour channels than a splat's cache line holds, or none."""
    if not 1 <= channels <= MAX_CHANNELS:
        raise RtgsError(
            f"render: {channels} channels (depth counts as one); the cpu back end composites 1 to {MAX_CHANNELS} at once."
        )


def rasterize_with_tangents(
    means: Tensor,
    quats: Tensor,
    log_scales: Tensor,
    opacity_logits: Tensor,
    coefficients: Tensor,
    mixing: NDArray[np.float64],
    camera: Camera,
    camera_from_world: SE3,
    directions: NDArray[np.float64],
    *,
    near_plane: float,
    antialiased: bool,
    with_depth: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Image and tangents in one pass.

    Args:
        coefficients: `[N, K, C]`. mixing: `[O, C]`, which sums of the C colours are composited.
        directions: `[D, 10]` (see `motion`).

    Returns:
        image `[H, W, O]` (`O + 1` with depth, the last), alpha `[H, W]`, their derivatives `[D, H, W, O]` and `[D, H, W]`, and
        visible `[N]`.

    Raises:
        RtgsError: more channels than the kernels are written out for.
    """
    outputs = len(mixing) + with_depth
    check_channels(outputs)
    model = (_f32(means), _f32(quats), _f32(log_scales), _f32(opacity_logits))
    pose = (_f64(camera_from_world.rotation), _f64(camera_from_world.translation))
    n, ways = len(means), len(directions)
    centre, centre_rates = -(pose[0].T @ pose[1]), -directions[:, 3:6] @ pose[0]
    colors, slopes = np.empty((n, outputs), np.float32), np.empty((n, len(mixing), 3), np.float32)
    plain = np.empty((n, len(mixing)), np.float32) if with_depth else colors
    sh.mixed_colors_and_slopes(model[0], _f32(coefficients), centre, mixing.astype(np.float32), plain, slopes)
    if with_depth:
        colors[:, :-1], colors[:, -1] = plain, model[0] @ pose[0][2] + pose[1][2]
    splats = Splats.of(model, np.empty((0, 2), np.float32), colors, camera, pose, near_plane, antialiased)
    tangents = np.empty(n * ways * (G_COLORS + outputs), np.float32)
    arguments: list[Any] = [*model, *pose, *splats.view, antialiased, splats.tiles, directions, slopes]
    arguments += [centre_rates, with_depth, tangents]
    motion.move(*arguments)
    height, width = splats.shape
    image, alpha = np.empty((height, width, outputs), np.float32), np.empty((height, width), np.float32)
    d_image, d_alpha = np.empty((height, width, ways * outputs), np.float32), np.empty((height, width, ways), np.float32)
    *lists, side = splats.lists
    arguments = [*lists, tangents, side, (0,) * outputs, (0,) * ways, image, alpha, d_image, d_alpha]
    blend_tangents(*arguments)
    return (
        torch.from_numpy(image),
        torch.from_numpy(alpha),
        torch.from_numpy(d_image.reshape(height, width, ways, outputs)).permute(2, 0, 1, 3),
        torch.from_numpy(d_alpha).permute(2, 0, 1),
        torch.from_numpy(splats.tiles > 0),
    )


def _f32(tensor: Tensor) -> NDArray[np.float32]:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float32)


def _f64(tensor: Tensor) -> NDArray[np.float64]:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float64)


class _ColorsFromSh(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
        m, s, c = _f32(means), _f32(coefficients), _f64(camera_centre)
        colors = np.empty((len(m), s.shape[2]), np.float32)
        sh.evaluate(m, s, c, colors)
        ctx.saved = (m, s, c, colors)
        return torch.from_numpy(colors)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_colors: Tensor) -> tuple[Tensor | None, ...]:
        m, s, c, colors = ctx.saved
        directional = ctx.needs_input_grad[0] or ctx.needs_input_grad[2]
        g_sh = np.empty(s.shape if ctx.needs_input_grad[1] else (0, *s.shape[1:]), np.float32)
        g_means = np.zeros_like(m)
        g_centre = np.zeros((CHUNKS, 3))
        sh.evaluate_backward(m, s, c, colors, _f32(g_colors), directional, g_sh, g_means, g_centre)
        return (
            torch.from_numpy(g_means),
            torch.from_numpy(g_sh) if ctx.needs_input_grad[1] else None,
            torch.from_numpy(g_centre.sum(0)).to(torch.float32),
        )


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        log_scales: Tensor,
        opacity_logits: Tensor,
        colors: Tensor,
        pixel_offsets: Tensor | None,
        rotation: Tensor,
        translation: Tensor,
        camera: Camera,
        near_plane: float,
        antialiased: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:
        model = (_f32(means), _f32(quats), _f32(log_scales), _f32(opacity_logits))
        pose = (_f64(rotation), _f64(translation))
        offsets = np.empty((0, 2), np.float32) if pixel_offsets is None else _f32(pixel_offsets)
        splats = Splats.of(model, offsets, _f32(colors), camera, pose, near_plane, antialiased)
        image, alpha, used = splats.blend()
        if any(ctx.needs_input_grad):
            ctx.saved = (model, pose, antialiased, splats, image, alpha, used)
        visible = torch.from_numpy(splats.tiles > 0)
        ctx.mark_non_differentiable(visible)
        return torch.from_numpy(image), torch.from_numpy(alpha), visible

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_image: Tensor, g_alpha: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        model, pose, antialiased, splats, image, alpha, used = ctx.saved
        needs = ctx.needs_input_grad
        if not any(needed for k, needed in enumerate(needs) if k != 4):  # colours alone
            g_colors = splats.adjoint(_f32(g_image), used)
            return (None,) * 4 + (torch.from_numpy(g_colors),) + (None,) * 6
        images, g_images = (image, alpha, used), (_f32(g_image), _f32(g_alpha))
        g_model, g_offsets, g_colors, g_pose = splats.backward(model, pose, antialiased, images, *g_images, needs[5])
        pose_gradient = torch.from_numpy(g_pose).to(torch.float32)
        return (
            *(torch.from_numpy(g) for g in g_model),
            torch.from_numpy(g_colors),
            torch.from_numpy(g_offsets) if needs[5] else None,
            pose_gradient[:9].reshape(3, 3),
            pose_gradient[9:],
            None,
            None,
            None,
        )
