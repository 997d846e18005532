"""The wall of `wall_scene`, of Gaussians too large for the warm spots that only the thermal camera sees on it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from tests.helpers.scene_record import scene_of
from tests.helpers.wall_scene import PLANE_M, RIG, THERMAL, TRUTH, wall_model

from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.radiometry import CELSIUS
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings

SPOTS = np.array([[0.03, 0.02], [-0.06, 0.05], [0.05, -0.07], [-0.04, -0.05]]) * TRUTH / 0.4
EXCESS_C = np.array([12.0, -12.0, 12.0, -12.0])
SIGMA = 0.012  # 1.6 thermal pixels: FWHM 3.7
LARGE = 0.045  # deviation of the wall's Gaussians: 6 pixels
FRAMES = 18


def wall_celsius(x: NDArray[np.float64], y: NDArray[np.float64], spots: bool) -> NDArray[np.float64]:
    out = 20.0 + 2.0 * np.sin(5 * x) + np.cos(7 * y)
    if spots:
        for (a, b), excess in zip(SPOTS, EXCESS_C, strict=True):
            out = out + excess * np.exp(-0.5 * ((x - a) ** 2 + (y - b) ** 2) / SIGMA**2)
    return out


def on_the_wall(world_from_thermal: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the pixels' rays meet the wall: x and y, `[h, w]` each."""
    c = THERMAL
    j, i = np.meshgrid(np.arange(c.width) + 0.5, np.arange(c.height) + 0.5)
    rays = np.stack([(j - c.cx) / c.fl_x, (i - c.cy) / c.fl_y, np.ones_like(j)], axis=-1) @ world_from_thermal.rotation.T
    t = (TRUTH * PLANE_M - world_from_thermal.translation[2]) / rays[..., 2]
    points = world_from_thermal.translation + t[..., None] * rays
    return points[..., 0], points[..., 1]


@lru_cache(maxsize=2)
def spotted_wall(spots: bool = True) -> tuple[Scene, RgbModel]:
    """A rig that looks at the wall from 18 places and rolls; noise of 0.05 °C."""
    rng = np.random.default_rng(1)
    wall = wall_model(14)
    wall = replace(wall, log_scales=torch.log(torch.tensor([LARGE, LARGE, 0.001])).repeat(len(wall), 1))
    poses = {
        f"f{n:02d}": SE3(rotation_from_axis_angle([0, 0, rng.uniform(-0.8, 0.8)]), TRUTH * rng.uniform(-0.2, 0.2, 3) * [1, 1, 0])
        for n in range(FRAMES)
    }
    thermal = []
    for pose in poses.values():
        clean = wall_celsius(*on_the_wall(pose @ RIG.rgb_from_thermal.with_baseline_scaled(TRUTH)), spots)
        thermal.append((clean + 0.05 * rng.standard_normal(clean.shape)).astype(np.float32))
    scene = scene_of(RIG, poses, thermal=thermal, radiometry=CELSIUS)
    return scene, RgbModel(wall, torch.zeros(3), RenderSettings())


def shares_at_centres(scene: Scene, model: ThermalModel) -> NDArray[np.float64]:
    """What held-out renders show of each spot's excess at its centre, as a share, for every view that sees it."""
    out = []
    for frame in scene.held_out_frames:
        world_from_thermal = scene.world_from_thermal(frame.name, TRUTH)
        image = model.render(THERMAL, world_from_thermal.inverse())
        x, y = on_the_wall(world_from_thermal)
        without, truth = wall_celsius(x, y, False), wall_celsius(x, y, True)
        for a, b in SPOTS:
            i, j = np.unravel_index(((x - a) ** 2 + (y - b) ** 2).argmin(), x.shape)
            if 2 <= i < x.shape[0] - 2 and 2 <= j < x.shape[1] - 2:
                out.append((image - without)[i, j] / (truth - without)[i, j])
    return np.array(out)
