"""A room corner with noise on its walls, photographed with a real lens: known poses, known surfaces."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from tests.helpers.captures import thermal_counts

from rtgs.io.colmap import colmap_camera
from rtgs.io.rig import write_rig
from rtgs.maths.geometry import SE3, look_at
from rtgs.records.camera import Camera
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import Rig

RGB = Camera("OPENCV", 320, 240, 300.0, 303.0, 161.5, 118.0, k1=-0.08, k2=0.02, p1=0.001, p2=-0.001)
THERMAL = Camera("PINHOLE", 40, 32, 45.0, 45.0, 20.0, 16.0)
N_FRAMES = 9
NAMES = [f"{i:03d}" for i in range(N_FRAMES)]
POSES = {
    name: look_at([3.0 + 0.8 * np.cos(a), 3.0 + 0.8 * np.sin(a), 1.5 + 0.4 * np.sin(2 * a)], [0.5, 0.5, 0.6])
    for name, a in zip(NAMES, np.linspace(0, 4.5, N_FRAMES), strict=True)
}


def texture(seed: int) -> np.ndarray:
    """`[512, 512, 3]` noise at every scale, so that SIFT finds plenty."""
    rng = np.random.default_rng(seed)
    out = np.zeros((512, 512, 3), np.float32)
    for size in (8, 16, 32, 64, 128, 256):
        out += cv2.resize(rng.normal(size=(size, size, 3)).astype(np.float32), (512, 512), interpolation=cv2.INTER_CUBIC)
    return np.clip(0.5 + 0.15 * out, 0, 1).astype(np.float32)


TEXTURES = [texture(seed) for seed in range(3)]


def render(pose: SE3) -> np.ndarray:
    """`[H, W, 3]` uint8: the planes x = 0, y = 0 and z = 0 as the camera, lens included, sees them from the positive octant."""
    fine = 2  # samples a pixel and axis, against aliasing
    camera = colmap_camera(RGB.resized(RGB.width * fine, RGB.height * fine), 1)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.concatenate([camera.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=1)), np.ones((x.size, 1))], axis=1)
    directions = rays @ pose.rotation.T
    with np.errstate(divide="ignore"):
        t = -pose.translation / directions
    t[t <= 0] = np.inf
    plane = t.argmin(axis=1)
    hit = pose.translation + directions * t.min(axis=1, keepdims=True)
    image = np.zeros((*x.shape, 3), np.float32)
    for k in range(3):
        u, v = (np.delete(hit, k, axis=1) * 100 % 511).astype(np.float32).T.reshape(2, *x.shape)
        image[(plane == k).reshape(x.shape)] = cv2.remap(TEXTURES[k], u, v, cv2.INTER_LINEAR)[(plane == k).reshape(x.shape)]
    small = cv2.resize(image, (RGB.width, RGB.height), interpolation=cv2.INTER_AREA)
    return np.round(small * 255).astype(np.uint8)


def write_room(root: Path) -> None:
    """The capture, photographs alone."""
    (root / "rgb").mkdir()
    (root / "thermal").mkdir()
    for i, (name, pose) in enumerate(POSES.items()):
        Image.fromarray(render(pose)).save(root / "rgb" / f"{name}.png")
        Image.fromarray(thermal_counts(3000 + i)).save(root / "thermal" / f"{name}.png")
    write_rig(root / "rig.json", Rig(RGB, THERMAL, SE3(np.eye(3), np.array([0.05, 0.0, 0.0]))), RelativeCounts())
