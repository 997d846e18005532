"""A small capture of a textured wall that is right, and the same with one fault."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle

Array = NDArray[np.float64]
FRAMES = 14
BASELINE_M = 0.15
WALL_M = 2.0
SIDE_M = 5.0  # of the texture
RGB = (320, 240, 300.0)
THERMAL = (160, 120, 150.0)
FLOW_PX = THERMAL[2] * BASELINE_M / WALL_M


def camera_json(size: tuple[int, int, float]) -> dict[str, object]:
    width, height, focal = size
    return {"model": "PINHOLE", "width": width, "height": height, "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}


def write_good(root: Path, *, poses: Callable[[int], SE3] | None = None) -> Path:
    """The capture. `poses` gives `wall_from_rgb` of a frame; None: a walk along the wall."""
    random = np.random.default_rng(0)
    shown, warm = _textures(random)
    baseline = SE3(np.eye(3), np.array([BASELINE_M, 0.0, 0.0]))  # rgb_from_thermal
    for folder in ("rgb", "thermal"):
        (root / folder).mkdir(parents=True)
    for i in range(FRAMES):
        wall_from_rgb = (poses or walk)(i)
        rgb = _seen(shown, wall_from_rgb, RGB) + 0.01 * random.normal(size=(RGB[1], RGB[0], 3))
        celsius = _seen(warm, wall_from_rgb @ baseline, THERMAL) + 0.04 * random.normal(size=(THERMAL[1], THERMAL[0]))
        write_rgb(root / "rgb" / f"{i:03d}.jpg", rgb, time_s=4 * i)
        write_counts(root / "thermal" / f"{i:03d}.tiff", (celsius + 100) * 100)
    rig = {
        "rgb": camera_json(RGB),
        "thermal": camera_json(THERMAL) | {"celsius_per_count": 0.01, "celsius_offset": -100.0},
        "rgb_from_thermal": baseline.matrix().tolist(),
    }
    (root / "rig.json").write_text(json.dumps(rig))
    return root


def walk(i: int) -> SE3:
    """Along the wall, looking at a place on it; x to the right on the wall, y down, and the wall is z = 0."""
    eye = np.array([0.12 * (i - FRAMES / 2), 0.1 * np.sin(i), -WALL_M])
    return look_at(eye, [eye[0] * 0.7, 0.0, 0.0], up=(0.0, -1.0, 0.0))


def turn(i: int) -> SE3:
    """Standing, and turning to the side."""
    return SE3(rotation_from_axis_angle([0.0, 0.05 * (i - FRAMES / 2), 0.0]), np.array([0.0, 0.0, -WALL_M]))


def far_apart(i: int) -> SE3:
    """From near by, every photograph of another part of the wall."""
    return SE3(np.eye(3), np.array([1.2 * (i % 4), 1.2 * (i // 4), -0.25 * WALL_M]))


def write_rgb(path: Path, rgb: Array, *, time_s: float = 0, orientation: int = 1) -> None:
    exif = Image.Exif()
    minutes, seconds = divmod(int(time_s), 60)
    exif[0x0132] = f"2026:05:04 {10 + minutes // 60:02d}:{minutes % 60:02d}:{seconds:02d}"
    exif[0x0112] = orientation
    Image.fromarray((255 * np.clip(rgb, 0, 1)).astype(np.uint8)).save(path, quality=95, exif=exif)


def write_counts(path: Path, counts: Array) -> None:
    Image.fromarray(np.clip(np.round(counts), 0, 65535).astype(np.uint16)).save(path)


def read(path: Path) -> Array:
    with Image.open(path) as image:
        return np.asarray(image, dtype=np.float64)


def _textures(random: np.random.Generator) -> tuple[Array, Array]:
    size = 1500
    shown = np.full((size, size, 3), 0.5)
    warm = np.full((size, size), 18.0)
    for _ in range(900):
        x, y = random.integers(0, size, 2)
        w, h = random.integers(15, 120, 2)
        shown[y : y + h, x : x + w] = random.uniform(0.1, 0.8, 3)
        warm[y : y + h, x : x + w] = random.uniform(14, 24)
    shown += 0.05 * cv2.GaussianBlur(random.normal(size=shown.shape), (0, 0), 1.0)
    return np.clip(shown, 0, 1), cv2.GaussianBlur(warm, (0, 0), 2.0).astype(np.float64)


def _seen(texture: Array, wall_from_camera: SE3, size: tuple[int, int, float]) -> Array:
    width, height, focal = size
    matrix = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1.0]])
    camera = wall_from_camera.inverse()
    pixels_from_wall = matrix @ np.column_stack([camera.rotation[:, :2], camera.translation])
    metres = SIDE_M / texture.shape[0]
    wall_from_texture = np.array([[metres, 0, -SIDE_M / 2], [0, metres, -SIDE_M / 2], [0, 0, 1.0]])
    flags, border = cv2.INTER_LINEAR, cv2.BORDER_WRAP
    return np.asarray(
        cv2.warpPerspective(texture, pixels_from_wall @ wall_from_texture, (width, height), flags=flags, borderMode=border),
        np.float64,
    )
