"""The Numba back end: the same two functions as `reference`, compiled, float32.

Everything is deterministic, whatever the number of threads: sums run over fixed blocks.
"""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from rtgs.camera import Camera
from rtgs.errors import RtgsError
from rtgs.geometry import SE3
from rtgs.render.cpu import projection, sh, tiles
from rtgs.render.cpu.blend import blend, blend_backward
from rtgs.render.cpu.channels import MAX_CHANNELS


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
    if not 1 <= colors.shape[1] <= MAX_CHANNELS:
        raise RtgsError(
            f"render: {colors.shape[1]} channels (depth counts as one); the cpu back end composites 1 to {MAX_CHANNELS} at once."
        )
    if pixel_offsets is None:
        pixel_offsets = torch.zeros(len(means), 2)
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
        g_centre = np.zeros((projection.CHUNKS, 3))
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
        pixel_offsets: Tensor,
        rotation: Tensor,
        translation: Tensor,
        camera: Camera,
        near_plane: float,
        antialiased: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:
        width, height = camera.width, camera.height
        model = (_f32(means), _f32(quats), _f32(log_scales), _f32(opacity_logits))
        pose = (_f64(rotation), _f64(translation))
        view = (np.array([camera.fl_x, camera.fl_y, camera.cx, camera.cy]), np.array([width, height], np.float64))
        n, channels = colors.shape

        splats = np.empty((n, projection.COLORS), np.float32)
        depths = np.empty(n, np.float32)
        counts = np.empty(n, np.int32)
        projection.project(*model, _f32(pixel_offsets), *pose, *view, near_plane, antialiased, splats, depths, counts)
        visible = counts > 0
        kept = np.flatnonzero(visible)
        order = kept[np.argsort(depths[kept], kind="stable")]
        packed = np.empty((len(order), projection.COLORS + channels), np.float32)
        tiles.pack(splats, _f32(colors), order, packed)
        starts = np.concatenate([[0], np.cumsum(counts[order], dtype=np.int64)])
        tile_starts, ranks, slots = tiles.bin_splats(packed, starts, width, height)
        tile_order = tiles.balanced(tile_starts, nb.get_num_threads())

        image = np.empty((height, width, channels), np.float32)
        alpha = np.empty((height, width), np.float32)
        spent = np.empty(len(tile_order), np.int64)
        blend(tile_order, tile_starts, ranks, packed, width, height, (0,) * channels, image, alpha, spent)

        if any(ctx.needs_input_grad):
            ctx.saved = (model, pose, view, antialiased, order, packed, starts, slots, tile_order, tile_starts, ranks, spent)
            ctx.images = (image, alpha)
        visible_tensor = torch.from_numpy(visible)
        ctx.mark_non_differentiable(visible_tensor)
        return torch.from_numpy(image), torch.from_numpy(alpha), visible_tensor

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_image: Tensor, g_alpha: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        model, pose, view, antialiased, order, packed, starts, slots, tile_order, tile_starts, ranks, spent = ctx.saved
        image, alpha = ctx.images
        height, width, channels = image.shape
        geometry = any(needed for k, needed in enumerate(ctx.needs_input_grad) if k != 4)
        slot_grads = np.zeros((len(ranks), projection.G_COLORS + channels), np.float32)
        blend_backward(
            tile_order,
            tile_starts,
            ranks,
            packed,
            width,
            height,
            (0,) * channels,
            image,
            alpha,
            spent,
            _f32(g_image),
            _f32(g_alpha),
            geometry,
            slot_grads,
        )
        n = len(model[0])
        g_colors = np.zeros((n, channels), np.float32)
        if not geometry:
            projection.gather_colors(order, starts, slots, slot_grads, g_colors)
            return (None,) * 4 + (torch.from_numpy(g_colors),) + (None,) * 6
        g_model = [np.zeros_like(array) for array in model]
        g_offsets = np.zeros((n, 2), np.float32)
        g_pose = np.zeros((projection.CHUNKS, 12))
        arguments: list[Any] = [*model, *pose, *view, antialiased, order, starts, slots, slot_grads]
        arguments += [*g_model, g_offsets, g_colors, g_pose]
        projection.project_backward(*arguments)
        g_pose_sum = torch.from_numpy(g_pose.sum(0)).to(torch.float32)
        return (
            *(torch.from_numpy(g) for g in g_model),
            torch.from_numpy(g_colors),
            torch.from_numpy(g_offsets),
            g_pose_sum[:9].reshape(3, 3),
            g_pose_sum[9:],
            None,
            None,
            None,
        )
