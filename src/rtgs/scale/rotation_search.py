"""Where an unknown thermal camera looks and how wide: every rotation and focal length within reach, from one wide render a frame.

Without a baseline, turning a camera only shifts a picture whose axes are angles. So each frame is rendered once, wide, from where its RGB
camera stands, and the thermal image is laid over it at every shift at once by Fourier transforms: the agreement of edges (Eq. 6, per edge)
is three correlations of products of the normalised gradients. What is left to try one by one is the roll and the focal length.

Angles are longitude and latitude. Away from the middle a shift is not quite a rotation; the descent that follows mends that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy import fft

from rtgs.images.filters import GRAY_WEIGHTS, to_gray
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.scale.progress import RenderProgress

Picture = NDArray[np.float32]

_CELLS = 64  # over the shorter side of the thermal image
_WIDEST_DEG = 140.0  # that is rendered with a pinhole camera
_ROLL_STEP_DEG = 2.5  # moves the rim of the picture by a cell and a half
_FOCAL_STEP = 0.04  # likewise
_EDGE = 3.0  # ε in mean gradients, as in `Comparison`
_APART = (2, 3, 3)  # steps of roll, and cells along latitude and longitude: nearer ones are the same peak


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place to descend from.

    Attributes:
        rotation: `[3, 3]`, of `rgb_from_thermal`. zoom: focal length over the one it started from.
        agreement: mean over frames; 1 where all edges are parallel.
    """

    rotation: NDArray[np.float64]
    zoom: float
    agreement: float


def rotation_candidates(
    scene: Scene,
    model: RgbModel,
    frames: Sequence[Frame],
    thermal: Mapping[str, Picture],
    progress: RenderProgress,
    *,
    most: int,
) -> list[Candidate]:
    """The best peaks of the agreement, best first.

    Args:
        scene: its rig has a `start`, which says how far to look. thermal: frame name → image in [0, 1].
    """
    rig, start = scene.rig, scene.rig.start
    assert start is not None
    grid = _Grid.of(rig.thermal, start.reach_deg, start.focal_reach)
    rolls = np.radians(_steps(start.reach_deg, _ROLL_STEP_DEG))
    zooms = 1 + _steps(start.focal_reach, _FOCAL_STEP)
    mask = scene.capture.thermal_mask.astype(np.float32)
    total = np.zeros((len(rolls), len(zooms), grid.n, grid.n))
    for frame in frames:
        wide = grid.render(scene, model, frame)
        progress("rotation")
        total = total + _agreement(grid, wide, thermal[frame.name], mask, rig.thermal, rolls, zooms)
    return _peaks(total / len(frames), grid, rolls, zooms, rig.rgb_from_thermal.rotation, start.reach_deg, most)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Pixels that are angles: square, `n` to a side, `step` radians apart, the axis of the starting rotation in the middle.

    Attributes:
        rays: `[n, n, 3]`, directions. wide: the pinhole camera that covers them. padded: side of the Fourier transforms.
    """

    n: int
    step: float
    rays: NDArray[np.float64]
    wide: Camera
    padded: int

    @staticmethod
    def of(camera: Camera, reach_deg: float, focal_reach: float) -> _Grid:
        half = math.atan(0.5 * max(camera.width, camera.height) / (camera.fl_x * (1 - focal_reach)))
        span = min(2 * (half + math.radians(reach_deg)), math.radians(_WIDEST_DEG))
        step = 2 * math.atan(0.5 * min(camera.width, camera.height) / camera.fl_x) / _CELLS
        n = math.ceil(span / step)
        angles = (np.arange(n) + 0.5 - n / 2) * step
        longitude, latitude = np.meshgrid(angles, angles)
        rays = np.stack([np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], axis=-1)
        side = 2 * math.ceil(math.tan(span / 2) / step)
        wide = Camera("PINHOLE", side, side, 1 / step, 1 / step, side / 2, side / 2)
        # Turned, the thermal image's corners reach further than its sides, and within reach none may come in again at the other end.
        corners = math.ceil((math.sqrt(2) - 1) * half / step) + 1
        return _Grid(n, step, rays, wide, fft.next_fast_len(n + corners, real=True))

    def render(self, scene: Scene, model: RgbModel, frame: Frame) -> Picture:
        """`[n, n]`: the gray model from the frame's RGB camera, turned as the rig starts."""
        turn = SE3(scene.rig.rgb_from_thermal.rotation, np.zeros(3))
        pose = (scene.world_from_rgb[frame.name] @ turn).inverse()
        settings = replace(model.settings, with_depth=False, channel_weights=GRAY_WEIGHTS)
        with torch.no_grad():
            view = render(model.gaussians, self.wide, pose, settings=settings)
        gray = (view.color[..., 0] + (1.0 - view.alpha) * to_gray(model.background)).numpy().astype(np.float32)
        return _read(gray, self.wide, self.rays)[0]

    def spectra(self, planes: Sequence[Picture]) -> list[NDArray[np.complex64]]:
        return [fft.rfft2(plane, (self.padded, self.padded)) for plane in planes]


