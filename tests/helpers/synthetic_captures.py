"""A small synthetic capture, and how tests look at its files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.synthetic import SynthConfig

SMALL = SynthConfig(scene="hotdog", frames=2, size=48, seed=3)


def thermal_c(folder: Path, name: str) -> NDArray[np.float64]:
    """What the thermal file says, in °C by the rig file."""
    rig = json.loads((folder / "rig.json").read_text())["thermal"]
    counts = np.asarray(Image.open(folder / "thermal" / f"{name}.tiff"))
    return counts * rig["celsius_per_count"] + rig["celsius_offset"]


def clean_c(folder: Path, name: str) -> NDArray[np.float32]:
    """°C before blur, gain, noise and rounding."""
    return np.asarray(Image.open(folder / "ground_truth" / "thermal_clean" / f"{name}.tiff"))


def file_bytes(folder: Path) -> dict[str, bytes]:
    """Content by path, of every file under a folder."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def project(camera: Camera, world_from_camera: SE3, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """`[..., 2]`: pixels of world points."""
    p = world_from_camera.inverse().apply(points)
    return p[..., :2] / p[..., 2:] * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy]
