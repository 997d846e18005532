"""A run of a textured wall whose temperature rises evenly: every place, length and temperature that a viewer shows is known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tests.helpers.wall_scene import RIG, TRUTH, wall_model

from rtgs.config import RunConfig
from rtgs.images.pictures import save_png, save_tiff, to_picture
from rtgs.io.capture import load_capture
from rtgs.io.rig import write_rig
from rtgs.io.transforms import write_transforms
from rtgs.maths import sh
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import GaussianTemperatures, RgbModel, ThermalModel
from rtgs.records.capture import SparsePoints
from rtgs.records.radiometry import CENTIKELVIN, LinearRange
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import History, Scan, Status
from rtgs.viewer.contents import Contents
from rtgs.viewer.engine import Eye

STD_C = 0.25
CI95 = (0.98 * TRUTH, 1.02 * TRUTH)
NAMES = tuple(f"f{i:02d}" for i in range(8))


def truth_c(position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """°C of the wall at positions `[..., 3]` in metres."""
    return np.asarray(25.0 + 4.0 * position_m[..., 0] + 2.0 * position_m[..., 1])


def poses() -> dict[str, SE3]:
    """world_from_rgb by frame, in SfM units: a slide along the wall with rolls."""
    rng = np.random.default_rng(2)
    return {
        name: SE3(rotation_from_axis_angle([0, 0, rng.uniform(-0.3, 0.3)]), TRUTH * rng.uniform(-0.2, 0.2, 3) * [1, 1, 0])
        for name in NAMES
    }


def models() -> tuple[RgbModel, ThermalModel]:
    wall = wall_model(40)  # so fine that it hardly matters which of two Gaussians lies in front
    wall = replace(wall, log_scales=torch.log(torch.tensor([0.015, 0.015, 0.001])).repeat(len(wall), 1))
    span = LinearRange(0.0, 50.0)
    level = torch.from_numpy(truth_c(wall.means.numpy() / TRUTH) / span.width).float()
    warm = replace(wall, sh=((level - 0.5) / sh.C0)[:, None, None])
    found = [np.full(len(wall), value, np.float32) for value in (25.0, STD_C, 5.0)]
    thermal = ThermalModel(
        gaussians=warm,
        background=torch.tensor([0.5]),
        unit="°C",
        range=LinearRange(20.0, 30.0),
        color_range=span,
        settings=RenderSettings(),
        sfm_per_metre=TRUTH,
        temperatures=GaussianTemperatures(*found),
    )
    return RgbModel(wall, torch.zeros(3), RenderSettings()), thermal


def estimate(status: Status = "ok") -> ScaleEstimate:
    s = np.geomspace(0.2, 0.8, 41)
    loss = 0.9 - 0.3 * np.exp(-((np.log(s / TRUTH) / 0.2) ** 2))
    scan = Scan(tuple(s.tolist()), tuple(loss.tolist()), tuple((0 * s).tolist()), {})
    return ScaleEstimate(
        TRUTH,
        0.01,
        CI95,
        status,
        "made up",
        "global",
        1.0,
        (0.2, 0.8),
        RIG.baseline_m,
        NAMES,
        scan,
        scan,
        History(),
    )


def write_wall_capture(root: Path) -> Path:
    """The capture: photographs are renders of the models."""
    rgb, thermal = models()
    for name, pose in poses().items():
        from_thermal = pose @ RIG.rgb_from_thermal.with_baseline_scaled(TRUTH)
        celsius = thermal.render(RIG.thermal, from_thermal.inverse())
        save_png(root / "rgb" / f"{name}.png", to_picture(rgb.render(RIG.rgb, pose.inverse())))
        save_tiff(root / "thermal" / f"{name}.tiff", np.rint(CENTIKELVIN.counts(celsius)).astype(np.uint16))
    write_transforms(root / "transforms.json", RIG.rgb, poses(), {name: f"rgb/{name}.png" for name in NAMES})
    write_rig(root / "rig.json", RIG, CENTIKELVIN)
    return root


def write_wall_run(run: Path, capture: Path) -> Path:
    """A run of it with both models, scale and poses."""
    folder = RunFolder(run)
    folder.write_config(SavedRun(capture, RunConfig()))
    points = SparsePoints(wall_model().means[::7].double().numpy(), np.zeros((len(wall_model().means[::7]), 3), np.float32))
    scene = Scene(load_capture(capture), poses(), points, {})
    folder.write_scene(scene, TRUTH)
    rgb, thermal = models()
    folder.write_rgb(rgb, scene.given_from_world)
    folder.write_thermal(thermal, scene.given_from_world)
    folder.write_scale(estimate())
    return run


def wall_eye(contents: Contents, width: int = 80, height: int = 60, tilt: float = 0.1) -> Eye:
    """It stands at the origin of the capture's frame and looks at the wall, a little aslant."""
    given = SE3(rotation_from_axis_angle([0.0, tilt, 0.0]), np.zeros(3))
    return Eye.of(width, height, math.radians(40), contents.given_from_world.carry_inverse(given))
