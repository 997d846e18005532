"""A run with an asymmetric model: a corner of three arms of different lengths, colours and temperatures, over a square floor.

The given frame is turned and in another unit than metres, as structure from motion gives it. The truth is in the upright frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.config import ExportConfig
from rtgs.io.exports.subject import Subject
from rtgs.maths.geometry import SE3, Sim3, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.models import GaussianTemperatures, RgbModel, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CountsToCelsius, LinearRange
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.records.spots import Spot, SpotList
from rtgs.renderer import RenderSettings

SFM_PER_METRE = 2.5
BASELINE_M = 0.1
RANGE = LinearRange(10.0, 60.0)
ARMS_M = {"x": 1.5, "y": 1.0, "z": 0.5}
ARM_COLOURS = {"x": (0.9, 0.1, 0.1), "y": (0.1, 0.8, 0.1), "z": (0.1, 0.2, 0.9)}
ARM_C = {"x": 50.0, "y": 40.0, "z": 30.0}
FLOOR_C, FLOOR_COLOUR = 20.0, (0.5, 0.5, 0.4)
GIVEN_FROM_UPRIGHT = Sim3(SFM_PER_METRE, rotation_from_axis_angle((1.9, 0.3, -0.4)), np.array([3.0, -1.0, 2.0]))


@dataclass(frozen=True, eq=False)
class Corner:
    """The subject, and the truth in the upright frame in metres: positions `[N, 3]`, sizes, colours `[N, 3]`, °C `[N]`."""

    subject: Subject
    xyz: NDArray[np.float64]
    sizes: NDArray[np.float64]
    colours: NDArray[np.float64]
    celsius: NDArray[np.float64]


def corner(settings: ExportConfig | None = None, *, origin: float = 0.0) -> Corner:
    """Build it. `origin` shifts the given frame."""
    xyz, sizes, colours, celsius = _truth()
    given = replace(GIVEN_FROM_UPRIGHT, translation=GIVEN_FROM_UPRIGHT.translation + origin)
    rig = Rig(
        Camera("PINHOLE", 128, 96, 120.0, 120.0, 64.0, 48.0),
        Camera("PINHOLE", 40, 32, 40.0, 40.0, 20.0, 16.0),
        SE3(np.eye(3), np.array([BASELINE_M, 0.0, 0.0])),
    )
    frames, poses = [], {}
    for i in range(8):
        angle = 2 * np.pi * i / 8
        eye = np.array([3.0 * np.cos(angle), 3.0 * np.sin(angle), 2.0 + 0.3 * (i % 3)])
        poses[f"frame_{i:03d}"] = given.carry(look_at(eye, (0.3, 0.2, 0.1)))
        picture = np.full((96, 128, 3), (i + 1) / 10, np.float32)
        frames.append(Frame(f"frame_{i:03d}", picture, np.full((32, 40), 15.0 + i, np.float32)))
    masks = np.ones((96, 128), bool), np.ones((32, 40), bool)
    capture = Capture(Path("capture"), rig, rig, tuple(frames), *masks, CountsToCelsius(1.0, 0.0), None)
    points = SparsePoints(given.apply(xyz), colours.astype(np.float32))
    scene = Scene(capture, poses, points, {}).recentred()
    world_from_upright = scene.given_from_world.inverse() @ given
    means, quats, log_scales = (
        torch.as_tensor(a, dtype=torch.float32) for a in (xyz, np.tile([1.0, 0, 0, 0], (len(xyz), 1)), np.log(sizes))
    )
    harmonics = torch.as_tensor((colours - 0.5) / C0, dtype=torch.float32)[:, None]
    gaussians = Gaussians(means, quats, log_scales, torch.full((len(xyz),), 5.0), harmonics)
    turned = gaussians.turned(world_from_upright.rotation).scaled(world_from_upright.factor)
    means = torch.as_tensor(world_from_upright.apply(xyz), dtype=torch.float32)
    rgb = RgbModel(replace(turned, means=means), torch.tensor([0.1, 0.2, 0.3]), RenderSettings())
    level = torch.as_tensor((RANGE.normalise(celsius) - 0.5) / C0)[:, None, None]
    known = GaussianTemperatures(*(np.asarray(a, np.float32) for a in (celsius, 0.1 + 0 * celsius, 8 + 0 * celsius)))
    thermal = ThermalModel(
        gaussians=replace(rgb.gaussians, sh=level),
        background=torch.tensor([0.0]),
        unit="°C",
        range=RANGE,
        color_range=RANGE,
        settings=RenderSettings(),
        sfm_per_metre=SFM_PER_METRE,
        temperatures=known,
    )
    return Corner(
        Subject(scene, rgb, thermal, 1 / SFM_PER_METRE, SFM_PER_METRE, settings or ExportConfig()), xyz, sizes, colours, celsius
    )


def _truth() -> tuple[NDArray[np.float64], ...]:
    steps = 0.05
    parts = []
    for axis, name in enumerate("xyz"):
        along = np.arange(steps, ARMS_M[name] + 1e-9, steps)
        parts.append((np.eye(3)[axis] * along[:, None], ARM_COLOURS[name], ARM_C[name], 0.07))
    side = np.arange(-1.8, 1.81, 0.075)
    floor = np.stack([*np.meshgrid(side, side), np.full((len(side), len(side)), -0.1)], axis=-1).reshape(-1, 3)
    parts.append((floor, FLOOR_COLOUR, FLOOR_C, 0.045))
    xyz = np.concatenate([p[0] for p in parts])
    # The floor's Gaussians are longest along x and flat: what turns a model must turn them too.
    sizes = np.concatenate([np.tile((p[3], 0.7 * p[3], 0.01) if p[3] < 0.05 else (p[3],) * 3, (len(p[0]), 1)) for p in parts])
    colours = np.concatenate([np.tile(p[1], (len(p[0]), 1)) for p in parts])
    return xyz, sizes, colours, np.concatenate([np.full(len(p[0]), p[2]) for p in parts])


SPOT_AT = (1.0, 0.0, 0.0)  # on the warm arm, upright frame, metres


def spot_list(scene: Corner) -> SpotList:
    """One spot, on the warm arm."""
    given = GIVEN_FROM_UPRIGHT.apply(np.array(SPOT_AT)) * scene.subject.unit_per_sfm
    at = (float(given[0]), float(given[1]), float(given[2]))
    return SpotList((Spot("hot", at, 0.01, 50.0, 48.0, 20.0, 0.3, 5, 5, ("frame_000",), 49.0, 0.2),), "°C", "3 °C or more off")
