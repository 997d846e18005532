"""A scene whose rig is taken away, to be found again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from tests.helpers.scale_scenes import RIG, drawn, with_rig

from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.models import RgbModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import Rig, RigStart
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings


def unknown(scene: Scene, *, turned: tuple[float, float, float], zoom: float = 0.95, baseline_m: float | None = None) -> Scene:
    """The rig's rotation off by this many degrees about each axis, its focal length by this factor, and no translation known."""
    rig = scene.rig
    turn = rotation_from_axis_angle(np.radians(turned))
    thermal = replace(rig.thermal, fl_x=zoom * rig.thermal.fl_x, fl_y=zoom * rig.thermal.fl_y)
    pose = SE3(rig.rgb_from_thermal.rotation @ turn, np.array([baseline_m or 1.0, 0.0, 0.0]))
    start = RigStart(baseline_m=baseline_m, centre_known=True)
    return with_rig(scene, replace(rig, thermal=thermal, rgb_from_thermal=pose, start=start, calibration_std=None))


def apart_deg(a: Rig, b: Rig) -> float:
    """The angle between two rigs' rotations."""
    turn = axis_angle_from_rotation(a.rgb_from_thermal.rotation.T @ b.rgb_from_thermal.rotation)
    return math.degrees(float(np.linalg.norm(turn)))


def far_wall(depth: float, frames: int = 12) -> tuple[Scene, RgbModel]:
    """A wall of irregular spots across the view, seen from places beside each other; the thermal camera is 0.2 m to the side."""
    g, n = torch.Generator().manual_seed(0), 900
    rig = replace(RIG, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.array([0.2, 0.0, 0.0])))
    xy = (torch.rand(n, 2, generator=g) * 2 - 1) * torch.tensor([1.2, 1.0]) * depth
    gaussians = Gaussians(
        torch.cat([xy, depth + 0.001 * depth * torch.rand(n, 1, generator=g)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        (depth * torch.tensor([1.0, 1.0, 1e-4]) * (0.03 + 0.05 * torch.rand(n, 1, generator=g))).log(),
        torch.full((n,), 2.0),
        ((0.1 + 0.8 * torch.rand(n, 1, 1, generator=g)) - 0.5).repeat(1, 1, 3) / C0,
    )
    model = RgbModel(gaussians, torch.zeros(3), RenderSettings(near_plane=1e-3 * depth))
    poses = [SE3(np.eye(3), np.array([0.05 * depth * (k % 4), 0.05 * depth * (k // 4), 0.0])) for k in range(frames)]
    return drawn(model, poses, rig, 1.0, noise=0.3), model
