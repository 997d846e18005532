"""Points on the surface that the model shows: position, colour, temperature and its error, from the cameras that took the photographs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.io.exports.subject import Subject
from rtgs.maths.geometry import SE3
from rtgs.maths.sh import C0
from rtgs.records.camera import Camera
from rtgs.renderer import Render, render

_OPAQUE = 0.95  # of a pixel that counts as surface
_SEEN = 0.05  # opacity below which Gaussians do not count
_STEP = 0.05  # relative step of depth between neighbours from which on a pixel is an edge: its mean depth lies in the air
_MOST = 4_000_000  # points before they are thinned


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """P points of the surface.

    Attributes:
        xyz: `[P, 3]` float64, in the scene's world.
        rgb: `[P, 3]` float32 in [0, 1].
        temperature, error: `[P]` float32, in the thermal model's unit. The error is the standard error of the Gaussians that are
            seen there, averaged as their colours are; NaN where the model has none.
        views: `[P]` int32, how many views have seen the surface there.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.float32]
    temperature: NDArray[np.float32]
    error: NDArray[np.float32]
    views: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True, eq=False)
class View:
    """One rendered view `[h, w]`: colours, temperature, its error, and depth, NaN where there is no surface."""

    rgb: NDArray[np.float32]
    temperature: NDArray[np.float32]
    error: NDArray[np.float32]
    depth: NDArray[np.float32]


def surface_view(subject: Subject, camera: Camera, pose: SE3, *, opaque: float = _OPAQUE) -> View:
    """Render all layers from one camera; `pose` is `camera_from_world`."""
    rgb, thermal = subject.rgb, subject.thermal
    with torch.no_grad():
        view = render(rgb.gaussians, camera, pose, settings=replace(rgb.settings, with_depth=True))
    assert view.depth is not None
    alpha = view.alpha.numpy()
    solid = alpha >= opaque
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.where(solid, view.depth.numpy() / alpha, np.nan)
    with torch.no_grad():
        warm = render(thermal.gaussians, camera, pose, settings=thermal.settings)
    temperature = thermal.color_range.expand(_of_surface(warm, thermal.background)[..., 0])
    return View(_of_surface(view, rgb.background).clip(0.0, 1.0), temperature, _error(subject, camera, pose), depth)


def _of_surface(view: Render, background: torch.Tensor) -> NDArray[np.float32]:
    """`[h, w, C]`: the mean of the Gaussians alone where there are any. What shines through between them is no part of the surface."""
    alpha = view.alpha[..., None]
    alone = view.color.detach() / alpha.clamp_min(_SEEN)
    return torch.where(alpha > _SEEN, alone, view.over(background)).detach().numpy()


def pixel_size(subject: Subject) -> float:
    """About the width of a thermal pixel on the surface, in world units: from the median depth of the first frame."""
    frame = subject.scene.frames[0].name
    pose = subject.scene.rgb_from_world(frame)
    camera = subject.scene.rig.rgb
    small = camera.resized(min(camera.width, 160), max(1, round(min(camera.width, 160) * camera.height / camera.width)))
    depth = surface_view(subject, small, pose, opaque=0.5).depth
    if not np.isfinite(depth).any():
        raise RtgsError(
            "export: the model shows no surface in the first frame, so no size can be chosen; give --spacing-m or --pixel-m."
        )
    return float(np.nanmedian(depth)) / subject.scene.rig.thermal.fl_x


def surface_points(subject: Subject, spacing: float, progress: Progress | None = None) -> SurfacePoints:
    """Points of all views, thinned to one in each cell of a grid.

    Args:
        spacing: width of a cell, world units.

    Raises:
        RtgsError: no view shows a surface.
    """
    scene, frames = subject.scene, subject.scene.frames
    camera = scene.rig.rgb
    shrink = max(1, round(camera.fl_x / scene.rig.thermal.fl_x / 2))
    shrink = max(shrink, int(np.ceil((camera.width * camera.height * len(frames) / _MOST) ** 0.5)))
    camera = camera.reduced(min(shrink, camera.width, camera.height))
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fl_x
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fl_y
    rays = np.stack([*np.broadcast_arrays(x[None], y[:, None]), np.ones((camera.height, camera.width))], axis=-1)
    found: list[tuple[NDArray, ...]] = []
    for i, frame in enumerate(frames):
        view = surface_view(subject, camera, scene.rgb_from_world(frame.name))
        inside = _is_smooth(view.depth)
        points = scene.world_from_rgb[frame.name].apply(rays[inside] * view.depth[inside][:, None].astype(np.float64))
        found.append((points, view.rgb[inside], view.temperature[inside], view.error[inside], np.full(len(points), i)))
        if progress is not None:
            progress(i + 1, len(frames), frame.name)
    xyz, rgb, temperature, error, view_of = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if len(xyz) == 0:
        raise RtgsError("export: no view shows an opaque surface, so there are no points.")
    return _thinned(xyz, rgb, temperature, error, view_of, spacing)


def _thinned(xyz: NDArray, rgb: NDArray, temperature: NDArray, error: NDArray, view_of: NDArray, spacing: float) -> SurfacePoints:
    """The mean of what lies in each cell of a grid. Cells that a single view has filled are left out, if others have more."""
    cells = np.floor((xyz - xyz.min(axis=0)) / spacing).astype(np.int64)
    code = cells @ np.array([1, 1 << 21, 1 << 42])
    _, cell_of, count = np.unique(code, return_inverse=True, return_counts=True)

    def mean(values: NDArray) -> NDArray:
        columns = [np.bincount(cell_of, column, len(count)) / count for column in np.atleast_2d(values.T)]
        return np.stack(columns, axis=-1) if values.ndim > 1 else columns[0]

    seen = np.unique(np.stack([cell_of, view_of]), axis=1)[0]
    views = np.bincount(seen, minlength=len(count))
    kept = views >= min(2, int(views.max()))
    layers = [mean(values)[kept].astype(np.float32) for values in (rgb, temperature, error)]
    return SurfacePoints(mean(xyz)[kept], layers[0], layers[1], layers[2], views[kept].astype(np.int32))


def _is_smooth(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """`[h, w]`: where depth is known all around and makes no step."""
    known = np.where(np.isfinite(depth), depth, -1e9).astype(np.float32)
    around = np.ones((3, 3), np.uint8)
    highest, lowest = cv2.dilate(known, around), cv2.erode(known, around)
    return (lowest > 0) & (highest - lowest < _STEP * lowest)


def _error(subject: Subject, camera: Camera, pose: SE3) -> NDArray[np.float32]:
    """`[h, w]`: standard errors of the thermal Gaussians, composited as their temperatures are."""
    model = subject.thermal
    if model.temperatures is None:
        return np.full((camera.height, camera.width), np.nan, np.float32)
    # The colour of zero harmonics is ½; colours are cut at zero, and standard errors are above it.
    std = torch.as_tensor((np.maximum(model.temperatures.std, 0.0) - 0.5) / C0, dtype=torch.float32)
    gaussians = replace(model.gaussians, sh=std[:, None, None])
    with torch.no_grad():
        view = render(gaussians, camera, pose, settings=model.settings)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(view.alpha.numpy() > _SEEN, view.color[..., 0].numpy() / view.alpha.numpy(), np.nan).astype(np.float32)
