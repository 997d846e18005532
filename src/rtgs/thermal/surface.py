"""The surface that the photographs see: what several of them show at one place, and what a Gaussian covers of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.compiled import inlined, kernel
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, render
from rtgs.thermal.settings import FollowSettings

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
SAMPLES_PX = 256  # points of a view by which its neighbours are found: the share of a view that another sees is then known to 3 %


@dataclass(frozen=True, eq=False)
class Surface:
    """Depth of F views, by which a pixel of one is found in the others.

    Attributes:
        depth: `[F, h, w]`, along the optical axis; 0 where there is nothing to see or the pixel is masked.
        rotations, translations: `[F, 3, 3]` and `[F, 3]`, camera_from_world.
        camera: focal lengths and principal point, `[4]`.
        neighbours: `[F, V]`, for each view the others that see most of what it sees; −1 where there are fewer.
    """

    depth: Floats
    rotations: Floats
    translations: Floats
    camera: Floats
    neighbours: Ints
    settings: FollowSettings

    @staticmethod
    def of(
        gaussians: Gaussians,
        camera: Camera,
        poses: Sequence[SE3],
        valid: Tensor,
        render_settings: RenderSettings,
        settings: FollowSettings,
    ) -> Surface:
        """Renders the depth of every view.

        Args:
            camera: of the photographs as they are fitted, rows left out.
            poses: camera_from_world.
            valid: `[h, w]`, 0 where a pixel is masked.
        """
        with_depth, depth = replace(render_settings, with_depth=True), []
        for pose in poses:
            with torch.no_grad():
                view = render(gaussians, camera, pose, settings=with_depth)
            assert view.depth is not None
            seen = (view.alpha > 0.5) & (valid > 0)
            depth.append(torch.where(seen, view.depth / view.alpha.clamp_min(1e-6), torch.zeros(())).numpy())
        stacked = np.stack(depth).astype(np.float32)
        rotations = np.stack([p.rotation for p in poses]).astype(np.float32)
        translations = np.stack([p.translation for p in poses]).astype(np.float32)
        numbers = np.array([camera.fl_x, camera.fl_y, camera.cx, camera.cy], np.float32)
        shared = np.zeros((len(poses), len(poses)), np.int64)
        every = max(int(math.sqrt(stacked[0].size / SAMPLES_PX)), 1)
        _count_shared(stacked, rotations, translations, numbers, settings.depth_share, every, shared)
        np.fill_diagonal(shared, -1)
        nearest = np.argsort(-shared, axis=1, kind="stable")[:, : settings.neighbours]
        nearest = np.where(np.take_along_axis(shared, nearest, axis=1) > 0, nearest, -1)
        return Surface(stacked, rotations, translations, numbers, nearest, settings)

    def consensus(self, residuals: Sequence[Tensor]) -> Floats:
        """`[F, h, w]`: what other views, looking at the same place, agree is missing there; 0 where they do not agree.

        It is the median over the other views. They agree where it is larger than `settings.clear` times its standard error. The view
        itself has no part in it: what it alone shows, a person or a reflection, is no consensus.

        Args:
            residuals: `[h, w]` for each view.
        """
        left = np.stack([r.numpy() for r in residuals]).astype(np.float32)
        out, settings = np.zeros_like(left), self.settings
        which = (self.neighbours, left, self.depth, self.rotations, self.translations, self.camera)
        _consensus(which, settings.depth_share, settings.fewest_views, settings.clear, out)
        return out


class Footprints:
    """Means of a map over what Gaussians cover of it, on a pyramid of means.

    Args:
        maps: `[F, h, w]`, one for each view of the surface.
    """

    def __init__(self, surface: Surface, maps: Floats) -> None:
        self._surface, levels = surface, [maps.astype(np.float32)]
        while min(levels[-1].shape[1:]) >= 4:
            below = levels[-1][:, : levels[-1].shape[1] // 2 * 2, : levels[-1].shape[2] // 2 * 2]
            levels.append(below.reshape(len(maps), below.shape[1] // 2, 2, below.shape[2] // 2, 2).mean(axis=(2, 4)))
        self._shapes = np.array([level.shape[1:] for level in levels])
        self._starts = np.concatenate([[0], np.cumsum([level.size for level in levels])])
        self._flat = np.concatenate([level.ravel() for level in levels])

    def means(self, gaussians: Gaussians) -> Tensor:
        """`[N]`: mean over the views that see the Gaussian's centre, and over its width there; 0 where none does."""
        out, surface = np.zeros(len(gaussians), np.float32), self._surface
        centres = np.ascontiguousarray(gaussians.means.detach().numpy(), dtype=np.float32)
        radii = gaussians.log_scales.detach().exp().amax(dim=1).numpy()
        views = (surface.depth, surface.rotations, surface.translations, surface.camera)
        pyramid = (self._flat, self._starts, self._shapes)
        _footprint_means(centres, radii, views, pyramid, surface.settings.depth_share, out)
        return torch.from_numpy(out)


