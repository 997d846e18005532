"""A small, correct capture, and ways to change its files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.colmap import colmap_camera, quiet_colmap, rigid3d_from_se3
from rtgs.io.transforms import write_transforms
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.radiometry import CountsToCelsius

RGB = Camera("OPENCV", 64, 48, 60.0, 61.0, 32.5, 23.5, k1=-0.05, k2=0.01, p1=0.001, p2=-0.002)
THERMAL = Camera("PINHOLE", 40, 32, 45.0, 45.0, 20.0, 16.0)
RGB_FROM_THERMAL = SE3(rotation_from_axis_angle([0.01, -0.03, 0.02]), np.array([0.05, -0.002, 0.01]))
RADIOMETRY = CountsToCelsius(0.025, -100.0)
NAMES = tuple(f"10-5{i}.{i}" for i in range(5))  # a dot in a stem is not a suffix
POSES = {name: look_at([np.cos(i / 5), np.sin(i / 5), 0.1 * i], [0.0, 0.0, 0.0]) for i, name in enumerate(NAMES)}
ARCO = Path(os.environ.get("RTGS_DATA", Path(__file__).parents[3] / "shared" / "data")) / "arco"
needs_arco = pytest.mark.skipif(not ARCO.is_dir(), reason="the real capture arco is not here (RTGS_DATA or ../shared/data)")


def thermal_counts(level: float, dtype: Any = np.uint16) -> NDArray[Any]:
    """`[32, 40]`: `level` everywhere but for one row, which is higher by 4."""
    counts = np.full((32, 40), level, dtype=dtype)
    counts[5] += 4
    return counts


def edit_rig(root: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    data = json.loads((root / "rig.json").read_text())
    change(data)
    (root / "rig.json").write_text(json.dumps(data))


def write_poses(root: Path, camera: Camera = RGB, poses: dict[str, SE3] = POSES) -> None:
    write_transforms(root / "transforms.json", camera, poses, {name: f"./rgb/{name}.png" for name in poses})


def edit_transforms(root: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    data = json.loads((root / "transforms.json").read_text())
    change(data)
    (root / "transforms.json").write_text(json.dumps(data))


def write_sparse(
    root: Path, camera: Camera = RGB, poses: dict[str, SE3] = POSES, *, text: bool = False, pattern: str = "{}.png"
) -> None:
    """A model as COLMAP itself would leave it: one camera, one image a frame."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(colmap_camera(camera, 1))
    for i, (name, pose) in enumerate(poses.items()):
        image = pycolmap.Image(name=pattern.format(name), camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, rigid3d_from_se3(pose.inverse()))
    model.add_point3D(np.array([0.1, 0.2, 0.3]), pycolmap.Track(), np.array([255, 0, 51], dtype=np.uint8))
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    with quiet_colmap():
        (model.write_text if text else model.write_binary)(folder)


def refused(root: Path, *said: str) -> None:
    """Loading fails with one message that holds each of `said`."""
    with pytest.raises(RtgsError) as error:
        load_capture(root)
    for part in said:
        assert part in str(error.value)
    assert "\n" not in str(error.value)
