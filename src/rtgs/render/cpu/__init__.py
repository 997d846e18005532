"""The Numba back end: the same two functions as `reference`, compiled, float32.

Everything is deterministic, whatever the number of threads: sums run over fixed blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from rtgs.render.cpu.blend import blend, blend_adjoint, blend_backward
from rtgs.render.cpu.layout import CHUNKS, G_COLORS, MAX_CHANNELS, SPLAT, tile_side
from rtgs.render.cpu.simd import LANES


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
        n, channels = len(model[0]), image.shape[2]
        slot_starts, slots = splats.slots(used)
        slot_grads = _rows_of_slots(slots, G_COLORS + channels)
        images = (image, alpha[..., None])
        g_images = (_f32(g_image), _f32(g_alpha)[..., None])
        blend_backward(*splats.lists, (0,) * channels, *images, used, *g_images, slot_starts, slot_grads)
        g_model = [np.zeros_like(array) for array in model]
        g_colors = np.zeros((n, channels), np.float32)
        g_offsets = np.zeros((n if needs[5] else 0, 2), np.float32)
        g_pose = np.zeros((CHUNKS, 12))
        arguments: list[Any] = [*model, *pose, *splats.view, splats.side, antialiased]
        arguments += [splats.boxes, splats.pair_starts, splats.places, used]
        projection.project_backward(*arguments, slot_starts, slot_grads, *g_model, g_offsets, g_colors, g_pose)
        g_pose_sum = torch.from_numpy(g_pose.sum(0)).to(torch.float32)
        return (
            *(torch.from_numpy(g) for g in g_model),
            torch.from_numpy(g_colors),
            torch.from_numpy(g_offsets) if needs[5] else None,
            g_pose_sum[:9].reshape(3, 3),
            g_pose_sum[9:],
            None,
            None,
            None,
        )


def _rows_of_slots(rows: int, numbers: int) -> NDArray[np.float32]:
    width = projection.slot_width(numbers)
    slots = np.empty(rows * width + LANES, np.float32)  # the last row is read a register at a time
    slots[: max(width, LANES)] = 0.0
    return slots


@dataclass(frozen=True, eq=False)
class Splats:
    """A model as one camera sees it, sorted into tiles.

    Attributes:
        rows: `[N · 16]` float32 (see `layout`), set where visible.
        tiles: `[N]`, tiles in a splat's box, 0 where not visible. boxes: `[N, 4]` int16. pair_starts: `[N + 1]` into places.
        tile_starts: `[T + 1]` into entries; entries: `[S + padding]`; places: `[S]` (see `tiles.bin_splats`).
        tile_order: `[T]`, balanced over the threads.
        view: intrinsics `[4]` and image size `[2]`, float64.
        side: of a tile, pixels.
        channels: C.
    """

    rows: NDArray[np.float32]
    tiles: NDArray[np.int32]
    boxes: NDArray[np.int16]
    pair_starts: NDArray[np.int64]
    tile_starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    places: NDArray[np.int32]
    tile_order: NDArray[np.int64]
    view: tuple[NDArray[np.float64], NDArray[np.float64]]
    side: int
    channels: int

    @staticmethod
    def of(
        model: tuple[NDArray[np.float32], ...],
        offsets: NDArray[np.float32],
        colors: NDArray[np.float32],
        camera: Camera,
        pose: tuple[NDArray[np.float64], NDArray[np.float64]],
        near_plane: float,
        antialiased: bool,
    ) -> Splats:
        n, side = len(colors), tile_side(camera.width, camera.height)
        view = (np.array([camera.fl_x, camera.fl_y, camera.cx, camera.cy]), np.array([camera.width, camera.height], np.float64))
        rows, depths = np.empty(n * SPLAT, np.float32), np.empty(n, np.float32)
        counts, boxes = np.empty(n, np.int32), np.empty((n, 4), np.int16)
        arguments: list[Any] = [*model, offsets, colors, *pose, *view, side, float(near_plane), antialiased]
        projection.project(*arguments, rows, depths, boxes, counts)
        order = tiles.depth_order(depths.view(np.uint32), counts)
        pair_starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        columns, lines = -(-camera.width // side), -(-camera.height // side)
        tile_starts, entries, places = tiles.bin_splats(order, boxes, pair_starts, columns, lines)
        tile_order = tiles.balanced(tile_starts, nb.get_num_threads())
        return Splats(rows, counts, boxes, pair_starts, tile_starts, entries, places, tile_order, view, side, colors.shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return int(self.view[1][1]), int(self.view[1][0])

    @property
    def lists(self) -> tuple[Any, ...]:
        """What every blending kernel begins with."""
        return self.tile_order, self.tile_starts, self.entries, self.rows, self.side

    def blend(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """Image `[H, W, C]`, alpha `[H, W]`, and how many of its entries each tile needed `[T]`."""
        image, alpha = np.empty((*self.shape, self.channels), np.float32), np.empty(self.shape, np.float32)
        used = np.empty(len(self.tile_order), np.int64)
        blend(*self.lists, (0,) * self.channels, image, alpha, used)
        return image, alpha, used

    def slots(self, used: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
        """Where each tile's used entries begin when only those are kept, and how many rows that makes; row 0 stays free."""
        ends = np.cumsum(used) + 1
        return ends - used, int(ends[-1])

    def adjoint(self, g_image: NDArray[np.float32], used: NDArray[np.int64]) -> NDArray[np.float32]:
        """`[N, C]`: the transpose of `blend` as a map of the colours, of `[H, W, C]`."""
        channels = g_image.shape[2]
        slot_starts, slots = self.slots(used)
        slot_grads = _rows_of_slots(slots, channels)
        blend_adjoint(*self.lists, (0,) * channels, used, g_image, slot_starts, slot_grads)
        g_colors = np.empty((len(self.tiles), channels), np.float32)
        columns = -(-self.shape[1] // self.side)
        projection.gather_colors(self.boxes, self.pair_starts, self.places, used, slot_starts, columns, slot_grads, g_colors)
        return g_colors
