"""A wall with spots, of many small Gaussians, and photographs of it: known positions, areas and temperatures."""

from __future__ import annotations

import math

import numpy as np
import torch
from tests.helpers.scene_record import altered, scene_of

from rtgs.maths.geometry import SE3, look_at
from rtgs.maths.sh import C0
from rtgs.models import ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CELSIUS, LinearRange
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings

CAMERA = Camera("PINHOLE", 96, 80, 110.0, 110.0, 48.0, 40.0)
RIG = Rig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
SFM_PER_METRE = 2.5
SPOTS = [((0.25, 0.10), 12.0, 0.12), ((-0.30, -0.15), -8.0, 0.16)]  # metres on the wall, °C, FWHM in metres
SPAN = LinearRange(0.0, 50.0)


def wall(spots: list[tuple[tuple[float, float], float, float]]) -> ThermalModel:
    """A wall across z = 0, 1.6 m × 1.2 m, of 20 °C with spots."""
    x, y = torch.meshgrid(torch.arange(-0.8, 0.8, 0.02), torch.arange(-0.6, 0.6, 0.02), indexing="ij")
    x, y = x.ravel(), y.ravel()
    celsius = torch.full_like(x, 20.0)
    for (a, b), height, fwhm in spots:
        celsius += height * torch.exp(-4 * math.log(2) * ((x - a) ** 2 + (y - b) ** 2) / fwhm**2)
    n = len(x)
    return ThermalModel(
        gaussians=Gaussians(
            SFM_PER_METRE * torch.stack([x, y, torch.zeros(n)], dim=1),
            torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
            torch.log(SFM_PER_METRE * torch.tensor([0.013, 0.013, 0.001])).repeat(n, 1),
            torch.full((n,), 3.0),
            ((celsius / 50 - 0.5) / C0)[:, None, None],
        ),
        background=torch.tensor([0.4]),
        unit="°C",
        range=SPAN,
        color_range=SPAN,
        settings=RenderSettings(near_plane=0.05),
        sfm_per_metre=SFM_PER_METRE,
    )


def photographed(model: ThermalModel) -> Scene:
    """Twelve views of the wall from 1.4 m, slantingly too. Photographs are the model's renders; the RGB ones show temperatures as gray."""
    eyes = [SFM_PER_METRE * np.array([math.cos(0.6 * k), 0.7 * math.sin(1.1 * k), -1.4]) for k in range(12)]
    scene = scene_of(RIG, [look_at(eye, [0, 0, 0]) for eye in eyes], radiometry=CELSIUS)
    images = {f.name: model.render(CAMERA, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    gray = {f.name: model.render(CAMERA, scene.rgb_from_world(f.name)) / 50 for f in scene.frames}
    return altered(scene, thermal=images, rgb={name: np.repeat(image[..., None], 3, axis=2) for name, image in gray.items()})
