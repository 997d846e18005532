"""A model as one camera sees it: projected, sorted into tiles, ready to be composited forwards and backwards."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import kernel
from rtgs.renderer.cpu import projection, tiles
from rtgs.renderer.cpu.arguments import Boxes, Doubles, Floats, Lists, Model, Slots, View
from rtgs.renderer.cpu.blend import blend, blend_adjoint, blend_backward
from rtgs.renderer.cpu.layout import CHUNKS, COLORS, G_COLORS, SPLAT, tile_side
from rtgs.renderer.cpu.simd import LANES
from rtgs.renderer.settings import COVARIANCE_BLUR_PX2


def _rows_of_slots(rows: int, numbers: int) -> Floats:
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
class Picture:
    """What a view's splats give when they are composited.

    Attributes:
        image: `[H, W, C]`. alpha: `[H, W]`.
        used: `[T]`, how many of its list entries each tile needed.
    """

    image: Floats
    alpha: Floats
    used: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Gradients:
    """Of the model `[…]` as its arrays, of the pixel offsets (`[N, 2]`, or `[0, 2]` when not asked for), the colours `[N, C]` and the
    pose `[12]`: rotation row by row, then translation."""

    model: Model
    offsets: Floats
    colors: Floats
    pose: Doubles


@dataclass(frozen=True, eq=False)
class Splats:
    """A model as one camera sees it, sorted into tiles.

    Attributes:
        rows: `[N · 16]` (see `layout`), set where visible.
        tiles: `[N]`, tiles in a splat's box, 0 where not visible.
        boxes: these tiles, and the splat's places in their lists.
        tile_starts, entries, tile_order: the tiles' lists (see `Lists`).
        view: the camera.
        side: of a tile, pixels.
        channels: C.
    """

    rows: Floats
    tiles: NDArray[np.int32]
    boxes: Boxes
    tile_starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    tile_order: NDArray[np.int64]
    view: View
    side: int
    channels: int

    @staticmethod
    def of(
        model: Model, offsets: Floats, colors: Floats, view: View, near_plane: float, antialiased: bool, every: int = 1
    ) -> Splats:
        """Project and sort.

        Args:
            offsets: `[N, 2]`, added to the pixel centres; or `[0, 2]`.
            colors: `[N, C]`.
            every: `view` sees one row of so many (`Camera.rows`): splats are as wide and high as in whole pictures.
        """
        n, width, height = len(colors), int(view.size[0]), int(view.size[1])
        side = tile_side(width, height)
        rows, depths = np.empty(n * SPLAT, np.float32), np.empty(n, np.float32)
        counts, boxes = np.empty(n, np.int32), np.empty((n, 4), np.int16)
        blur = np.array([COVARIANCE_BLUR_PX2, COVARIANCE_BLUR_PX2 / every**2])
        projection.project(model, offsets, colors, view, side, float(near_plane), blur, antialiased, rows, depths, boxes, counts)
        order, pair_starts = tiles.depth_order(depths.view(np.uint32), counts)
        tile_starts, entries, places = tiles.bin_splats(order, boxes, pair_starts, -(-width // side), -(-height // side))
        tile_order = tiles.longest_first(tile_starts)
        its_boxes = Boxes(boxes, pair_starts, places)
        return Splats(rows, counts, its_boxes, tile_starts, entries, tile_order, view, side, colors.shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return int(self.view.size[1]), int(self.view.size[0])

    @property
    def lists(self) -> Lists:
        """What every blending kernel begins with."""
        return Lists(self.tile_order, nb.get_num_threads(), self.tile_starts, self.entries, self.rows, self.side)

    def blend(self) -> Picture:
        """Composite front to back."""
        image, alpha = np.empty((*self.shape, self.channels), np.float32), np.empty(self.shape, np.float32)
        used = np.empty(len(self.tile_order), np.int64)
        blend(self.lists, (0,) * self.channels, image, alpha, used)
        return Picture(image, alpha, used)

    def set_colors(self, colors: Floats) -> None:
        """Exchange the colours `[N, C]`."""
        _set_colors(self.tiles, np.ascontiguousarray(colors, dtype=np.float32), self.rows)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.rows, self.tiles, *self.boxes, self.entries))

    def slots(self, used: NDArray[np.int64], numbers: int) -> Slots:
        """Room for so many numbers for each list entry that was needed."""
        ends = np.cumsum(used) + 1
        return Slots(used, ends - used, _rows_of_slots(int(ends[-1]), numbers))

    def adjoint(self, g_image: Floats, used: NDArray[np.int64]) -> Floats:
        """`[N, C]`: the transpose of `blend` as a linear map of the colours, of `[H, W, C]`."""
        channels = g_image.shape[2]
        slots = self.slots(used, channels)
        blend_adjoint(self.lists, (0,) * channels, g_image, slots)
        g_colors = np.empty((len(self.tiles), channels), np.float32)
        projection.gather_colors(self.boxes, slots, -(-self.shape[1] // self.side), g_colors)
        return g_colors

    def backward(
        self, model: Model, antialiased: bool, picture: Picture, g_image: Floats, g_alpha: Floats, with_offsets: bool
    ) -> Gradients:
        """Reverse mode.

        Args:
            picture: what `blend` gave.
            g_image, g_alpha: `[H, W, C]` and `[H, W]`, gradients of the picture.
        """
        n, channels = len(self.tiles), self.channels
        slots = self.slots(picture.used, G_COLORS + channels)
        alphas = picture.alpha[..., None], g_alpha[..., None]
        blend_backward(self.lists, (0,) * channels, picture.image, alphas[0], g_image, alphas[1], slots)
        g_model = Model(*map(np.zeros_like, model))
        g_offsets, g_colors = np.zeros((n if with_offsets else 0, 2), np.float32), np.zeros((n, channels), np.float32)
        g_pose = np.zeros((CHUNKS, 12))
        projection.project_backward(
            model, self.view, self.side, antialiased, self.boxes, slots, g_model, g_offsets, g_colors, g_pose
        )
        return Gradients(g_model, g_offsets, g_colors, g_pose.sum(0))
