"""What training starts from: Gaussians at the sparse points, or at random ones, and the colour of the background."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from rtgs.base.threads import in_order
from rtgs.config import RgbConfig
from rtgs.maths import sh
from rtgs.records.capture import Frame
from rtgs.records.gaussians import Gaussians
from rtgs.records.scene import Scene


def starting_points(scene: Scene, config: RgbConfig, most: int) -> tuple[NDArray[np.float64], NDArray[np.floating]]:
    """Positions `[P, 3]` and colours `[P, 3]` of the scene's sparse points, `most` of them drawn at random where there are more.

    A scene without sparse points gets random ones.
    """
    if not len(scene.points):
        return random_points(scene, min(config.random_points, most), config.seed)
    xyz, rgb = scene.points.xyz, scene.points.rgb
    if len(xyz) > most:
        chosen = np.random.default_rng(config.seed).permutation(len(xyz))[:most]
        xyz, rgb = xyz[chosen], rgb[chosen]
    return xyz, rgb


def random_points(scene: Scene, n: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions `[n, 3]`, uniform in what the cameras look at (frusta cut off at twice the scene's extent), and grey colours `[n, 3]`."""
    rng = np.random.default_rng(seed)
    camera, frames = scene.rig.rgb, scene.train_frames
    which = rng.integers(len(frames), size=n)
    # Uniform in the frustum's volume: depth by the cube root.
    depth = 2.0 * max(scene.extent, 1e-9) * rng.uniform(0.05**3, 1.0, n) ** (1 / 3)
    rays = np.stack(
        [
            (rng.uniform(0, camera.width, n) - camera.cx) / camera.fl_x,
            (rng.uniform(0, camera.height, n) - camera.cy) / camera.fl_y,
            np.ones(n),
        ],
        axis=1,
    )
    in_camera = rays * depth[:, None]
    xyz = np.empty((n, 3))
    for k, frame in enumerate(frames):
        chosen = which == k
        xyz[chosen] = scene.world_from_rgb[frame.name].apply(in_camera[chosen])
    return xyz, rng.uniform(0.2, 0.8, (n, 3))


def initial_gaussians(xyz: NDArray[np.float64], rgb: NDArray[np.floating], sh_degree: int) -> Gaussians:
    """One Gaussian a point: its size is the mean distance to its three nearest neighbours, its opacity 0.1.

    Args:
        xyz: `[P, 3]`, world units.
        rgb: `[P, 3]` in [0, 1].
        sh_degree: highest band; all bands but the first are zero.
    """
    distances, _ = cKDTree(xyz).query(xyz, k=min(4, len(xyz)))
    size = np.sqrt((np.atleast_2d(distances)[:, 1:] ** 2).mean(axis=1)) if len(xyz) > 1 else np.ones(1)
    size = np.clip(size, np.percentile(size, 1), np.percentile(size, 99)).clip(min=1e-12)
    n = len(xyz)
    coefficients = torch.zeros(n, sh.coefficients(sh_degree), 3)
    coefficients[:, 0] = (torch.as_tensor(rgb, dtype=torch.float32) - 0.5) / sh.C0
    quats = torch.zeros(n, 4)
    quats[:, 0] = 1.0
    return Gaussians(
        torch.as_tensor(xyz, dtype=torch.float32),
        quats,
        torch.as_tensor(np.log(size), dtype=torch.float32)[:, None].repeat(1, 3),
        torch.full((n,), math.log(0.1 / 0.9)),
        coefficients,
    )


def initial_background(scene: Scene, config: RgbConfig) -> Tensor:
    """`[3]`: the fixed colour, or, where it is learned, the median of the training frames' borders.

    A blank background reaches the border of the picture. For any other, the border's median is as good a start as any colour.
    """
    fixed = fixed_background(config)
    if fixed is not None:
        return fixed
    # All images are loaded here for the first time, so this goes by threads.
    borders = list(in_order(_border, scene.train_frames, nb.get_num_threads()))
    return torch.as_tensor(np.median(np.concatenate(borders), axis=0), dtype=torch.float32)


def fixed_background(config: RgbConfig) -> Tensor | None:
    """`[3]`: the colour that the settings name; None where it is to be found from the photographs."""
    return None if config.background == "learned" else torch.full((3,), 1.0 if config.background == "white" else 0.0)


def _border(frame: Frame) -> NDArray[np.float32]:
    """`[P, 3]`: the outermost pixels of an RGB image, its corners twice."""
    image = frame.rgb
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
