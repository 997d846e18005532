"""A textured wall seen by a camera pair that slides along it and rolls: the scale is known, and a plane shows all of it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from tests.helpers.scene_record import scene_of

from rtgs.maths import sh
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CELSIUS
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import History, Scan

TRUTH = 0.4  # SfM units per metre
PLANE_M = 1.0
FRAMES = 11
RGB = Camera("PINHOLE", 72, 64, 70.0, 70.0, 36.3, 31.6)
THERMAL = Camera("PINHOLE", 48, 44, 52.0, 52.0, 24.4, 21.7)
RIG = Rig(RGB, THERMAL, SE3(np.eye(3), np.array([0.12, -0.03, 0.0])))


def wall_model(count: int = 26) -> Gaussians:
    """An opaque textured wall across the optical axis, `PLANE_M` metres ahead; colours differ from Gaussian to Gaussian."""
    generator = torch.Generator().manual_seed(0)
    side = torch.linspace(-0.42, 0.42, count)
    y, x = torch.meshgrid(side, side, indexing="ij")
    means = torch.stack([x.ravel(), y.ravel(), torch.full((count**2,), TRUTH * PLANE_M)], dim=1)
    n = len(means)
    return Gaussians(
        means,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.log(torch.tensor([0.022, 0.022, 0.001])).repeat(n, 1),
        torch.full((n,), 3.0),
        torch.rand(n, 1, 3, generator=generator) - 0.5,
    )


@lru_cache(maxsize=1)
def wall_scene() -> tuple[Scene, RgbModel]:
    """A camera pair that slides along the wall and rolls, and the RGB model of the wall. Temperatures are a model of the same geometry.

    Without roll a wrong scale would shift all thermal images alike along the wall, and nobody could tell.
    """
    wall = wall_model()
    settings = RenderSettings()
    x, y = wall.means[:, 0], wall.means[:, 1]
    celsius = 20 + 3 * torch.sin(17 * x) + 2 * torch.cos(23 * y + 5 * x)
    warm = replace(wall, sh=((celsius - 10) / 20 - 0.5)[:, None, None] / sh.C0)
    generator = np.random.default_rng(1)
    names = [f"f{i:02d}" for i in range(FRAMES)]
    rolls = [rotation_from_axis_angle([0, 0, angle]) for angle in generator.uniform(-0.8, 0.8, FRAMES)]
    centres = TRUTH * generator.uniform(-0.3, 0.3, (FRAMES, 3)) * [1, 1, 0]
    poses = {n: SE3(r, c) for n, r, c in zip(names, rolls, centres, strict=True)}

    rgb, thermal = [], []
    for name in names:
        world_from_thermal = poses[name] @ RIG.rgb_from_thermal.with_baseline_scaled(TRUTH)
        with torch.no_grad():
            rgb.append(render(wall, RGB, poses[name].inverse(), settings=settings).color.numpy())
            level = (
                render(warm, THERMAL, world_from_thermal.inverse(), settings=settings).over(torch.tensor([0.5])).numpy()[..., 0]
            )
        thermal.append((10 + 20 * level).astype(np.float32))
    points = SparsePoints(wall.means[::7].double().numpy(), np.zeros((len(wall.means[::7]), 3), np.float32))
    scene = scene_of(RIG, poses, rgb=rgb, thermal=thermal, points=points, radiometry=CELSIUS)
    return scene, RgbModel(wall, torch.zeros(3), settings)


def estimate(sfm_per_metre: float) -> ScaleEstimate:
    local, history = Scan((), (), (), {}), History()
    return ScaleEstimate(
        sfm_per_metre, 0.01, (0.39, 0.41), "ok", "", "global", 1.0, (0.1, 1.0), RIG.baseline_m, (), None, local, history
    )
