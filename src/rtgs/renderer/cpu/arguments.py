"""What the kernels are given: arrays that belong together, by name.

Numba passes a `NamedTuple` by its fields, and compiles for their types. **Unpack it before `prange`**: what an iteration writes into an
array through a `NamedTuple` is lost (Numba 0.68). All arrays are C-contiguous.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Geometry

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


class Model(NamedTuple):
    """A model's geometry: means `[N, 3]`, quats `[N, 4]`, log_scales `[N, 3]`, opacity_logits `[N]` (see `Gaussians`)."""

    means: Floats
    quats: Floats
    log_scales: Floats
    opacity_logits: Floats

    @staticmethod
    def of(geometry: Geometry) -> Model:
        return Model(*map(float32, geometry))


class View(NamedTuple):
    """A camera and where it stands.

    Attributes:
        rotation, translation: `[3, 3]` and `[3]` of camera_from_world.
        intrinsics: `[4]`, fl_x, fl_y, cx, cy in pixels.
        size: `[2]`, width and height in pixels.
    """

    rotation: Doubles
    translation: Doubles
    intrinsics: Doubles
    size: Doubles

    @staticmethod
    def of(camera: Camera, camera_from_world: SE3) -> View:
        intrinsics = np.array([camera.fl_x, camera.fl_y, camera.cx, camera.cy])
        size = np.array([camera.width, camera.height], np.float64)
        return View(float64(camera_from_world.rotation), float64(camera_from_world.translation), intrinsics, size)


class Boxes(NamedTuple):
    """The tiles of each Gaussian's bounding box, and where it stands in their lists.

    Attributes:
        boxes: `[N, 4]`, first tile column and row, columns, rows.
        starts: `[N + 1]` into `places`: running sum of the tiles in each box, none where not visible.
        places: `[S]`, where a Gaussian stands in the list of each tile of its box, tile by tile.
    """

    boxes: NDArray[np.int16]
    starts: NDArray[np.int64]
    places: NDArray[np.int32]


class Lists(NamedTuple):
    """The tiles' lists of splats.

    Attributes:
        order: `[T]`, in which threads take the tiles.
        threads: how many take part.
        starts: `[T + 1]` into `entries`.
        entries: `[S + padding]`, Gaussians, each tile's front to back.
        splats: `[N · 16]` (see `layout`).
        side: of a tile, pixels.
    """

    order: NDArray[np.int64]
    threads: int
    starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    splats: Floats
    side: int


class Slots(NamedTuple):
    """Gradients of list entries, from their own tile alone. Only entries that their tile needed have a slot.

    Attributes:
        used: `[T]`, how many of its list entries each tile needed.
        starts: `[T]`, the slot of each tile's first entry; slot 0 stays zero.
        grads: rows of `projection.slot_width` numbers.
    """

    used: NDArray[np.int64]
    starts: NDArray[np.int64]
    grads: Floats


def float32(tensor: Any) -> Floats:
    """A tensor or array as a contiguous float32 array, without a copy where it is one."""
    return np.ascontiguousarray(tensor.detach().cpu().numpy() if isinstance(tensor, Tensor) else tensor, dtype=np.float32)


def float64(tensor: Any) -> Doubles:
    """The same in float64."""
    return np.ascontiguousarray(tensor.detach().cpu().numpy() if isinstance(tensor, Tensor) else tensor, dtype=np.float64)
