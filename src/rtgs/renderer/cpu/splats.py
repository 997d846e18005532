"""A model as one camera sees it: projected, sorted into tiles, ready to be composited forwards and backwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import kernel
from rtgs.records.camera import Camera
from rtgs.renderer.cpu import projection, tiles
from rtgs.renderer.cpu.blend import blend, blend_adjoint, blend_backward
from rtgs.renderer.cpu.layout import CHUNKS, COLORS, G_COLORS, SPLAT, tile_side
from rtgs.renderer.cpu.simd import LANES
from rtgs.renderer.settings import COVARIANCE_BLUR_PX2

Model = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""means `[N, 3]`, quats `[N, 4]`, log_scales `[N, 3]`, opacity_logits `[N]`."""
Pose = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Rotation `[3, 3]` and translation `[3]` of camera_from_world."""


def _rows_of_slots(rows: int, numbers: int) -> NDArray[np.float32]:
    width = projection.slot_width(numbers)
    slots = np.empty(rows * width + LANES, np.float32)  # the last row is read a register at a time
    slots[: max(width, LANES)] = 0.0
    return slots


@kernel()
def _set_colors(tiles: NDArray[np.int32], colors: NDArray[np.float32], rows: NDArray[np.float32]) -> None:
    for i in range(len(tiles)):
        if tiles[i] > 0:
            for c in range(colors.shape[1]):
                rows[i * SPLAT + COLORS + c] = colors[i, c]


@dataclass(frozen=True, eq=False)
class Splats:
    """A model as one camera sees it, sorted into tiles.

    Attributes:
        rows: `[N · 16]` float32 (see `layout`), set where visible.
        tiles: `[N]`, tiles in a splat's box, 0 where not visible. boxes: `[N, 4]` int16. pair_starts: `[N + 1]` into places.
        tile_starts: `[T + 1]` into entries; entries: `[S + padding]`; places: `[S]` (see `tiles.bin_splats`).
        tile_order: `[T]`, in which threads take the tiles.
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
        model: Model,
        offsets: NDArray[np.float32],
        colors: NDArray[np.float32],
        camera: Camera,
        pose: Pose,
        near_plane: float,
        antialiased: bool,
        every: int = 1,
    ) -> Splats:
        """Project and sort. `offsets` `[N, 2]` or `[0, 2]` are added to the pixel centres; colors `[N, C]`.

        Args:
            every: `camera` sees one row of so many (`Camera.rows`): splats are as wide and high as in whole pictures.
        """
        n, side = len(colors), tile_side(camera.width, camera.height)
        view = (np.array([camera.fl_x, camera.fl_y, camera.cx, camera.cy]), np.array([camera.width, camera.height], np.float64))
        rows, depths = np.empty(n * SPLAT, np.float32), np.empty(n, np.float32)
        counts, boxes = np.empty(n, np.int32), np.empty((n, 4), np.int16)
        arguments: list[Any] = [*model, offsets, colors, *pose, *view, side, float(near_plane)]
        blur = np.array([COVARIANCE_BLUR_PX2, COVARIANCE_BLUR_PX2 / every**2])
        arguments += [blur, antialiased, rows, depths, boxes, counts]
        projection.project(*arguments)
        order, pair_starts = tiles.depth_order(depths.view(np.uint32), counts)
        columns, lines = -(-camera.width // side), -(-camera.height // side)
        tile_starts, entries, places = tiles.bin_splats(order, boxes, pair_starts, columns, lines)
        tile_order = tiles.longest_first(tile_starts)
        return Splats(rows, counts, boxes, pair_starts, tile_starts, entries, places, tile_order, view, side, colors.shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return int(self.view[1][1]), int(self.view[1][0])

    @property
    def lists(self) -> tuple[Any, ...]:
        """What every blending kernel begins with."""
        return self.tile_order, nb.get_num_threads(), self.tile_starts, self.entries, self.rows, self.side

    def blend(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """Image `[H, W, C]`, alpha `[H, W]`, and how many of its entries each tile needed `[T]`."""
        image, alpha = np.empty((*self.shape, self.channels), np.float32), np.empty(self.shape, np.float32)
        used = np.empty(len(self.tile_starts) - 1, np.int64)
        arguments: list[Any] = [*self.lists, (0,) * self.channels, image, alpha, used]
        blend(*arguments)
        return image, alpha, used

    def set_colors(self, colors: NDArray[np.float32]) -> None:
        """Exchange the colours `[N, C]`."""
        _set_colors(self.tiles, np.ascontiguousarray(colors, dtype=np.float32), self.rows)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.rows, self.tiles, self.boxes, self.pair_starts, self.entries, self.places))

    def slots(self, used: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
        """Where each tile's used entries begin when only those are kept, and how many rows that makes; row 0 stays free."""
        ends = np.cumsum(used) + 1
        return ends - used, int(ends[-1])

    def adjoint(self, g_image: NDArray[np.float32], used: NDArray[np.int64]) -> NDArray[np.float32]:
        """`[N, C]`: the transpose of `blend` as a map of the colours, of `[H, W, C]`."""
        channels = g_image.shape[2]
        slot_starts, slots = self.slots(used)
        slot_grads = _rows_of_slots(slots, channels)
        arguments: list[Any] = [*self.lists, (0,) * channels, used, g_image, slot_starts, slot_grads]
        blend_adjoint(*arguments)
        g_colors = np.empty((len(self.tiles), channels), np.float32)
        columns = -(-self.shape[1] // self.side)
        projection.gather_colors(self.boxes, self.pair_starts, self.places, used, slot_starts, columns, slot_grads, g_colors)
        return g_colors

    def backward(
        self,
        model: Model,
        pose: Pose,
        antialiased: bool,
        images: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]],
        g_image: NDArray[np.float32],
        g_alpha: NDArray[np.float32],
        with_offsets: bool,
    ) -> tuple[list[NDArray[np.float32]], NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
        """Gradients of the model's four arrays, of the pixel offsets (`[0, 2]` unless asked for), the colours and the pose.

        Args:
            images: what `blend` gave. g_image: `[H, W, C]`. g_alpha: `[H, W]`.

        Returns:
            As said; the pose's are `[12]`, rotation row by row, then translation.
        """
        image, alpha, used = images
        n, channels = len(self.tiles), self.channels
        slot_starts, slots = self.slots(used)
        slot_grads = _rows_of_slots(slots, G_COLORS + channels)
        arguments: list[Any] = [*self.lists, (0,) * channels, image, alpha[..., None], used, g_image, g_alpha[..., None]]
        arguments += [slot_starts, slot_grads]
        blend_backward(*arguments)
        g_model = [np.zeros_like(array) for array in model]
        g_colors = np.zeros((n, channels), np.float32)
        g_offsets = np.zeros((n if with_offsets else 0, 2), np.float32)
        g_pose = np.zeros((CHUNKS, 12))
        arguments = [*model, *pose, *self.view, self.side, antialiased, self.boxes, self.pair_starts, self.places, used]
        arguments += [slot_starts, slot_grads, *g_model, g_offsets, g_colors, g_pose]
        projection.project_backward(*arguments)
        return g_model, g_offsets, g_colors, g_pose.sum(0)
