"""Scenes for tests of the scale: small worlds of Gaussians, seen by a rig whose true scale is known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from tests.helpers.gaussian_clouds import shell
from tests.helpers.scene_record import scene_of

from rtgs.config import PAPER_EPSILON, ScaleConfig
from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.scale import Objective

RIG = Rig(
    Camera("PINHOLE", 56, 48, 60.0, 60.0, 28.0, 24.0),
    Camera("PINHOLE", 56, 44, 64.0, 66.0, 27.3, 22.6),
    SE3(rotation_from_axis_angle([0.02, -0.03, 0.04]), np.array([0.16, -0.07, 0.03])),
)
FORWARDS = replace(RIG, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.array([0.05, 0.02, 0.2])))
"""The same cameras with a baseline that points forwards."""

STD = CalibrationStd(baseline_direction=0.05, rotation_rad=0.01, thermal_focal=0.03)
STATED = replace(RIG, calibration_std=STD)
GLOBAL = ScaleConfig(solver="global")
QUICK = ScaleConfig(solver="adam", steps=50, learning_rate=0.02, scan_samples=32)


def bumpy_ball(n: int = 500) -> Gaussians:
    """A textured shell about the origin, metres."""
    return shell(n, torch.Generator().manual_seed(0), size=0.09, spread=0.3)


def cloud(seed: int) -> Gaussians:
    """A textured shell, a cluttered ball, or a floor with posts; about the origin, metres."""
    g = torch.Generator().manual_seed(seed)
    ball = bumpy_ball()
    if seed == 1:
        return replace(ball, means=1.1 * torch.randn(500, 3, generator=g).clamp(-1.2, 1.2))
    if seed == 2:
        flat = torch.rand(500, 3, generator=g) * torch.tensor([2.4, 2.4, 0.1]) - torch.tensor([1.2, 1.2, 0.6])
        flat[400:, 2] = torch.rand(100, generator=g) - 0.5
        return replace(ball, means=flat)
    return ball


def assembled(poses: list[SE3], thermal: list[np.ndarray], rig: Rig = RIG, rgb: list[np.ndarray] | None = None) -> Scene:
    """`scene_of`, with this file's rig unless another is given."""
    return scene_of(rig, poses, rgb=rgb, thermal=thermal)


def with_rig(scene: Scene, rig: Rig) -> Scene:
    return replace(scene, capture=replace(scene.capture, rig=rig))


def photographs(scene: Scene, model: RgbModel, noise: float = 0.02) -> list[np.ndarray]:
    """What the RGB camera sees, and what a model does not explain."""
    rng, images = np.random.default_rng(1), []
    for frame in scene.frames:
        view = render(model.gaussians, scene.rig.rgb, scene.rgb_from_world(frame.name), settings=model.settings)
        image = view.over(model.background).numpy()
        images.append((image + noise * rng.normal(size=image.shape)).astype(np.float32))
    return images


def drawn(model: RgbModel, poses: list[SE3], rig: Rig, sfm_per_metre: float, noise: float = 0.0) -> Scene:
    """Photographs, and thermal images that the model's own inverted gray gives at the true thermal poses, in counts."""
    blank = np.zeros((rig.thermal.height, rig.thermal.width), np.float32)
    scene, rng, images = assembled(poses, [blank] * len(poses), rig), np.random.default_rng(0), []
    settings = replace(model.settings, channel_weights=GRAY_WEIGHTS)
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, sfm_per_metre)
        view = render(model.gaussians, rig.thermal, pose, settings=settings)
        gray = view.over(model.background @ torch.tensor(GRAY_WEIGHTS))[..., 0].numpy()
        image = 100.0 - 40.0 * gray**2
        images.append((image + noise * rng.normal(size=image.shape)).astype(np.float32))
    return assembled(poses, images, rig, photographs(scene, model))


def soft(scene: Scene, sigma: float) -> Scene:
    """The same with thermal images under a Gaussian."""
    frames = tuple(replace(f, thermal=gaussian_filter(f.thermal, sigma, mode="nearest")) for f in scene.capture.frames)
    return replace(scene, capture=replace(scene.capture, frames=frames))


def objective(scene: Scene, model: RgbModel, epsilon: float = PAPER_EPSILON, *, reference: bool = False) -> Objective:
    """The paper's loss of the first two training frames, by the fast back end or by the reference in float64."""
    return Objective(scene, in_float64(model) if reference else model, scene.train_frames[:2], EdgeLoss(epsilon=epsilon))


def in_float64(model: RgbModel) -> RgbModel:
    """The same model for the reference back end."""
    return replace(model, gaussians=model.gaussians.to(torch.float64), settings=replace(model.settings, backend="reference"))


@lru_cache(maxsize=8)
def synthetic(sfm_per_metre: float = 1.0, n_frames: int = 8) -> tuple[Scene, RgbModel]:
    """Thermal images of other colours, darker where RGB is brighter, drawn from the true thermal poses; frame 0 is held out."""
    ball = bumpy_ball()
    settings = RenderSettings(near_plane=0.05 * sfm_per_metre)
    model = RgbModel(ball.scaled(sfm_per_metre), torch.tensor([0.1, 0.3, 0.2]), settings)
    gray = (0.5 + C0 * ball.sh[:, 0] @ torch.tensor(GRAY_WEIGHTS)).clamp(0, 1)
    hot = replace(model.gaussians, sh=(((1 - gray) ** 2 - 0.5) / C0)[:, None, None])
    poses = []
    for k in range(n_frames):
        angle = 0.8 * k
        pose = look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(2.1 * k)], [0, 0, 0])
        poses.append(pose.with_baseline_scaled(sfm_per_metre))
    blank = np.zeros((RIG.thermal.height, RIG.thermal.width), np.float32)
    scene = assembled(poses, [blank] * n_frames)
    images = []
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, sfm_per_metre)
        view = render(hot, RIG.thermal, pose, settings=settings).over(torch.tensor([0.9]))
        images.append((20.0 + 15.0 * view[..., 0]).numpy())
    return assembled(poses, images, rgb=photographs(scene, model)), model


