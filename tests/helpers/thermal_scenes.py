"""Small scenes with known temperatures for tests of the thermal fit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from tests.helpers.gaussian_clouds import shell
from tests.helpers.scene_record import altered, scene_of

from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.metrics.basic import mae
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.radiometry import CELSIUS, LinearRange
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.thermal import fit_thermal, training_range
from rtgs.thermal.colors import as_model
from rtgs.thermal.design import Design
from rtgs.thermal.fit import Fit
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import LinearSettings

RIG = Rig(
    Camera("PINHOLE", 32, 28, 34.0, 34.0, 16.0, 14.0),
    Camera("PINHOLE", 36, 30, 40.0, 41.0, 17.5, 15.3),
    SE3(rotation_from_axis_angle([0.02, -0.03, 0.04]), np.array([0.25, -0.07, 0.03])),
)
SFM_PER_METRE = 1.7


@lru_cache(maxsize=1)
def known() -> tuple[Scene, RgbModel, ThermalModel]:
    """A ball of 150 Gaussians with known temperatures of 15 to 45 °C, before a wall at 20 °C; frames 0 and 8 are held out."""
    g = torch.Generator().manual_seed(1)
    n = 150
    ball = shell(n, g, size=0.13, spread=0.2, coefficients=4).scaled(SFM_PER_METRE)
    settings = RenderSettings(near_plane=0.05)
    rgb = RgbModel(ball, torch.tensor([0.1, 0.3, 0.2]), settings)
    hot = replace(ball, sh=(torch.rand(n, 1, 1, generator=g) - 0.5) / C0)
    span = LinearRange(15.0, 45.0)
    truth = ThermalModel(
        gaussians=hot,
        background=torch.tensor([1 / 6]),
        unit="°C",
        range=span,
        color_range=span,
        settings=settings,
        sfm_per_metre=SFM_PER_METRE,
    )
    poses = []
    for k in range(10):
        eye = SFM_PER_METRE * np.array([2.6 * math.cos(0.7 * k), 2.6 * math.sin(0.7 * k), 0.9 * math.sin(1.9 * k)])
        poses.append(look_at(eye, [0, 0, 0]))
    scene = scene_of(RIG, poses, radiometry=CELSIUS)
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return altered(scene, thermal=images), rgb, truth


@lru_cache(maxsize=1)
def ring() -> tuple[Scene, RgbModel, ThermalModel]:
    """The ball of `known`, seen from 32 places."""
    _, rgb, truth = known()
    poses = []
    for k in range(32):
        eye = SFM_PER_METRE * np.array([2.6 * math.cos(0.7 * k), 2.6 * math.sin(0.7 * k), 1.3 * math.sin(1.9 * k)])
        poses.append(look_at(eye, [0, 0, 0]))
    scene = scene_of(RIG, poses, radiometry=CELSIUS)
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return altered(scene, thermal=images), rgb, truth


@lru_cache(maxsize=1)
def fitted_ring() -> ThermalModel:
    """The default fit of `ring`."""
    scene, rgb, _ = ring()
    return fit_thermal(scene, rgb, SFM_PER_METRE)


def fit_of(scene: Scene, rgb: RgbModel, degree: int = 1, settings: LinearSettings | None = None) -> Fit:
    """The state of the linear fit before anything is solved."""
    data = ThermalFrames.of(scene, scene.train_frames, SFM_PER_METRE, training_range(scene))
    design = Design(rgb.gaussians, RIG.thermal, data.poses, degree, rgb.settings)
    return Fit.of(design, data, settings or LinearSettings())


def changed(scene: Scene, change: Callable[[int, np.ndarray], np.ndarray]) -> Scene:
    """Every thermal image replaced by `change(number of the frame, image)`."""
    return altered(scene, thermal={f.name: change(i, f.thermal).astype(np.float32) for i, f in enumerate(scene.capture.frames)})


def held_out_error_c(scene: Scene, model: ThermalModel) -> float:
    pairs = [
        (model.render(RIG.thermal, scene.thermal_from_world(f.name, model.sfm_per_metre)), f.thermal)
        for f in scene.held_out_frames
    ]
    return float(np.mean([mae(a, b) for a, b in pairs]))


def error_of_differences_c(model: ThermalModel, scene: Scene) -> float:
    """Mean absolute error of the scene in held-out views, °C; the gauge is taken out."""
    left = []
    for frame in scene.held_out_frames:
        e = model.render(RIG.thermal, scene.thermal_from_world(frame.name, SFM_PER_METRE)) - frame.thermal
        left.append(np.abs(e - np.median(e)).mean())
    return float(np.mean(left))


def outliers(scene: Scene) -> Scene:
    """One pixel in twenty is up to 20 °C off, and frames have offsets."""
    rng = np.random.default_rng(3)
    return changed(scene, lambda i, t: t + 0.3 * (i % 5) + np.where(rng.random(t.shape) < 0.05, rng.uniform(-20, 20, t.shape), 0))


def noisy(sigma_c: float, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    return changed(ring()[0], lambda _, t: t + sigma_c * rng.standard_normal(t.shape))


def model_of(fit: Fit, x: torch.Tensor, scene: Scene, rgb: RgbModel) -> ThermalModel:
    """Unknowns of `fit_of` as a model."""
    span = training_range(scene)
    return as_model(x, fit.design, rgb, unit=fit.data.unit, scores=span, colors=span, sfm_per_metre=SFM_PER_METRE)