@inlined
def _project(rotation: Floats, translation: Floats, camera: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Column, row (pixel centres at i + ½) and depth of a world point."""
    depth = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2]
    safe = depth if depth > 1e-9 else np.float32(1e-9)
    column = camera[0] * (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0]) / safe + camera[2]
    row = camera[1] * (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1]) / safe + camera[3]
    return column, row, depth


@inlined
def _lift(
    rotation: Floats, translation: Floats, camera: Floats, column: float, row: float, depth: float
) -> tuple[float, float, float]:
    """The world point that is seen at a place of a picture."""
    a = (column - camera[2]) / camera[0] * depth - translation[0]
    b = (row - camera[3]) / camera[1] * depth - translation[1]
    c = depth - translation[2]
    return (
        rotation[0, 0] * a + rotation[1, 0] * b + rotation[2, 0] * c,
        rotation[0, 1] * a + rotation[1, 1] * b + rotation[2, 1] * c,
        rotation[0, 2] * a + rotation[1, 2] * b + rotation[2, 2] * c,
    )


@kernel(parallel=True)
def _count_shared(
    depth: Floats, rotations: Floats, translations: Floats, camera: Floats, depth_share: float, every: int, out: Ints
) -> None:
    """out `[F, F]`: how many of view f's samples view g sees."""
    views, height, width = depth.shape
    for f in nb.prange(views):
        for i in range(every // 2, height, every):
            for j in range(every // 2, width, every):
                if depth[f, i, j] == 0:
                    continue
                x, y, z = _lift(rotations[f], translations[f], camera, j + 0.5, i + 0.5, depth[f, i, j])
                for g in range(views):
                    column, row, there = _project(rotations[g], translations[g], camera, x, y, z)
                    if not (there > 0 and 0 <= column < width and 0 <= row < height):
                        continue
                    if abs(depth[g, int(row), int(column)] - there) <= depth_share * there:
                        out[f, g] += 1


@inlined
def _bilinear(image: Floats, i: int, j: int, down: float, right: float) -> float:
    upper = (1 - right) * image[i, j] + right * image[i, j + 1]
    return (1 - down) * upper + down * ((1 - right) * image[i + 1, j] + right * image[i + 1, j + 1])


@inlined
def _median(values: Floats) -> float:
    """Of sorted values."""
    return np.float32(0.5) * (values[(len(values) - 1) // 2] + values[len(values) // 2])


@kernel(parallel=True)
def _consensus(
    which: tuple[Ints, Floats, Floats, Floats, Floats, Floats], depth_share: float, fewest_views: int, clear: float, out: Floats
) -> None:
    """See `Surface.consensus`."""
    neighbours, left, depth, rotations, translations, camera = which
    views, height, width = left.shape
    for row_of_all in nb.prange(views * height):
        f, i = row_of_all // height, row_of_all % height
        values = np.empty(neighbours.shape[1], np.float32)
        for j in range(width):
            if depth[f, i, j] == 0:
                continue
            x, y, z = _lift(rotations[f], translations[f], camera, j + 0.5, i + 0.5, depth[f, i, j])
            n = 0
            for g in neighbours[f]:
                if g < 0:
                    continue
                column, row, there = _project(rotations[g], translations[g], camera, x, y, z)
                column, row = column - 0.5, row - 0.5
                if not (there > 0 and 0 <= column < width - 1 and 0 <= row < height - 1):
                    continue
                top, side = int(row), int(column)
                # A masked neighbour has depth 0, which no mean near an edge of the surface agrees with.
                if abs(_bilinear(depth[g], top, side, row - top, column - side) - there) > depth_share * there:
                    continue
                values[n] = _bilinear(left[g], top, side, row - top, column - side)
                n += 1
            if n >= fewest_views:
                some = np.sort(values[:n])
                median = _median(some)
                # For normal errors the deviation is 1.4826 times their median size, and a median is 1.2533 times less sure than a mean.
                error = 1.2533 * 1.4826 * _median(np.sort(np.abs(some - median))) / math.sqrt(n)
                if abs(median) > clear * error:
                    out[f, i, j] = median


@kernel(parallel=True)
def _footprint_means(
    centres: Floats,
    radii: Floats,
    views: tuple[Floats, Floats, Floats, Floats],
    pyramid: tuple[Floats, Ints, Ints],
    depth_share: float,
    out: Floats,
) -> None:
    """See `Footprints.means`."""
    depth, rotations, translations, camera = views
    flat, starts, shapes = pyramid
    frames, height, width = depth.shape
    for n in nb.prange(len(centres)):
        total, seen = 0.0, 0
        for f in range(frames):
            column, row, there = _project(rotations[f], translations[f], camera, centres[n, 0], centres[n, 1], centres[n, 2])
            if not (there > 0 and 0 <= column < width and 0 <= row < height):
                continue
            i, j = int(row), int(column)
            if abs(depth[f, i, j] - there) > depth_share * there + radii[n]:
                continue
            level, across = 0, 2 * radii[n] * camera[0] / there
            while across > 1.5 and level < len(shapes) - 1:
                across *= 0.5
                level += 1
            rows, columns = shapes[level]
            i, j = min(i >> level, rows - 1), min(j >> level, columns - 1)
            total += flat[starts[level] + (f * rows + i) * columns + j]
            seen += 1
        if seen > 0:
            out[n] = total / seen