@lru_cache(maxsize=8)
def sequence(time_offset: float = 0.0, n_frames: int = 16) -> tuple[Scene, RgbModel]:
    """A camera that walks around a textured ball; thermal images of inverted contrast, from the true rig, perhaps late. Truth: s = 1."""
    model = RgbModel(bumpy_ball(), torch.tensor([0.1, 0.3, 0.2]), RenderSettings(near_plane=0.05))
    gray = (0.5 + C0 * model.gaussians.sh[:, 0] @ torch.tensor(GRAY_WEIGHTS)).clamp(0, 1)
    hot = replace(model.gaussians, sh=(((1 - gray) ** 2 - 0.5) / C0)[:, None, None])
    poses = []
    for k in range(n_frames):
        angle = 0.1 * k
        poses.append(look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(0.5 * k)], [0, 0, 0]))
    blank = np.zeros((RIG.thermal.height, RIG.thermal.width), np.float32)
    scene = assembled(poses, [blank] * n_frames, replace(RIG, time_offset=time_offset))
    images = []
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, 1.0)
        images.append(
            (20.0 + 15.0 * render(hot, RIG.thermal, pose, settings=model.settings).over(torch.tensor([0.9]))[..., 0]).numpy()
        )
    return assembled(poses, images, STATED, rgb=photographs(scene, model)), model


def wall(depth: float, background: float = 0.0) -> tuple[Scene, RgbModel]:
    """An opaque wall across the view of frame 001, seen square on, and a rig whose baseline is 0.2 m to the side."""
    rig = replace(RIG, rgb_from_thermal=SE3(np.eye(3), np.array([0.2, 0.0, 0.0])))
    scene = assembled([SE3.identity()] * 2, [np.zeros((44, 56), np.float32)] * 2, rig)
    xy = torch.cartesian_prod(torch.linspace(-1, 1, 15), torch.linspace(-1, 1, 15)) * depth
    n = len(xy)
    gaussians = Gaussians(
        torch.cat([xy, torch.full((n, 1), depth)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        torch.tensor([0.1 * depth, 0.1 * depth, 1e-4 * depth]).log().repeat(n, 1),
        torch.full((n,), 4.0),
        torch.zeros(n, 1, 3),
    )
    return scene, RgbModel(gaussians, torch.full((3,), background), RenderSettings(near_plane=1e-3 * depth))


def facing_walls(depth: float, stripes: int | None, noise: float, frames: int = 9) -> tuple[Scene, RgbModel]:
    """A textured wall across the view at `depth` metres, seen from places beside each other; 0.2 m to the side, the thermal camera."""
    rig = replace(RIG, rgb_from_thermal=SE3(np.eye(3), np.array([0.2, 0.0, 0.0])))
    g = torch.Generator().manual_seed(0)
    n = 60
    xy = torch.cartesian_prod(torch.linspace(-1.2, 1.2, n), torch.linspace(-1.0, 1.0, n // 2)) * depth
    level = (
        torch.rand(len(xy), generator=g)
        if stripes is None
        else (torch.arange(n) % stripes < stripes // 2).float().repeat_interleave(n // 2)
    )
    gaussians = Gaussians(
        torch.cat([xy, torch.full((len(xy), 1), depth)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(len(xy), 1),
        torch.tensor([0.025 * depth, 0.04 * depth, 1e-4 * depth]).log().repeat(len(xy), 1),
        torch.full((len(xy),), 4.0),
        ((0.2 + 0.6 * level) - 0.5)[:, None, None].repeat(1, 1, 3) / C0,
    )
    model = RgbModel(gaussians, torch.zeros(3), RenderSettings(near_plane=1e-3 * depth))
    poses = [SE3(np.eye(3), np.array([0.02 * depth * (k % 3), 0.02 * depth * (k // 3), 0.0])) for k in range(frames)]
    return drawn(model, poses, rig, 1.0, noise), model


def spiral(seed: int, rig: Rig, sfm_per_metre: float, unit: float = 1.0) -> tuple[Scene, RgbModel]:
    """A cloud seen from thirteen places about it, in whatever unit."""
    model = RgbModel(cloud(seed).scaled(sfm_per_metre), torch.full((3,), 0.4), RenderSettings(near_plane=0.05 * unit))
    poses = []
    for k in range(13):
        angle = 0.55 * k
        eye = np.array([2.8 * math.cos(angle), 2.8 * math.sin(angle), 0.5 + 0.4 * math.sin(2.1 * k)])
        poses.append(look_at(eye, [0, 0, 0]).with_baseline_scaled(sfm_per_metre))
    return drawn(model, poses, rig, sfm_per_metre, noise=0.3), model


def orbit(n: int = 13) -> list[SE3]:
    eyes = [(2.8 * math.cos(0.55 * k), 2.8 * math.sin(0.55 * k), 0.5 + 0.4 * math.sin(2.1 * k)) for k in range(n)]
    return [look_at(eye, [0, 0, 0]) for eye in eyes]


@lru_cache(maxsize=1)
def posts() -> tuple[Scene, RgbModel]:
    model = RgbModel(cloud(2), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    return drawn(model, orbit(), RIG, 1.0), model