def _steps(reach: float, step: float) -> NDArray[np.float64]:
    """From −reach to reach, 0 among them, no further apart than `step`."""
    count = math.ceil(reach / step - 1e-9)
    return np.linspace(-reach, reach, 2 * count + 1)


def _read(image: Picture, camera: Camera, rays: NDArray[np.float64]) -> tuple[Picture, NDArray[np.bool_]]:
    """`[n, n]`: what a pinhole camera has in these directions, and where it has anything."""
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = np.moveaxis(camera.project(rays), -1, 0)
    seen = (rays[..., 2] > 0) & (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    u, v = (np.where(seen, x, 0.0).astype(np.float32) - np.float32(0.5) for x in (u, v))
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32), seen


def _normals(image: Picture, valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`[2, n, n]`: the gradient over √(its square + ε²), zero where it is not valid."""
    gradient = np.stack([cv2.Sobel(image, cv2.CV_32F, *d, ksize=3) / np.float32(8) for d in ((1, 0), (0, 1))])
    size = np.hypot(*gradient)
    epsilon = max(_EDGE * float(size[valid].mean()) if valid.any() else 0.0, 1e-9)
    return np.asarray(valid * gradient / np.hypot(size, np.float32(epsilon)), np.float32)


def _agreement(
    grid: _Grid,
    wide: Picture,
    thermal: Picture,
    mask: Picture,
    camera: Camera,
    rolls: NDArray[np.float64],
    zooms: NDArray[np.float64],
) -> NDArray[np.float64]:
    """`[rolls, zooms, n, n]`: of one frame, at every shift; the middle is no shift."""
    size = (grid.n, grid.n)
    ax, ay = _normals(wide, np.ones(size, dtype=bool))
    held = grid.spectra([ax * ax, ax * ay, ay * ay, ax * ax + ay * ay])
    block = max(1, round(min(thermal.shape) / _CELLS))
    soft = thermal
    if block > 1:  # cells are larger than pixels
        soft = np.asarray(cv2.GaussianBlur(thermal, (0, 0), 0.5 * block), np.float32)
    found = np.zeros((len(rolls), len(zooms), *size))
    first = grid.padded // 2 - grid.n // 2
    for i, roll in enumerate(rolls):
        rays = grid.rays @ rotation_from_axis_angle(np.array([0.0, 0.0, roll]))
        for j, zoom in enumerate(zooms):
            zoomed = replace(camera, fl_x=camera.fl_x * zoom, fl_y=camera.fl_y * zoom)
            image, seen = _read(soft, zoomed, rays)
            seen &= _read(mask, zoomed, rays)[0] > 0.999
            inner = cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
            bx, by = _normals(image, inner)
            moved = [s.conj() for s in grid.spectra([bx * bx, bx * by, by * by, inner.astype(np.float32)])]
            same = fft.irfft2(held[0] * moved[0] + 2 * held[1] * moved[1] + held[2] * moved[2], (grid.padded,) * 2)
            strength = fft.irfft2(held[3] * moved[3], (grid.padded,) * 2)
            count = max(int(inner.sum()), 1)
            value = same / count / np.sqrt(np.maximum(strength / count, 1e-4))
            found[i, j] = fft.fftshift(value)[first : first + grid.n, first : first + grid.n]
    return found


def _peaks(
    agreement: NDArray[np.float64],
    grid: _Grid,
    rolls: NDArray[np.float64],
    zooms: NDArray[np.float64],
    rotation: NDArray[np.float64],
    reach_deg: float,
    most: int,
) -> list[Candidate]:
    """Peaks within reach, each the highest within a few steps."""
    shifts = (np.arange(grid.n) - grid.n // 2) * grid.step
    within = np.hypot(*np.meshgrid(shifts, shifts)) <= math.radians(reach_deg)
    left = np.where(within, agreement, -np.inf)
    found = list[Candidate]()
    for _ in range(most):
        i, j, y, x = np.unravel_index(int(left.argmax()), left.shape)
        if not np.isfinite(left[i, j, y, x]):
            break
        turn = np.eye(3)
        for axis, angle in ((1, shifts[x]), (0, -shifts[y]), (2, rolls[i])):
            turn = turn @ rotation_from_axis_angle(angle * np.eye(3)[axis])
        found.append(Candidate(rotation @ turn, float(zooms[j]), float(left[i, j, y, x])))
        ranges = [slice(max(0, c - r), c + r + 1) for c, r in zip((i, y, x), _APART, strict=True)]
        left[ranges[0], :, ranges[1], ranges[2]] = -np.inf
    return found
